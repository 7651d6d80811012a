//! Runs the sparse front end on a folder of pictures and compares it with known poses.
//!
//! ```text
//! cargo run --release -p m4_slam --example sparse_report -- PICTURES [TRUTH.json] [--config FILE.json]
//! ```
//!
//! `TRUTH.json` is a nerfstudio-style `transforms_train.json` (OpenGL camera-to-world; with `mask_path`
//! the motion of tracks is scored too) or the `precomputed.json` of a capture in NR-NeRF style (columns
//! right, up, back). Every n-th picture is used when the environment says `STEP=n`;
//! with `OVERLAY=FOLDER` four frames are written there with their tracks: green rests, red moves, blue
//! could not be told.
#![expect(clippy::print_stdout, reason = "a report is its output")]

use m4_math::nalgebra::{Matrix3, Matrix4, Vector3};
use m4_math::{Se3, Sim3, log_so3};
use m4_scene::{Plane, Progress, RgbImage};
use m4_slam::reconstruction::{Motion, SparseReconstruction};
use m4_slam::sparse::{SparseConfig, reconstruct};
use serde_json::Value;
use std::path::{Path, PathBuf};

type Anything = Box<dyn std::error::Error>;

struct Print;

impl Progress for Print {
    fn update(&self, _phase: &str, _done: usize, _total: usize, _note: &str) {}

    fn warn(&self, message: &str) {
        println!("warning: {message}");
    }

    fn cancelled(&self) -> bool {
        false
    }
}

/// Known poses, focal length in pixels, and motion masks.
struct Truth {
    c2w: Vec<Se3<f64>>,
    focal_px: f64,
    masks: Vec<Option<PathBuf>>,
}

fn main() -> Result<(), Anything> {
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let mut config = SparseConfig::default();
    if let Some(i) = args.iter().position(|a| a == "--config") {
        config = serde_json::from_str(&std::fs::read_to_string(&args[i + 1])?)?;
        args.drain(i..i + 2);
    }
    let folder = args
        .first()
        .ok_or("usage: sparse_report PICTURES [TRUTH.json] [--config FILE.json]")?;
    let step: usize = std::env::var("STEP").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)?
        .map(|e| e.map(|e| e.path()))
        .collect::<Result<_, _>>()?;
    paths.sort();
    let pictures: Vec<RgbImage> = paths.iter().step_by(step).map(|p| read(p)).collect::<Result<_, _>>()?;
    let frames: Vec<&RgbImage> = pictures.iter().collect();
    let begin = std::time::Instant::now();
    let found = reconstruct(&frames, &config, &Print)?;
    let seconds = begin.elapsed().as_secs_f64();
    let count = |m: Motion| found.tracks.iter().filter(|t| t.motion == m).count();
    let lengths: usize = found.tracks.iter().map(|t| t.observations.len()).sum();
    println!(
        "{} frames of {:?} in {seconds:.2} s: {:?}, {} tracks (mean length {:.1}): {} static, {} dynamic, {} unknown; {} points, residual {:.3} px, focal {:.1} px",
        frames.len(),
        frames[0].size(),
        found.camera_motion,
        found.tracks.len(),
        lengths as f64 / found.tracks.len().max(1) as f64,
        count(Motion::Static),
        count(Motion::Dynamic),
        count(Motion::Unknown),
        found.tracks.iter().filter(|t| t.point.is_some()).count(),
        found.residual_px,
        found.cameras[0].intrinsics.fx,
    );
    if let Ok(folder) = std::env::var("OVERLAY") {
        overlay(&found, &pictures, Path::new(&folder))?;
    }
    if let Some(path) = args.get(1) {
        let mut truth = read_truth(Path::new(path))?;
        truth.c2w = truth.c2w.into_iter().step_by(step).collect();
        truth.masks = truth.masks.into_iter().step_by(step).collect();
        compare(&found, &truth)?;
    }
    Ok(())
}

fn read(path: &Path) -> Result<RgbImage, Anything> {
    let picture = image::open(path)?.to_rgb8();
    let (w, h) = picture.dimensions();
    Ok(Plane::from_vec(
        w as usize,
        h as usize,
        picture.pixels().map(|p| p.0).collect(),
    )?)
}

fn overlay(found: &SparseReconstruction, pictures: &[RgbImage], folder: &Path) -> Result<(), Anything> {
    std::fs::create_dir_all(folder)?;
    for k in 0..4 {
        let frame = k * (pictures.len() - 1) / 3;
        let picture = &pictures[frame];
        let (w, h) = (picture.width() as u32, picture.height() as u32);
        let mut out = image::RgbImage::from_fn(w, h, |x, y| image::Rgb(picture[(x as usize, y as usize)]));
        for t in &found.tracks {
            let Some(p) = t.at(frame) else { continue };
            let colour = match (t.motion, t.point) {
                (Motion::Static, Some(_)) => [0, 255, 0],
                (Motion::Static, None) => [255, 255, 0],
                (Motion::Dynamic, _) => [255, 0, 0],
                (Motion::Unknown, _) => [0, 128, 255],
            };
            for (dx, dy) in (-2..=2).flat_map(|y| (-2..=2).map(move |x| (x, y))) {
                let (x, y) = ((p[0].round() as i64 + dx) as u32, (p[1].round() as i64 + dy) as u32);
                if x < w && y < h {
                    out.put_pixel(x, y, image::Rgb(colour));
                }
            }
        }
        out.save(folder.join(format!("{frame:05}.png")))?;
    }
    Ok(())
}

