//! Measures the stages on the benchmark scenes with true cameras: run by hand, with `--ignored`.

use super::config::DenseConfig;
use super::densify::{Stages, run};
use super::flow::InverseSearch;
use super::given::Given;
use super::sources::Sources;
use crate::reconstruction::{CameraMotion, Motion, SparseReconstruction, Track};
use m4_math::{CounterRng, Se3};
use m4_scene::{Camera, Intrinsics, Plane, RgbImage, Silent};
use nalgebra::Matrix4;
use std::path::{Path, PathBuf};

/// `depth` and `moving` are empty for pictures without truth.
struct Truth {
    images: Vec<RgbImage>,
    cameras: Vec<Camera>,
    depth: Vec<Plane<f32>>,
    moving: Vec<Plane<u8>>,
}

fn pictures(dir: &Path, limit: usize) -> Option<Truth> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(dir).ok()?.map(|e| e.unwrap().path()).collect();
    paths.sort();
    let open = |path: &PathBuf| {
        let rgb = image::open(path).unwrap().into_rgb8();
        let (w, h) = (rgb.width() as usize, rgb.height() as usize);
        Plane::from_vec(w, h, rgb.pixels().map(|p| p.0).collect()).unwrap()
    };
    Some(Truth {
        images: paths.iter().take(limit).map(open).collect(),
        cameras: Vec::new(),
        depth: Vec::new(),
        moving: Vec::new(),
    })
}

fn load(dir: &Path, limit: usize) -> Option<Truth> {
    if !dir.join("transforms_train.json").exists() {
        return pictures(dir, limit);
    }
    let text = std::fs::read_to_string(dir.join("transforms_train.json")).ok()?;
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let number = |key: &str| json[key].as_f64().unwrap();
    let intrinsics = Intrinsics {
        width: number("w") as usize,
        height: number("h") as usize,
        fx: number("fl_x"),
        fy: number("fl_y"),
        cx: number("cx"),
        cy: number("cy"),
    };
    let mut truth = Truth {
        images: Vec::new(),
        cameras: Vec::new(),
        depth: Vec::new(),
        moving: Vec::new(),
    };
    for frame in json["frames"].as_array().unwrap().iter().take(limit) {
        let open = |key: &str| image::open(dir.join(frame[key].as_str().unwrap())).unwrap();
        let rgb = open("file_path").into_rgb8();
        let (w, h) = (rgb.width() as usize, rgb.height() as usize);
        truth
            .images
            .push(Plane::from_vec(w, h, rgb.pixels().map(|p| p.0).collect()).unwrap());
        let depth = open("depth_file_path").into_luma16();
        truth
            .depth
            .push(Plane::from_vec(w, h, depth.pixels().map(|p| f32::from(p.0[0]) / 1000.0).collect()).unwrap());
        let mask = open("mask_path").into_luma8();
        truth
            .moving
            .push(Plane::from_vec(w, h, mask.pixels().map(|p| p.0[0]).collect()).unwrap());
        let m = Matrix4::from_fn(|r, c| frame["transform_matrix"][r][c].as_f64().unwrap());
        let flip = Matrix4::from_diagonal(&nalgebra::Vector4::new(1.0, -1.0, -1.0, 1.0));
        truth.cameras.push(Camera {
            intrinsics,
            c2w: Se3::from_matrix(&(m * flip)),
        });
    }
    Some(truth)
}

/// What a good sparse half would give: static points followed for a few frames with noise, no verdicts
/// on what moves.
fn oracle_sparse(truth: &Truth) -> SparseReconstruction {
    let mut rng = CounterRng::new(1, 2, 3);
    let n = truth.images.len();
    let (w, h) = truth.images[0].size();
    let mut tracks = Vec::new();
    for _ in 0..40 * n {
        let (first, x, y) = (rng.below(n), rng.below(w), rng.below(h));
        if truth.moving[first][(x, y)] != 0 {
            continue;
        }
        let z = f64::from(truth.depth[first][(x, y)]);
        let point = truth.cameras[first].unproject(x as f64, y as f64, z);
        let mut observations = Vec::new();
        for i in first..(first + 10).min(n) {
            let ([u, v], z) = truth.cameras[i].project(&point);
            if !(u >= 0.0 && v >= 0.0 && u < w as f64 - 1.0 && v < h as f64 - 1.0) {
                break;
            }
            let pixel = (u.round() as usize, v.round() as usize);
            if truth.moving[i][pixel] != 0 || (f64::from(truth.depth[i][pixel]) / z - 1.0).abs() > 0.02 {
                break;
            }
            observations.push([(u + 0.3 * rng.normal()) as f32, (v + 0.3 * rng.normal()) as f32]);
        }
        tracks.push(Track {
            first_frame: first,
            observations,
            motion: Motion::Static,
            point: Some(point),
            residual_px: 0.3,
        });
    }
    SparseReconstruction {
        cameras: truth.cameras.clone(),
        tracks,
        camera_motion: CameraMotion::Parallax,
        residual_px: 0.3,
        warnings: Vec::new(),
    }
}

