//! Seconds, operations a second and memory of TAPIP3D on this machine, beside what its matrix products reach.
//!
//! ```text
//! cargo run --release -p m4_nets --example tapip3d_speed [-- COLUMNS ROWS QUERIES]
//! ```
//!
//! Weights come from a formula. A clip of one window is followed without iterations, which is what frames and queries cost alone, and
//! with one. Operations are counted by formulas: those of matrix products and convolutions as upstream's modules state them, two for
//! a product and its sum. The share of the bound is of the time that cores spent, so that other work on the machine disturbs it
//! little.
#![expect(clippy::print_stdout, reason = "the table is what it is for")]

use burn_core::tensor::{Device, Distribution, Tensor};
use cpu_time::ProcessTime;
use m4_math::Se3;
use m4_math::nalgebra::Vector3;
use m4_nets::tapip3d::ClipError;
use m4_nets::{PointQuery, PosedClip, Tapip3d, Tapip3dOptions, cpu};
use m4_scene::{Camera, DepthMap, Intrinsics, Plane, RgbImage, Silent};
use m4_testkit::FormulaWeights;
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::time::Instant;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

const KEYS: &str = include_str!("../../../fixtures/tapip3d/keys.txt");
const CONFIG: &str = include_str!("../../../fixtures/tapip3d/config.json");
/// Frames of a window.
const FRAMES: usize = 16;

/// Seconds of the clock, and of all cores together.
#[derive(Clone, Copy)]
struct Spent {
    wall: f64,
    cores: f64,
}

/// The least of some runs of `work`.
fn spent<T>(runs: usize, mut work: impl FnMut() -> Result<T, Box<dyn Error>>) -> Result<Spent, Box<dyn Error>> {
    let mut best = Spent {
        wall: f64::INFINITY,
        cores: f64::INFINITY,
    };
    for _ in 0..runs {
        let (wall, cores) = (Instant::now(), ProcessTime::now());
        let _kept = work()?;
        best.wall = best.wall.min(wall.elapsed().as_secs_f64());
        best.cores = best.cores.min(cores.elapsed().as_secs_f64());
    }
    Ok(best)
}

/// Thousand millions of operations a second and core of a product of matrices.
fn bound(n: usize, device: &Device) -> Result<f64, Box<dyn Error>> {
    let random = || Tensor::<2>::random([n, n], Distribution::Default, device);
    let (a, b) = (random(), random());
    let spent = spent(5, || Ok(a.clone().matmul(b.clone())))?;
    Ok(2.0 * (n * n * n) as f64 / spent.cores / 1e9)
}

fn conv(pixels: usize, from: usize, to: usize, side: usize) -> f64 {
    2.0 * (pixels * from * to * side * side) as f64
}

/// Operations of the encoder.
fn encoder(w: usize, h: usize) -> f64 {
    let pixels = |step: usize| w.div_ceil(step) * h.div_ceil(step);
    let stage = |step: usize, from: usize, to: usize| {
        let p = pixels(step);
        conv(p, from, to, 3) + 3.0 * conv(p, to, to, 3) + conv(p, from, to, 1)
    };
    let quarter = (w / 4) * (h / 4);
    conv(pixels(2), 3, 64, 7)
        + 4.0 * conv(pixels(2), 64, 64, 3)
        + stage(4, 64, 96)
        + stage(8, 96, 128)
        + stage(16, 128, 128)
        + conv(quarter, 416, 256, 3)
        + conv(quarter, 256, 128, 1)
}

/// Operations of an iteration for a point in a frame.
fn iteration() -> f64 {
    let d = 128.0 * 128.0;
    let (own, near) = (33.0, 32.0);
    let offsets = near * (99.0 * 128.0 + d);
    let block = |x: f64, y: f64| x * 10.0 * d + y * 2.0 * d + 2.0 * x * y * 128.0;
    let pooled = |n: f64| 2.0 * d + n * 2.0 * d + 2.0 * n * 128.0;
    let level = offsets + block(own, near) + block(near, own) + pooled(own) + pooled(near);
    let h = 384.0 * 384.0;
    let layer = 24.0 * h + 2.0 * 16.0 * 384.0 + 4.0 * 64.0 * 384.0;
    2.0 * (4.0 * level + 711.0 * 384.0 + 3.0 * layer)
}

