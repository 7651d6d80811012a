//! Seconds, operations a second and memory of SAM 2.1 on this machine, beside what its matrix products reach.
//!
//! ```text
//! cargo run --release -p m4_nets --example sam2_speed [-- tiny|small|base_plus|large ...]
//! ```
//!
//! Weights come from a formula, in a temporary file (0.9 GB for the large size). Operations of the image encoder, the mask decoder and the
//! memory encoder are those of upstream's modules, as counted there; those of memory attention are of what is computed here, by a formula. Two
//! count for a product and its sum. The share of the bound is of the time that cores spent, so that other work on the machine disturbs it
//! little.
#![expect(clippy::print_stdout, reason = "the table is what it is for")]

use burn_core::tensor::{Device, Distribution, Tensor};
use cpu_time::ProcessTime;
use m4_nets::sam2::{Clip, Direction, VideoOptions, VideoPredictor};
use m4_nets::{PointPrompt, Prompt, Sam2, Sam2Size, cpu};
use m4_scene::{Plane, RgbImage, Silent};
use m4_testkit::FormulaWeights;
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

const KEYS: [&str; 4] = [
    include_str!("../../../fixtures/sam2/tiny.keys.txt"),
    include_str!("../../../fixtures/sam2/small.keys.txt"),
    include_str!("../../../fixtures/sam2/base_plus.keys.txt"),
    include_str!("../../../fixtures/sam2/large.keys.txt"),
];
/// Thousand millions of operations of the image encoders, the mask decoder and the memory encoder.
const ENCODER: [f64; 4] = [292.0, 360.0, 647.0, 1823.0];
const DECODER: f64 = 3.6;
const MEMORY_ENCODER: f64 = 11.6;
/// The frame.
const FRAME: (usize, usize) = (854, 480);

/// Seconds of the clock, and of all cores together.
#[derive(Clone, Copy)]
struct Spent {
    wall: f64,
    cores: f64,
}

/// The least of two runs of `work`.
fn spent(mut work: impl FnMut() -> Result<(), Box<dyn Error>>) -> Result<Spent, Box<dyn Error>> {
    let mut best = Spent {
        wall: f64::INFINITY,
        cores: f64::INFINITY,
    };
    for _ in 0..2 {
        let (wall, cores) = (Instant::now(), ProcessTime::now());
        work()?;
        best.wall = best.wall.min(wall.elapsed().as_secs_f64());
        best.cores = best.cores.min(cores.elapsed().as_secs_f64());
    }
    Ok(best)
}

/// Thousand millions of operations a second and core of a product of matrices.
fn bound(n: usize, k: usize, m: usize, device: &Device) -> Result<f64, Box<dyn Error>> {
    let random = |shape: [usize; 2]| Tensor::<2>::random(shape, Distribution::Default, device);
    let (a, b) = (random([n, k]), random([k, m]));
    let product = || {
        a.clone().matmul(b.clone()).into_data();
        Ok(())
    };
    Ok(2.0 * (n * k * m) as f64 / spent(product)?.cores / 1e9)
}

/// Thousand millions of operations of memory attention to `memories` frames and `pointers`.
fn attention(memories: f64, pointers: f64) -> f64 {
    let (n, c, small, wide) = (4096.0, 256.0, 64.0, 2048.0);
    let m = memories * n + 4.0 * pointers;
    let among = 4.0 * n * c * c + 2.0 * n * n * c;
    let to = 2.0 * n * c * c + m * small * c + n * m * (c + small) + n * small * c;
    4.0 * 2.0 * (among + to + 2.0 * n * c * wide) / 1e9
}

/// A disc that moves before a floor of waves.
fn frame(i: usize) -> RgbImage {
    let (width, height) = FRAME;
    Plane::from_fn(width, height, |x, y| {
        let (dx, dy) = (
            x as f32 - width as f32 / 2.0 - 5.0 * i as f32,
            y as f32 - height as f32 / 2.0,
        );
        if dx.hypot(dy) < height as f32 / 4.0 {
            return [220, 60, 40];
        }
        [0.031, 0.017, 0.007].map(|f: f32| (127.0 + 50.0 * (dx * f).sin() * (dy * f * 0.7).cos()) as u8)
    })
}