struct Score {
    fixed: f64,
    moving: f64,
    covered: f64,
    iou: f64,
    precision: f64,
    recall: f64,
}

/// Median of true over estimated disparity of static pixels.
fn factor(truth: &Truth, stages: &Stages) -> f32 {
    let (w, h) = (stages.width, stages.height);
    let mut ratios = Vec::new();
    for i in 0..truth.images.len() {
        let (fw, fh) = truth.images[i].size();
        for p in (0..w * h).step_by(7) {
            let at = ((2 * (p % w) + 1) * fw / (2 * w), (2 * (p / w) + 1) * fh / (2 * h));
            if truth.moving[i][at] == 0 && truth.depth[i][at] > 0.0 {
                ratios.push(1.0 / truth.depth[i][at] / stages.filled[i][p]);
            }
        }
    }
    super::shot::quantile(&mut ratios, 0.5).unwrap_or(1.0)
}

fn score(truth: &Truth, stages: &Stages, disparity: &[Vec<f32>], keep: &dyn Fn(usize, usize) -> bool) -> Score {
    let (w, h) = (stages.width, stages.height);
    let (mut sum, mut count, mut total) = ([0.0f64; 2], [0usize; 2], [0usize; 2]);
    let factor = f64::from(factor(truth, stages));
    let (mut both, mut found, mut there) = (0usize, 0usize, 0usize);
    for i in 0..truth.images.len() {
        let (fw, fh) = truth.images[i].size();
        for y in 0..h {
            for x in 0..w {
                let at = ((2 * x + 1) * fw / (2 * w), (2 * y + 1) * fh / (2 * h));
                let m = truth.moving[i][at] != 0;
                let p = y * w + x;
                let z = f64::from(truth.depth[i][at]);
                total[usize::from(m)] += 1;
                if z > 0.0 && keep(i, p) {
                    sum[usize::from(m)] += (1.0 / f64::from(disparity[i][p]) / factor - z).abs() / z;
                    count[usize::from(m)] += 1;
                }
                let f = stages.moving[i][p] != 0;
                both += usize::from(m && f);
                found += usize::from(f);
                there += usize::from(m);
            }
        }
    }
    let share = |a: usize, b: usize| a as f64 / b.max(1) as f64;
    Score {
        fixed: sum[0] / count[0].max(1) as f64,
        moving: sum[1] / count[1].max(1) as f64,
        covered: share(count[0], total[0]),
        iou: share(both, found + there - both),
        precision: share(both, found),
        recall: share(both, there),
    }
}

/// Every eighth frame: for each true part, its pixels and the estimated depth over the true (quantiles 0.1, 0.5, 0.9).
fn parts(truth: &Truth, stages: &Stages) {
    let (w, h) = (stages.width, stages.height);
    let factor = factor(truth, stages);
    for i in (0..truth.images.len()).step_by(8) {
        let (fw, fh) = truth.images[i].size();
        let at = |p: usize| ((2 * (p % w) + 1) * fw / (2 * w), (2 * (p / w) + 1) * fh / (2 * h));
        let mask: Vec<u8> = (0..w * h).map(|p| truth.moving[i][at(p)]).collect();
        let mut line = format!("  frame {i}:");
        for pixels in super::components::Components::of(w, h, &mask).pixels {
            if pixels.len() < 200 {
                continue;
            }
            let mut ratios: Vec<f32> = pixels
                .iter()
                .map(|&p| 1.0 / stages.disparity[i][p as usize] / factor / truth.depth[i][at(p as usize)])
                .collect();
            let q: Vec<f32> = [0.1, 0.5, 0.9]
                .iter()
                .map(|&q| super::shot::quantile(&mut ratios, q).unwrap())
                .collect();
            line += &format!(" [{} px {:.2} {:.2} {:.2}]", pixels.len(), q[0], q[1], q[2]);
        }
        eprintln!("{line}");
    }
}

fn turbo(t: f32) -> [u8; 3] {
    let t = t.clamp(0.0, 1.0);
    let c = |m: f32| (255.0 * (1.5 - (4.0 * t - m).abs()).clamp(0.0, 1.0)) as u8;
    [c(3.0), c(2.0), c(1.0)]
}

