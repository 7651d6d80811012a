//! How much of what is hidden the first splats tell, and how much of that is wrong, against the truth.
//!
//! ```text
//! cargo run --release -p m4_slam --example hidden_points -- [width] [height] [frames]
//! ```
//!
//! Boxes that turn behind a pillar and leave the picture, with true cameras, depth and masks; tracks along our own flow. Points of the
//! boxes that some frame sees and another does not are looked for among the splats of that other frame: found within 1.5 % of
//! the depth. Splats that it cannot see and that lie farther than that from all boxes are wrong.
#![expect(clippy::print_stdout, reason = "a report is its output")]

#[path = "../tests/track_support/score.rs"]
mod track_score;

use m4_init::{InitConfig, TrackedInit, initialise};
use m4_math::nalgebra::Vector3;
use m4_scene::{Capture, CaptureFrame, Column, CompactMask, Silent, Splats, Tracks};
use m4_slam::dense::{InverseSearch, TrackConfig};
use m4_slam::tracks3d::{FlowTracker, QueryGrid, Tracker3d};
use m4_testkit::BoxScene;
use std::time::Instant;
use track_score::{clip, score};

/// Distances that count as the same place, in depths.
const SAME: f64 = 0.015;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let numbers: Vec<usize> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let number = |k: usize, default| numbers.get(k).copied().unwrap_or(default);
    let scene = BoxScene::new(number(0, 240), number(1, 180), number(2, 36));
    let flow = InverseSearch::default();
    let config = TrackConfig::default();
    let grid = QueryGrid {
        every: config.every,
        ..QueryGrid::default()
    };
    let followed = FlowTracker { flow: &flow, config }.follow_grid(&clip(&scene), &grid, &Silent)?;
    println!("{}", score(&scene, &followed));

    let fast = InitConfig {
        change_threshold: 0.0,
        shell_splats: 0,
        max_static: 5000,
        ..InitConfig::fast()
    };
    let ways = |carry: bool, tracked: TrackedInit| InitConfig {
        carry_keyframes: if carry { fast.carry_keyframes } else { 0 },
        tracked,
        ..fast.clone()
    };
    let points = |enabled: bool| TrackedInit {
        enabled,
        ..TrackedInit::default()
    };
    let seen = TrackedInit {
        seen: true,
        ..points(true)
    };
    let tracks = Some(&followed.tracks);
    let cases = [
        ("nothing hidden", None, ways(false, points(false))),
        ("carried, without tracks", None, ways(true, points(false))),
        ("carried, velocities of tracks", tracks, ways(true, points(false))),
        ("tracked", tracks, ways(false, points(true))),
        ("tracked, seen ones too", tracks, ways(false, seen)),
        ("tracked and carried", tracks, ways(true, points(true))),
    ];
    for (name, tracks, config) in cases {
        let started = Instant::now();
        let splats = initialise(&capture(&scene, tracks), &config, &Silent)?;
        let seconds = started.elapsed().as_secs_f64();
        let [found, hidden, wrong, added] = told(&scene, &splats);
        println!(
            "{name}: {} dynamic splats, {seconds:.1} s; {:.1} % of {hidden} hidden points found; {added} hidden splats, {:.1} % of them wrong",
            splats.n_dynamic(),
            100.0 * found as f64 / hidden.max(1) as f64,
            100.0 * wrong as f64 / added.max(1) as f64
        );
    }
    Ok(())
}

fn capture(scene: &BoxScene, tracks: Option<&Tracks>) -> Capture {
    let frame = |t: usize| {
        let mask = scene.mask(t);
        let (w, h) = mask.size();
        CaptureFrame {
            name: format!("{t}"),
            camera: scene.cameras[t],
            t: t as f64,
            rgb: scene.rgb(t),
            depth: Some(scene.depth(t).into()),
            mask: Some(CompactMask::from_fn(w, h, |x, y| mask[(x, y)] > 0)),
            motion: None,
            instances: None,
            camera_index: None,
        }
    };
    Capture {
        frames: (0..scene.frames()).map(frame).collect(),
        time_frames: scene.frames(),
        duration_s: None,
        metric: true,
        tracks: tracks.cloned(),
    }
}

/// Hidden points that are found, all of them, hidden splats that are wrong, all of them: in every third frame.
fn told(scene: &BoxScene, splats: &Splats) -> [usize; 4] {
    let (w, h) = scene.mask(0).size();
    let mut out = [0; 4];
    let first = splats.n_static();
    for t in (0..scene.frames()).step_by(3) {
        let times = splats.column(Column::TimeMean, 0);
        let here = (0..splats.n_dynamic()).filter(|&i| (times[i] - t as f32).abs() < 1e-3);
        let place = |i: usize| Vector3::from([0, 1, 2].map(|k| f64::from(splats.column(Column::Mean, k)[first + i])));
        let places: Vec<Vector3<f64>> = here.map(place).collect();
        let unseen = |p: &Vector3<f64>| {
            let ([u, v], z) = scene.cameras[t].project(p);
            let inside = z > 0.0 && u > -0.5 && v > -0.5 && u < w as f64 - 0.5 && v < h as f64 - 0.5;
            !inside || scene.cast(t, u, v).depth < (1.0 - SAME) * z
        };
        for p in places.iter().filter(|p| unseen(p)) {
            let depth = (p - scene.cameras[t].centre()).norm();
            let right = (2..4).any(|body| scene.surface_distance(body, p, t) < SAME * depth);
            out[3] += 1;
            out[2] += usize::from(!right);
        }
        for other in (0..scene.frames()).step_by(6) {
            for i in (0..w * h).step_by(29) {
                let hit = scene.hit(other, i % w, i / w);
                if !BoxScene::moves(hit.body) || scene.sees(hit.body, &hit.local, t) {
                    continue;
                }
                let p = scene.place(hit.body, &hit.local, t);
                let most = SAME * (p - scene.cameras[t].centre()).norm();
                out[1] += 1;
                out[0] += usize::from(places.iter().any(|q| (q - p).norm() < most));
            }
        }
    }
    out
}
