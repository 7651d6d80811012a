//! Seconds, arithmetic and memory of GMFlow on this machine.
//!
//! ```text
//! cargo run --release -p m4_nets --example flow_speed -- WEIGHTS [WIDTHxHEIGHT...]
//! ```
#![expect(clippy::print_stdout, reason = "the table is what it is for")]

use m4_nets::{GmFlow, cpu};
use m4_scene::{Plane, RgbImage};
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

fn seconds<T>(work: impl Fn() -> Result<T, Box<dyn Error>>) -> Result<f64, Box<dyn Error>> {
    let mut best = f64::INFINITY;
    for _ in 0..3 {
        let start = Instant::now();
        work()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(best)
}

/// Waves that move by a few pixels.
fn picture(width: usize, height: usize, moved: f32) -> RgbImage {
    Plane::from_fn(width, height, |x, y| {
        let (x, y) = (x as f32 + moved, y as f32);
        [0.31, 0.17, 0.07].map(|f: f32| (127.0 + 90.0 * (x * f).sin() * (y * f * 0.7).cos()) as u8)
    })
}

/// Multiplications and additions of encoding a picture, and of what a pair adds, by the shapes of the layers.
fn operations(width: usize, height: usize) -> (f64, f64) {
    let up = |side: usize| side.next_multiple_of(32) as f64;
    let pixels = up(width) * up(height);
    let (half, quarter, eighth) = (pixels / 4.0, pixels / 16.0, pixels / 64.0);
    let encode = half * (147.0 * 64.0 + 4.0 * 576.0 * 64.0)
        + quarter * (576.0 * 96.0 + 64.0 * 96.0 + 3.0 * 864.0 * 96.0)
        + quarter * (864.0 * 128.0 + 96.0 * 128.0 + 3.0 * 1152.0 * 128.0 + 128.0 * 128.0)
        + (quarter + eighth) * 1152.0 * 128.0;
    let transformer = |tokens: f64, windows: f64| {
        let linear = 8.0 * 128.0 * 128.0 + 256.0 * 1024.0 + 1024.0 * 128.0;
        6.0 * 2.0 * tokens * (linear + 2.0 * 2.0 * 128.0 * tokens / windows)
    };
    let pair = transformer(eighth, 4.0)
        + 2.0 * eighth * eighth * 130.0
        + transformer(quarter, 64.0)
        + quarter * (90.0 * 128.0 + 4.0 * 128.0 * 128.0 + 1170.0 * 256.0 + 256.0 * 144.0);
    (2.0 * encode, 2.0 * pair)
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (weights, sizes) = args.split_first().ok_or("give the file of weights")?;
    let net = GmFlow::load(Path::new(weights), &cpu())?;
    println!("size       encode s (GFLOP/s)  pair s (GFLOP/s)  both directions s  peak MB");
    for size in sizes {
        let (w, h) = size.split_once('x').ok_or("sizes are WIDTHxHEIGHT")?;
        let (w, h): (usize, usize) = (w.parse()?, h.parse()?);
        let (a, b) = (picture(w, h, 0.0), picture(w, h, 3.0));
        PEAK.reset_peak_usage();
        let encode = seconds(|| Ok(net.encode(&a)?))?;
        let (fa, fb) = (net.encode(&a)?, net.encode(&b)?);
        let pair = seconds(|| Ok(net.flow_between(&fa, &fb)?))?;
        let both = seconds(|| Ok(net.flow_both(&fa, &fb)?))?;
        let (encode_ops, pair_ops) = operations(w, h);
        println!(
            "{size:<10} {encode:8.2} ({:5.0})    {pair:8.2} ({:5.0})  {both:16.2} {:8.0}",
            encode_ops / encode / 1e9,
            pair_ops / pair / 1e9,
            PEAK.peak_usage_as_mb()
        );
    }
    Ok(())
}