fn montage(truth: &Truth, stages: &Stages, i: usize, path: &Path) {
    let (w, h) = (stages.width, stages.height);
    let (fw, fh) = truth.images[i].size();
    let factor = if truth.depth.is_empty() {
        1.0
    } else {
        factor(truth, stages)
    };
    let r = stages.shots[i].range;
    let shade = |d: f32| turbo((d - r.least) / (r.step * r.count as f32));
    let mut out = image::RgbImage::new(3 * w as u32, 3 * h as u32);
    for y in 0..h {
        for x in 0..w {
            let p = y * w + x;
            let at = ((2 * x + 1) * fw / (2 * w), (2 * y + 1) * fh / (2 * h));
            let rgb = truth.images[i][at];
            let confidence = stages.measured[i].confidence[p];
            let flow = stages.flows.get(i).map_or([0; 3], |f| {
                let (u, v) = (f.forward.u[p], f.forward.v[p]);
                [(128.0 + 10.0 * u) as u8, (128.0 + 10.0 * v) as u8, 128]
            });
            let tint = |m: bool| if m { [255, rgb[1] / 2, rgb[2] / 2] } else { rgb };
            let cells = [
                tint(truth.moving.get(i).is_some_and(|m| m[at] != 0)),
                truth.depth.get(i).map_or(rgb, |d| shade(1.0 / d[at] / factor)),
                flow,
                tint(stages.moving[i][p] != 0),
                shade(stages.disparity[i][p]),
                shade(stages.swept[i].disparity[p]),
                [(255.0 * confidence) as u8; 3],
                shade(stages.filled[i][p]),
                if confidence > 0.0 {
                    shade(stages.measured[i].disparity[p])
                } else {
                    [0; 3]
                },
            ];
            for (k, cell) in cells.into_iter().enumerate() {
                out.put_pixel((x + (k % 3) * w) as u32, (y + (k / 3) * h) as u32, image::Rgb(cell));
            }
        }
    }
    out.save(path).unwrap();
}

/// The default settings, changed by `DENSE_SET="motion.threshold=3 flow.patch_px=6"`.
fn config() -> DenseConfig {
    let mut json = serde_json::to_value(DenseConfig::default()).unwrap();
    for set in std::env::var("DENSE_SET").unwrap_or_default().split_whitespace() {
        let (path, value) = set.split_once('=').unwrap();
        let mut at = &mut json;
        for key in path.split('.') {
            at = at.get_mut(key).unwrap();
        }
        *at = serde_json::from_str(value).unwrap();
    }
    serde_json::from_value(json).unwrap()
}

#[test]
#[ignore = "a measurement, with pictures; needs the benchmark scenes"]
fn measure_stages() {
    let shared = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/bench"));
    let scenes = std::env::var("DENSE_SCENES").unwrap_or("mill-1 quad-1".to_owned());
    let limit = std::env::var("DENSE_FRAMES").map_or(32, |v| v.parse().unwrap());
    let out = std::env::var("DENSE_OUT").ok().map(PathBuf::from);
    for scene in scenes.split_whitespace() {
        let Some(truth) = load(&shared.join(scene), limit) else {
            eprintln!("skipped: no {scene}");
            continue;
        };
        let images: Vec<&RgbImage> = truth.images.iter().collect();
        let estimate = truth.cameras.is_empty() || std::env::var("DENSE_CAMERAS").is_ok();
        let sparse = if estimate {
            let found = crate::sparse::reconstruct(&images, &crate::sparse::SparseConfig::default(), &Silent).unwrap();
            eprintln!(
                "{scene}: {:?}, {:.2} px, {:?}",
                found.camera_motion, found.residual_px, found.warnings
            );
            found
        } else {
            oracle_sparse(&truth)
        };
        let start = std::time::Instant::now();
        let stages = run(
            &images,
            &sparse,
            &Sources::flow(&InverseSearch::default()),
            &Given::default(),
            &config(),
            &Silent,
        )
        .unwrap();
        let seconds = start.elapsed().as_secs_f64();
        if let Some(out) = &out {
            std::fs::create_dir_all(out).unwrap();
            let name = Path::new(scene).file_name().unwrap().to_str().unwrap();
            for i in [0, truth.images.len() / 3, 2 * truth.images.len() / 3] {
                montage(&truth, &stages, i, &out.join(format!("{name}-{i:03}.png")));
            }
        }
        if truth.depth.is_empty() {
            eprintln!("{scene}: {} frames, {seconds:.1} s", truth.images.len());
            continue;
        }
        if std::env::var("DENSE_PARTS").is_ok() {
            parts(&truth, &stages);
        }
        let swept: Vec<Vec<f32>> = stages.swept.iter().map(|s| s.disparity.clone()).collect();
        let measured: Vec<Vec<f32>> = stages.measured.iter().map(|s| s.disparity.clone()).collect();
        let any = |_: usize, _: usize| true;
        let sure = |i: usize, p: usize| stages.measured[i].confidence[p] > 0.0;
        eprintln!("{scene}: {} frames, {seconds:.1} s", truth.images.len());
        for (name, disparity, keep) in [
            ("swept", &swept, &any as &dyn Fn(usize, usize) -> bool),
            ("swept, sure", &swept, &sure),
            ("measured", &measured, &sure),
            ("filled", &stages.filled, &any),
            ("final", &stages.disparity, &any),
        ] {
            let s = score(&truth, &stages, disparity, keep);
            eprintln!(
                "  {name:<12} static {:.4} moving {:.4} covered {:.3} | iou {:.3} precision {:.3} recall {:.3}",
                s.fixed, s.moving, s.covered, s.iou, s.precision, s.recall
            );
        }
    }
}