/// A wavy wall that a camera passes by.
struct Wall(usize, usize);

impl PosedClip for Wall {
    fn frames(&self) -> usize {
        FRAMES
    }

    fn picture(&self, frame: usize) -> Result<RgbImage, ClipError> {
        Ok(Plane::from_fn(self.0, self.1, |x, y| {
            let (x, y) = (x as f32 + 3.0 * frame as f32, y as f32);
            [0.11, 0.07, 0.03].map(|f: f32| (127.0 + 90.0 * (x * f).sin() * (y * f * 0.7).cos()) as u8)
        }))
    }

    fn depth(&self, frame: usize) -> Result<DepthMap, ClipError> {
        let z = |x: usize, y: usize| {
            let step = if x > self.0 / 2 && y > self.1 / 2 { 1.0 } else { 0.0 };
            3.0 + step + 0.4 * (x as f32 * 0.02 + frame as f32 * 0.1).sin() + 0.001 * y as f32
        };
        Ok(Plane::from_fn(self.0, self.1, z))
    }

    fn camera(&self, frame: usize) -> Result<Camera, ClipError> {
        Ok(Camera {
            intrinsics: Intrinsics::centred(self.0, self.1, self.0 as f64),
            c2w: Se3 {
                translation: Vector3::new(0.01 * frame as f64, 0.0, 0.0),
                ..Se3::identity()
            },
        })
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let asked: Vec<usize> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let [w, h, n] = asked[..].try_into().unwrap_or([512, 384, 128]);
    let folder = tempfile::TempDir::new()?;
    let path = folder.path().join("weights.safetensors");
    let weights = FormulaWeights::of_keys(KEYS).scaled("point_updater.flow_head.weight", 0.005);
    weights.write_with(Some(("config", CONFIG)), &path);
    let device = cpu();
    let net = Tapip3d::load(&path, &device)?;
    let bound = bound(2048, &device)?;
    println!("matrix products: {bound:.0} GFLOP/s of a core");
    let clip = Wall(w, h);
    let camera = clip.camera(0).map_err(|error| error as Box<dyn Error>)?;
    let queries: Vec<PointQuery> = (0..n)
        .map(|i| {
            let (u, v) = ((i * 37 % w) as f64, (i * 91 % h) as f64);
            let p = camera.unproject(u, v, 3.2);
            PointQuery {
                frame: 0,
                world: [p.x, p.y, p.z],
            }
        })
        .collect();
    let run = |iterations: usize| -> Result<Spent, Box<dyn Error>> {
        let options = Tapip3dOptions {
            iterations,
            support_grid: 0,
            ..Tapip3dOptions::at((w, h))
        };
        PEAK.reset_peak_usage();
        let spent = spent(2, || Ok(net.track(&clip, &queries, &options, &Silent)?))?;
        println!("  peak {:.0} MB", PEAK.peak_usage_as_mb());
        Ok(spent)
    };
    let row = |what: &str, wall: f64, cores: f64, operations: f64| {
        println!(
            "{what}: {:.1} GFLOP, {:.0} ms, {:.2} s of cores, {:.0} GFLOP/s of a core, {:.0}% of the bound",
            operations / 1e9,
            1e3 * wall,
            cores,
            operations / cores / 1e9,
            100.0 * operations / cores / 1e9 / bound
        );
    };
    let alone = run(0)?;
    let frames = FRAMES as f64;
    row(
        &format!("a frame of {w} x {h} with its depth"),
        alone.wall / frames,
        alone.cores / frames,
        encoder(w, h),
    );
    let once = run(1)?;
    let scale = 1000.0 / n as f64;
    row(
        &format!("an iteration of a window, a thousand points (of {n})"),
        (once.wall - alone.wall) * scale,
        (once.cores - alone.cores) * scale,
        iteration() * frames * 1000.0,
    );
    Ok(())
}
