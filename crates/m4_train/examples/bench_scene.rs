//! Trains on a capture with its own geometry and scores the held-out views.
//!
//! ```text
//! cargo run --release -p m4_train --example bench_scene -- FOLDER [--faithful] [--out FOLDER] [--every N] \
//!     [KEY=VALUE ...]
//! ```
//!
//! `KEY` is a field of the settings, `init.max_static` or `train.loss.depth_weight`; `VALUE` is TOML.
//! `--out` writes the rendered test views beside the photographs, `--every` scores them every N
//! iterations as well. Test views are drawn for scoring alone.
#![expect(clippy::print_stdout, reason = "a report is its output")]

use m4_eval::image::{ImageReport, Picture};
use m4_init::{InitConfig, initialise};
use m4_io::capture::{CaptureOptions, Split, read};
use m4_io::image::write_rgb;
use m4_kernels::{Renderer, SimdLevel, View};
use m4_scene::{Capture, CompactMask, Plane, RgbImage, Scene, Silent};
use m4_train::{MetricsEvent, TrainConfig, Trainer};
use serde::{Serialize, de::DeserializeOwned};
use std::path::{Path, PathBuf};
use std::time::Instant;

type Anything = Box<dyn std::error::Error>;

fn main() -> Result<(), Anything> {
    let mut words = std::env::args().skip(1);
    let folder = PathBuf::from(words.next().ok_or("which capture?")?);
    let (mut init, mut train, mut out, mut every) = (InitConfig::fast(), TrainConfig::fast(), None, usize::MAX);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--faithful" => (init, train) = (InitConfig::faithful(), TrainConfig::faithful()),
            "--out" => out = Some(PathBuf::from(words.next().ok_or("--out FOLDER")?)),
            "--every" => every = words.next().ok_or("--every N")?.parse()?,
            other => {
                let (key, value) = other.split_once('=').ok_or(format!("{other}: not KEY=VALUE"))?;
                match key.split_once('.') {
                    Some(("init", key)) => init = set(&init, key, value)?,
                    Some(("train", key)) => train = set(&train, key, value)?,
                    _ => return Err(format!("{key}: settings start with init. or train.").into()),
                }
            }
        }
    }
    let capture = read(&folder, Split::Train, &CaptureOptions::default(), &Silent)?;
    let test = read(&folder, Split::Test, &CaptureOptions::default(), &Silent)?;
    let mut fitted = capture.clone();
    fitted.frames = fitted.frames.into_iter().step_by(8).collect();
    let level = SimdLevel::detect()?;

    let started = Instant::now();
    let splats = initialise(&capture, &init, &Silent)?;
    println!(
        "init: {} static, {} dynamic, {:.1} s",
        splats.n_static(),
        splats.n_dynamic(),
        started.elapsed().as_secs_f64()
    );
    let iterations = train.iterations;
    let mut trainer = Trainer::new(&capture, splats, train, level)?;
    println!("       test: {}", scores(&trainer.scene(), &test, level, None)?);
    let mut seconds = 0.0;
    while trainer.iteration() < iterations {
        let started = Instant::now();
        let mut last: Option<MetricsEvent> = None;
        trainer.run_until(trainer.iteration().saturating_add(every), &Silent, &mut |e| {
            last = Some(*e)
        })?;
        seconds += started.elapsed().as_secs_f64();
        if let Some(e) = last {
            println!(
                "{:5}: l1 {:.4} ssim {:.4} depth {:.5} psnr {:.2}, {} + {} splats, {:.0} touched, {seconds:.1} s",
                e.iteration, e.l1, e.ssim, e.depth, e.psnr, e.splats_static, e.splats_dynamic, e.touched
            );
        }
        let done = trainer.iteration() >= iterations;
        let to = if done { out.as_deref() } else { None };
        println!(
            "       test: {} (fitted: {})",
            scores(&trainer.scene(), &test, level, to)?,
            scores(&trainer.scene(), &fitted, level, None)?
        );
    }
    Ok(())
}

/// `config` with one field replaced.
fn set<T: Serialize + DeserializeOwned>(config: &T, key: &str, value: &str) -> Result<T, Anything> {
    let mut table = toml::Table::try_from(config)?;
    let value = toml::from_str::<toml::Table>(&format!("x = {value}"))?.remove("x");
    let mut at = &mut table;
    let path: Vec<&str> = key.split('.').collect();
    for part in &path[..path.len() - 1] {
        at = at
            .get_mut(*part)
            .and_then(toml::Value::as_table_mut)
            .ok_or(format!("{key}: no such table"))?;
    }
    at.insert(path[path.len() - 1].to_owned(), value.ok_or("no value")?);
    Ok(table.try_into()?)
}

/// Draws every held-out view and scores it.
fn scores(scene: &Scene, test: &Capture, level: SimdLevel, out: Option<&Path>) -> Result<String, Anything> {
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
        report.add(
            &frame.name,
            frame.t,
            frame.camera_index,
            &picture,
            &Picture::from(&frame.rgb),
            frame.mask.as_ref().map(CompactMask::to_mask).as_ref(),
        )?;
        if let Some(out) = out {
            std::fs::create_dir_all(out)?;
            let name = frame.name.replace(['/', '\\'], "_").replace(".jpg", ".png");
            write_rgb(&out.join(name), &beside(&picture, &frame.rgb)?)?;
        }
    }
    if let Some(out) = out {
        std::fs::write(out.join("table.txt"), report.table())?;
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

/// Render, photograph, and four times their difference.
fn beside(picture: &Picture, photograph: &RgbImage) -> Result<RgbImage, Anything> {
    let (w, h) = photograph.size();
    let drawn = |x: usize, y: usize| [0, 1, 2].map(|c| (picture.planes()[c][y * w + x] * 255.0).round() as u8);
    Ok(Plane::from_fn(3 * w, h, |x, y| {
        let at = x % w;
        let (a, b) = (drawn(at, y), photograph[(at, y)]);
        match x / w {
            0 => a,
            1 => b,
            _ => [0, 1, 2].map(|c| a[c].abs_diff(b[c]).saturating_mul(4)),
        }
    }))
}
