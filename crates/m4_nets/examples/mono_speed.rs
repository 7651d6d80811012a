//! Seconds, operations a second and memory of Depth-Anything V1, MoGe-2 and UniDepth V2 on this machine, beside what its matrix products reach.
//!
//! ```text
//! cargo run --release -p m4_nets --example mono_speed [-- small|base|large|unidepth ...]
//! ```
//!
//! Weights come from a formula, in a temporary file (1.3 GB for a large network). Operations are counted by formulas: those of matrix
//! products and convolutions as upstream's modules state them, two for a product and its sum; of UniDepth those of its backbone alone. The share of the bound is of the time that cores
//! spent, so that other work on the machine disturbs it little.
#![expect(clippy::print_stdout, reason = "the table is what it is for")]

use burn_core::tensor::{Device, Distribution, Tensor};
use cpu_time::ProcessTime;
use m4_nets::{BackboneSize, DepthAnything, MoGe, MoGeError, MoGeOptions, UniDepth, cpu};
use m4_scene::{Plane, RgbImage};
use m4_testkit::FormulaWeights;
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

const DEPTH_ANYTHING: [&str; 3] = [
    include_str!("../../../fixtures/depth_anything_v1/vits.keys.txt"),
    include_str!("../../../fixtures/depth_anything_v1/vitb.keys.txt"),
    include_str!("../../../fixtures/depth_anything_v1/vitl.keys.txt"),
];
const MOGE: [&str; 3] = [
    include_str!("../../../fixtures/moge2/vits_normal.keys.txt"),
    include_str!("../../../fixtures/moge2/vitb_normal.keys.txt"),
    include_str!("../../../fixtures/moge2/vitl_normal.keys.txt"),
];
const UNIDEPTH: &str = include_str!("../../../fixtures/unidepth_v2/vitl.keys.txt");
/// The frame.
const FRAME: (usize, usize) = (854, 480);
/// Patches of MoGe-2.
const TOKENS: [usize; 2] = [1200, 1800];

/// Seconds of the clock, and of all cores together.
#[derive(Clone, Copy)]
struct Spent {
    wall: f64,
    cores: f64,
}

/// The least of some runs of `work`.
fn spent<T>(runs: usize, mut work: impl FnMut() -> T) -> Spent {
    let mut best = Spent {
        wall: f64::INFINITY,
        cores: f64::INFINITY,
    };
    for _ in 0..runs {
        let (wall, cores) = (Instant::now(), ProcessTime::now());
        let _kept = work();
        best.wall = best.wall.min(wall.elapsed().as_secs_f64());
        best.cores = best.cores.min(cores.elapsed().as_secs_f64());
    }
    best
}

fn random(shape: [usize; 2], device: &Device) -> Tensor<2> {
    Tensor::random(shape, Distribution::Default, device)
}

/// Thousand millions of operations a second and core of a product of matrices.
fn bound(n: usize, k: usize, m: usize, device: &Device) -> f64 {
    let (a, b) = (random([n, k], device), random([k, m], device));
    let spent = spent(5, || a.clone().matmul(b.clone()));
    2.0 * (n * k * m) as f64 / spent.cores / 1e9
}

/// Operations of a backbone with `n` patches, the class token beside them.
fn backbone(size: BackboneSize, n: f64) -> f64 {
    let (d, n) = (size.width() as f64, n + 1.0);
    // qkv, proj, two layers of four times the width; scores and their sums
    let block = 2.0 * n * d * d * (3.0 + 1.0 + 8.0) + 4.0 * n * n * d;
    size.depth() as f64 * block + 2.0 * n * d * 3.0 * 196.0
}

fn conv(pixels: f64, from: usize, to: usize, side: usize) -> f64 {
    2.0 * pixels * (from * to * side * side) as f64
}