fn number(value: &Value) -> Result<f64, Anything> {
    value
        .as_f64()
        .ok_or_else(|| "a number is missing in the truth file".into())
}

fn read_truth(path: &Path) -> Result<Truth, Anything> {
    let file: Value = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let (mut c2w, mut masks) = (Vec::new(), Vec::new());
    let rows = |value: &Value| -> Result<Se3<f64>, Anything> {
        let mut m = Matrix4::identity();
        for i in 0..3 {
            for j in 0..4 {
                m[(i, j)] = number(&value[i][j])?;
            }
        }
        // Both kinds have y up and z back.
        let mut pose = Se3::from_matrix(&m);
        pose.rotation.column_mut(1).neg_mut();
        pose.rotation.column_mut(2).neg_mut();
        Ok(pose)
    };
    if let Some(poses) = file["poses"].as_array() {
        for pose in poses {
            c2w.push(rows(pose)?);
            masks.push(None);
        }
        return Ok(Truth {
            c2w,
            focal_px: number(&poses[0][2][4])?,
            masks,
        });
    }
    for frame in file["frames"].as_array().ok_or("no frames in the truth file")? {
        c2w.push(rows(&frame["transform_matrix"])?);
        masks.push(frame["mask_path"].as_str().map(|p| folder.join(p)));
    }
    Ok(Truth {
        c2w,
        focal_px: number(&file["fl_x"])?,
        masks,
    })
}

fn compare(found: &SparseReconstruction, truth: &Truth) -> Result<(), Anything> {
    let centres = |poses: &[Se3<f64>]| poses.iter().map(|p| p.translation).collect::<Vec<Vector3<f64>>>();
    let ours: Vec<Se3<f64>> = found.cameras.iter().map(|c| c.c2w).collect();
    let want = centres(&truth.c2w);
    let path: f64 = want.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    let focal = found.cameras[0].intrinsics.fx;
    print!(
        "focal {focal:.1} px, truth {:.1}: {:+.2} %; ",
        truth.focal_px,
        100.0 * (focal / truth.focal_px - 1.0)
    );
    match Sim3::umeyama(&centres(&ours), &want) {
        Some(s) => {
            let aligned: Vec<Se3<f64>> = ours.iter().map(|p| s.transform_pose(p)).collect();
            let squared: f64 = aligned
                .iter()
                .zip(&want)
                .map(|(a, b)| (a.translation - b).norm_squared())
                .sum();
            let rmse = (squared / want.len() as f64).sqrt();
            // The path may be nearly straight, which leaves a turn about it open: rotations are
            // compared after the turn that suits them all best.
            let sum: Matrix3<f64> = ours
                .iter()
                .zip(&truth.c2w)
                .map(|(a, b)| b.rotation * a.rotation.transpose())
                .sum();
            let mut turns: Vec<f64> = ours
                .iter()
                .zip(&truth.c2w)
                .map(|(a, b)| {
                    log_so3(&(nearest_rotation(&sum) * a.rotation * b.rotation.transpose()))
                        .norm()
                        .to_degrees()
                })
                .collect();
            turns.sort_by(f64::total_cmp);
            println!(
                "trajectory error {rmse:.5} of path {path:.3}: {:.2} %; rotation error median {:.3}, greatest {:.3} degrees",
                100.0 * rmse / path,
                turns[turns.len() / 2],
                turns[turns.len() - 1]
            );
        }
        None => println!("no trajectory"),
    }
    score_motion(found, truth)
}

/// Of a sum of rotations.
fn nearest_rotation(m: &Matrix3<f64>) -> Matrix3<f64> {
    let svd = m.svd(true, true);
    svd.u.unwrap_or_default() * svd.v_t.unwrap_or_default()
}

/// Precision and recall of "moves" against masks: a track moves when most of its observations lie in them.
fn score_motion(found: &SparseReconstruction, truth: &Truth) -> Result<(), Anything> {
    let masks: Vec<Option<image::GrayImage>> = truth
        .masks
        .iter()
        .map(|p| p.as_ref().map(|p| image::open(p).map(|m| m.to_luma8())).transpose())
        .collect::<Result<_, _>>()?;
    let (mut table, mut judged) = ([[0_usize; 3]; 2], 0);
    for t in &found.tracks {
        let (mut inside, mut all) = (0, 0);
        for (k, p) in t.observations.iter().enumerate() {
            if let Some(Some(mask)) = masks.get(t.first_frame + k) {
                let (x, y) = ((p[0].max(0.0) + 0.5) as u32, (p[1].max(0.0) + 0.5) as u32);
                inside += usize::from(mask.get_pixel_checked(x, y).is_some_and(|v| v.0[0] > 127));
                all += 1;
            }
        }
        if all > 0 && (inside * 5 >= all * 4 || inside * 5 <= all) {
            let column = match t.motion {
                Motion::Static => 0,
                Motion::Dynamic => 1,
                Motion::Unknown => 2,
            };
            table[usize::from(2 * inside > all)][column] += 1;
            judged += 1;
        }
    }
    if judged > 0 {
        println!(
            "tracks (static, dynamic, unknown): of resting things {:?}, of moving things {:?}",
            table[0], table[1]
        );
    }
    Ok(())
}
