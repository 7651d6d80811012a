//! What hidden points are worth: tracks, carried points, both or neither, scored on held-out views.
//!
//! ```text
//! cargo run --release -p m4_slam --example follow_capture -- FOLDER TRACKS.npz
//! cargo run --release -p m4_train --example first_splats -- FOLDER TRACKS.npz [ITERATIONS]
//! ```
//!
//! Makes the first splats of a capture in each way and scores them before training and after `ITERATIONS` (0: not at all). Test views
//! are drawn for scoring alone.
#![expect(clippy::print_stdout, reason = "a report is its output")]

use m4_eval::image::{ImageReport, Picture};
use m4_init::{InitConfig, TrackedInit, initialise};
use m4_io::capture::{CaptureOptions, Split, read};
use m4_kernels::{Renderer, SimdLevel, View};
use m4_scene::{Capture, CompactMask, Scene, Silent, Tracks};
use m4_train::{TrainConfig, Trainer};
use std::path::PathBuf;
use std::time::Instant;

type Anything = Box<dyn std::error::Error>;

fn main() -> Result<(), Anything> {
    let mut words = std::env::args().skip(1);
    let folder = PathBuf::from(words.next().ok_or("which capture?")?);
    let tracks_path = PathBuf::from(words.next().ok_or("which tracks? follow_capture makes them")?);
    let iterations: usize = words.next().map_or(Ok(0), |n| n.parse())?;
    let capture = read(&folder, Split::Train, &CaptureOptions::default(), &Silent)?;
    let test = read(&folder, Split::Test, &CaptureOptions::default(), &Silent)?;
    let level = SimdLevel::detect()?;

    let tracks = m4_io::tracks::read(&tracks_path, capture.frames.len(), 1 << 30)?;
    println!("{}", told(&tracks));
    let tracked = Capture {
        tracks: Some(tracks),
        ..capture.clone()
    };

    let fast = InitConfig::fast();
    let ways = |carry: bool, points: bool| InitConfig {
        carry_keyframes: if carry { fast.carry_keyframes } else { 0 },
        tracked: TrackedInit {
            enabled: points,
            ..fast.tracked
        },
        ..fast.clone()
    };
    let seen = InitConfig {
        tracked: TrackedInit {
            enabled: true,
            seen: true,
            ..fast.tracked
        },
        ..ways(false, true)
    };
    let cases = [
        ("no tracks, carried points", &capture, ways(true, false)),
        ("velocities of tracks, nothing hidden", &tracked, ways(false, false)),
        ("velocities of tracks, carried points", &tracked, ways(true, false)),
        ("tracked points", &tracked, ways(false, true)),
        ("tracked points, seen ones too", &tracked, seen),
        ("tracked and carried points", &tracked, ways(true, true)),
    ];
    for (name, capture, config) in cases {
        let started = Instant::now();
        let splats = initialise(capture, &config, &Silent)?;
        let (dynamic, seconds) = (splats.n_dynamic(), started.elapsed().as_secs_f64());
        let train = TrainConfig {
            iterations: iterations.max(1),
            ..TrainConfig::fast()
        };
        let mut trainer = Trainer::new(capture, splats, train, level)?;
        let first = scores(&trainer.scene(), &test, level)?;
        println!("{name}: {dynamic} dynamic, {seconds:.1} s; first splats {first}");
        if iterations > 0 {
            trainer.run_until(iterations, &Silent, &mut |_| {})?;
            println!(
                "    after {iterations} iterations {}",
                scores(&trainer.scene(), &test, level)?
            );
        }
    }
    Ok(())
}

fn told(tracks: &Tracks) -> String {
    let known = tracks.xyz().iter().filter(|p| p[0].is_finite()).count();
    let seen = tracks.visible().iter().filter(|v| **v).count();
    let all = tracks.xyz().len().max(1);
    format!(
        "{} tracks, seen in {:.1} % and known in {:.1} % of the frames",
        tracks.count(),
        100.0 * seen as f64 / all as f64,
        100.0 * known as f64 / all as f64
    )
}

/// Draws every held-out view and scores it.
fn scores(scene: &Scene, test: &Capture, level: SimdLevel) -> Result<String, Anything> {
    let mut renderer = Renderer::new(level);
    let mut report = ImageReport::new("held-out views, given geometry", 0);
    for frame in &test.frames {
        let view = View {
            camera: frame.camera,
            t: frame.t,
            background: scene.background,
            near: scene.near,
            mip: scene.mip,
            period: (scene.time_frames.max(2) - 1) as f32,
            with_depth: false,
        };
        let drawn = renderer.render(&scene.splats, &view);
        let [r, g, b] = &drawn.rgb;
        let picture = Picture::from_planes(drawn.width, drawn.height, [r, g, b])?;
        let mask = frame.mask.as_ref().map(CompactMask::to_mask);
        let truth = Picture::from(&frame.rgb);
        report.add(
            &frame.name,
            frame.t,
            frame.camera_index,
            &picture,
            &truth,
            mask.as_ref(),
        )?;
    }
    let m = report.mean().ok_or("no held-out views")?;
    Ok(format!(
        "{:.2} dB whole, {:.2} dB moving, ssim {:.4} / {:.4}",
        m.psnr_db,
        m.masked_psnr_db.unwrap_or(f64::NAN),
        m.ssim,
        m.masked_ssim.unwrap_or(f64::NAN)
    ))
}