/// Operations of the head of Depth-Anything over `h` by `w` patches.
fn dpt(size: BackboneSize, h: usize, w: usize) -> f64 {
    let (f, maps) = match size {
        BackboneSize::Small => (64, [48, 96, 192, 384]),
        BackboneSize::Base => (128, [96, 192, 384, 768]),
        BackboneSize::Large => (256, [256, 512, 1024, 1024]),
    };
    let n = (h * w) as f64;
    let pixels = [16.0 * n, 4.0 * n, n, (h.div_ceil(2) * w.div_ceil(2)) as f64];
    let mut sum: f64 = maps.iter().map(|&c| conv(n, size.width(), c, 1)).sum();
    sum += conv(n, maps[0], 16 * maps[0], 1) + conv(n, maps[1], 4 * maps[1], 1);
    sum += conv(pixels[3], maps[3], maps[3], 3);
    let mut next = 64.0 * n;
    for (level, (&p, &c)) in pixels.iter().zip(&maps).enumerate() {
        let convolutions = if level == 3 { 2.0 } else { 4.0 };
        sum += conv(p, c, f, 3) + convolutions * conv(p, f, f, 3) + conv(next, f, f, 1);
        next = p;
    }
    sum + conv(64.0 * n, f, f / 2, 3) + conv(196.0 * n, f / 2, 32, 3) + conv(196.0 * n, 32, 1, 1)
}

/// Operations of the neck and the three heads of MoGe-2 over `n` patches.
fn stacks(size: BackboneSize, n: f64) -> f64 {
    let width = size.width();
    let widths = [width, 256, 128, 64, 32];
    let pixels = |level: usize| n * 4f64.powi(level as i32);
    let up = |level: usize| {
        let (from, to, p) = (widths[level], widths[level + 1], pixels(level + 1));
        if level < 3 {
            conv(pixels(level), from, 4 * to, 1) + conv(p, to, to, 3)
        } else {
            conv(p, from, to, 3)
        }
    };
    let ups: f64 = (0..4).map(up).sum();
    let block: f64 = (1..4).map(|i| 2.0 * conv(pixels(i), widths[i], widths[i], 3)).sum();
    let neck = conv(n, width + 2, width, 1) + (1..5).map(|i| conv(pixels(i), 2, widths[i], 1)).sum::<f64>();
    let head: f64 = (0..5).map(|i| conv(pixels(i), widths[i], widths[i], 1)).sum();
    let ends = conv(pixels(4), 32, 3 + 3 + 1, 1);
    4.0 * conv(n, width, width, 1) + neck + 2.0 * block + ups + 3.0 * (head + block + ups) + ends
}

/// A disc before a floor of waves.
fn frame() -> RgbImage {
    let (width, height) = FRAME;
    Plane::from_fn(width, height, |x, y| {
        let (dx, dy) = (x as f32 - width as f32 / 2.0, y as f32 - height as f32 / 2.0);
        if dx.hypot(dy) < height as f32 / 4.0 {
            return [220, 60, 40];
        }
        [0.031, 0.017, 0.007].map(|f: f32| (127.0 + 50.0 * (dx * f).sin() * (dy * f * 0.7).cos()) as u8)
    })
}

struct Row<'a> {
    name: String,
    weights_mb: f64,
    operations: f64,
    bound: f64,
    run: &'a mut dyn FnMut() -> Result<(), Box<dyn Error>>,
}

fn report(row: Row<'_>) -> Result<(), Box<dyn Error>> {
    let Row {
        name,
        weights_mb,
        operations,
        bound,
        run,
    } = row;
    run()?;
    PEAK.reset_peak_usage();
    let runs = if operations > 4e11 { 2 } else { 3 };
    let mut failed = None;
    let spent = spent(runs, || failed = run().err());
    if let Some(error) = failed {
        return Err(error);
    }
    let rate = operations / spent.cores / 1e9;
    println!(
        "{name:<24} {:7.0} {:8.0} {:8.2} {rate:8.0} {:6.0}% {:8.0} {weights_mb:8.0}",
        operations / 1e9,
        1e3 * spent.wall,
        spent.cores,
        100.0 * rate / bound,
        f64::from(PEAK.peak_usage_as_mb()) - weights_mb
    );
    Ok(())
}

