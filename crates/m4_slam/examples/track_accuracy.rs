//! How far points are followed through a made-up clip: boxes that turn behind a pillar and leave the picture.
//!
//! ```text
//! cargo run --release -p m4_slam --example track_accuracy -- [width] [height] [frames]
//! ```
//!
//! Prints, for true flow and for our own search, with chains alone and with hidden points carried on: the median distance to the
//! truth, the share of frames in which a point is within 5 % of its depth and 10 px, and how much of what is hidden is told.
#![expect(clippy::print_stdout, reason = "a report is its output")]

#[path = "../tests/track_support/mod.rs"]
mod track_support;

use m4_scene::Silent;
use m4_slam::dense::{FillConfig, FlowSource, InverseSearch, TrackConfig};
use m4_slam::tracks3d::{FlowTracker, PosedFrame, QueryGrid, TrackError, Tracker3d};
use m4_testkit::BoxScene;
use std::time::Instant;
use track_support::{TrueFlow, clip, score};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let numbers: Vec<usize> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let number = |k: usize, default| numbers.get(k).copied().unwrap_or(default);
    let scene = BoxScene::new(number(0, 320), number(1, 240), number(2, 48));
    let exact = clip(&scene);
    let noisy = with_noise(&exact, 0.02);
    let (truth, search) = (TrueFlow::new(&scene), InverseSearch::default());
    let cases: [(&str, &dyn FlowSource, &Vec<PosedFrame>); 3] = [
        ("true flow, true depth", &truth, &exact),
        ("own flow, true depth", &search, &exact),
        ("own flow, depth off by up to 2 % a frame", &search, &noisy),
    ];
    for (name, flow, clip) in cases {
        for enabled in [false, true] {
            let fill = FillConfig {
                enabled,
                ..FillConfig::default()
            };
            let config = TrackConfig {
                fill,
                ..TrackConfig::default()
            };
            let started = Instant::now();
            let followed = FlowTracker { flow, config }.follow_grid(clip, &QueryGrid::default(), &Silent);
            let followed = followed.map_err(|e: TrackError| e.to_string())?;
            let seconds = started.elapsed().as_secs_f64();
            let how = if enabled { "carried on" } else { "chains alone" };
            println!("{name}, {how}, {seconds:.1} s: {}", score(&scene, &followed));
        }
    }
    Ok(())
}

/// Depth of every frame off by a factor of its own.
fn with_noise(clip: &[PosedFrame], most: f64) -> Vec<PosedFrame> {
    let mut rng = m4_math::CounterRng::new(11, 0, 0);
    clip.iter()
        .map(|frame| {
            let factor = (1.0 + most * (2.0 * rng.uniform() - 1.0)) as f32;
            PosedFrame {
                depth: frame.depth.map(|z| z * factor),
                ..frame.clone()
            }
        })
        .collect()
}