fn row(name: &str, operations: f64, spent: Spent, bound: f64) {
    let rate = operations / spent.cores;
    println!(
        "{name:<34} {operations:7.0} {:8.0} {:8.2} {rate:8.0} {:6.0}% {:8.0}",
        1e3 * spent.wall,
        spent.cores,
        100.0 * rate / bound,
        PEAK.peak_usage_as_mb()
    );
    PEAK.reset_peak_usage();
}

fn less(a: Spent, b: Spent) -> Spent {
    Spent {
        wall: a.wall - b.wall,
        cores: a.cores - b.cores,
    }
}

fn measure(size: Sam2Size, which: usize, path: &Path, bound: f64) -> Result<(), Box<dyn Error>> {
    let (keys, encoder) = (KEYS[which], ENCODER[which]);
    // all objects are there
    let weights = FormulaWeights::of_keys(keys).with("sam_mask_decoder.pred_obj_score_head.layers.2.bias", &[5.0]);
    weights.write(path);
    drop(weights);
    let net = Arc::new(Sam2::load(path, cpu())?);
    println!("{}: {:.0} MB", size.name(), PEAK.current_usage_as_mb());
    PEAK.reset_peak_usage();

    let image = frame(0);
    let encode = spent(|| {
        net.encode(&image)?;
        Ok(())
    })?;
    row("image encoder", encoder, encode, bound);
    let features = net.encode(&image)?;
    let centre = PointPrompt {
        at_px: [427.0, 240.0],
        on_object: true,
    };
    let prompt = Prompt {
        points: vec![centre],
        ..Prompt::default()
    };
    let decode = spent(|| {
        net.masks(&features, &prompt)?;
        Ok(())
    })?;
    row("mask decoder", DECODER, decode, bound);

    let clip = Clip {
        frames: 40,
        width: FRAME.0,
        height: FRAME.1,
    };
    for objects in [1, 4] {
        let pictures = Box::new(|i| Ok(frame(i)));
        let mut predictor = VideoPredictor::new(Arc::clone(&net), clip, pictures, VideoOptions::default())?;
        let mut remember = Spent { wall: 0.0, cores: 0.0 };
        for object in 0..objects {
            predictor.show(0, object, &prompt)?;
        }
        // pending masks become memories, once
        let (wall, cores) = (Instant::now(), ProcessTime::now());
        predictor.follow(0..=0, Direction::Forward, &Silent, |_, _| ())?;
        remember.wall += wall.elapsed().as_secs_f64();
        remember.cores += cores.elapsed().as_secs_f64();
        let count = f64::from(objects);
        row(
            &format!("memory encoder, {objects} objects"),
            count * MEMORY_ENCODER,
            remember,
            bound,
        );
        let last = if objects == 1 { 16 } else { 7 };
        predictor.follow(1..=last, Direction::Forward, &Silent, |_, _| ())?;
        PEAK.reset_peak_usage();
        // the last frame's features are known
        let follow = spent(|| Ok(predictor.follow(last..=last, Direction::Forward, &Silent, |_, _| ())?))?;
        let pointers = last as f64 + 1.0;
        let operations = count * attention(7.0, pointers.min(16.0));
        let others = count * (DECODER + MEMORY_ENCODER);
        row(
            &format!("follow, {objects} objects"),
            operations + others,
            follow,
            bound,
        );
        if objects == 1 {
            let alone = less(less(follow, decode), remember);
            row("  of that memory attention", operations, alone, bound);
            println!("a frame with one object: {:.1} s", encode.wall + follow.wall);
        }
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let asked: Vec<String> = std::env::args().skip(1).collect();
    let device = cpu();
    println!("matrix products, GFLOP/s of a core:");
    for (n, k, m) in [
        (4096, 256, 2048),
        (256, 256, 28_700),
        (256, 28_700, 64),
        (2048, 2048, 2048),
    ] {
        println!("  {n} x {k} x {m}: {:.0}", bound(n, k, m, &device)?);
    }
    let bound = bound(2048, 2048, 2048, &device)?;
    println!("part                                 GFLOP       ms   core s  GFLOP/s of a core, of the bound, peak MB");
    let folder = tempfile::TempDir::new()?;
    let path = folder.path().join("weights.safetensors");
    for (i, size) in Sam2Size::ALL.into_iter().enumerate() {
        if asked.is_empty() || asked.iter().any(|a| a == size.name()) {
            measure(size, i, &path, bound)?;
        }
    }
    Ok(())
}