fn depth_anything(size: BackboneSize, keys: &str, path: &Path, bound: f64) -> Result<(), Box<dyn Error>> {
    FormulaWeights::of_keys(keys).write(path);
    let before = PEAK.current_usage_as_mb();
    let net = DepthAnything::load(path, cpu())?;
    let image = frame();
    report(Row {
        name: format!("Depth-Anything {}", size.name()),
        weights_mb: f64::from(PEAK.current_usage_as_mb() - before),
        operations: backbone(size, 31.0 * 54.0) + dpt(size, 31, 54),
        bound,
        run: &mut || {
            net.disparity(&image)?;
            Ok(())
        },
    })
}

fn moge(size: BackboneSize, keys: &str, path: &Path, bound: f64) -> Result<(), Box<dyn Error>> {
    FormulaWeights::of_keys(keys).write(path);
    let before = PEAK.current_usage_as_mb();
    let net = MoGe::load(path, cpu())?;
    let image = frame();
    for tokens in TOKENS {
        let aspect = FRAME.0 as f64 / FRAME.1 as f64;
        let (across, down) = (
            (tokens as f64 * aspect).sqrt().round(),
            (tokens as f64 / aspect).sqrt().round(),
        );
        let options = MoGeOptions {
            tokens: Some(tokens),
            known_focal_px: Some(700.0),
        };
        report(Row {
            name: format!("MoGe-2 {} {tokens}", size.name()),
            weights_mb: f64::from(PEAK.current_usage_as_mb() - before),
            operations: backbone(size, across * down) + stacks(size, across * down),
            bound,
            run: &mut || match net.infer(&image, &options) {
                // made-up weights need not see anything
                Ok(_) | Err(MoGeError::NothingValid) => Ok(()),
                Err(error) => Err(error.into()),
            },
        })?;
    }
    Ok(())
}

/// The picture as MegaSaM hands it over, in the network's 2,400 patches.
fn unidepth(path: &Path, bound: f64) -> Result<(), Box<dyn Error>> {
    FormulaWeights::of_keys(UNIDEPTH).write(path);
    let before = PEAK.current_usage_as_mb();
    let net = UniDepth::load(path, cpu())?;
    let full = frame();
    let (width, height) = (640, 640 * FRAME.1 / FRAME.0);
    let image = Plane::from_fn(width, height, |x, y| full[(x * FRAME.0 / width, y * FRAME.1 / height)]);
    report(Row {
        name: "UniDepth V2 ViT-L".to_owned(),
        weights_mb: f64::from(PEAK.current_usage_as_mb() - before),
        operations: backbone(BackboneSize::Large, 2400.0),
        bound,
        run: &mut || {
            net.depth(&image)?;
            Ok(())
        },
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let asked: Vec<String> = std::env::args().skip(1).collect();
    let device = cpu();
    println!("matrix products, GFLOP/s of a core:");
    for (n, k, m) in [
        (1675, 1024, 3072),
        (1675, 1024, 4096),
        (1675, 384, 1536),
        (2048, 2048, 2048),
    ] {
        println!("  {n} x {k} x {m}: {:.0}", bound(n, k, m, &device));
    }
    let bound = bound(2048, 2048, 2048, &device);
    println!(
        "network                    GFLOP       ms   core s  GFLOP/s of a core, of the bound, peak MB, weights MB"
    );
    let folder = tempfile::TempDir::new()?;
    let path = folder.path().join("weights.safetensors");
    for (i, size) in BackboneSize::ALL.into_iter().enumerate() {
        let name = ["small", "base", "large"][i];
        if !asked.is_empty() && !asked.iter().any(|a| a == name) {
            continue;
        }
        depth_anything(size, DEPTH_ANYTHING[i], &path, bound)?;
        moge(size, MOGE[i], &path, bound)?;
    }
    if asked.is_empty() || asked.iter().any(|a| a == "unidepth") {
        unidepth(&path, bound)?;
    }
    Ok(())
}
