//! Seconds, arithmetic and memory of the networks for optical flow on this machine.
//!
//! ```text
//! cargo run --release -p m4_nets --example flow_speed -- gmflow WEIGHTS|formula [WIDTHxHEIGHT...]
//! cargo run --release -p m4_nets --example flow_speed -- raft WEIGHTS|formula [WIDTHxHEIGHT...]
//! ```
//!
//! `formula` are weights that are no good for flow: they take as long.
#![expect(clippy::print_stdout, reason = "the table is what it is for")]

use m4_nets::{GmFlow, Raft, cpu};
use m4_scene::{Plane, RgbImage};
use m4_testkit::write_formula_weights;
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

/// As `MegaSaM` runs RAFT.
const ITERATIONS: usize = 22;

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
fn gmflow_operations(width: usize, height: usize) -> (f64, f64) {
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

/// The same of encoding a picture with both encoders, and of both directions of a pair. Of the recurrent unit, what the context
/// gives counts once.
fn raft_operations(width: usize, height: usize) -> (f64, f64) {
    let up = |side: usize| side.next_multiple_of(8).max(128) as f64;
    let pixels = up(width) * up(height);
    let (half, quarter, eighth) = (pixels / 4.0, pixels / 16.0, pixels / 64.0);
    let encoder = half * (147.0 * 64.0 + 4.0 * 576.0 * 64.0)
        + quarter * (576.0 * 96.0 + 64.0 * 96.0 + 3.0 * 864.0 * 96.0)
        + eighth * (864.0 * 128.0 + 96.0 * 128.0 + 3.0 * 1152.0 * 128.0 + 128.0 * 256.0);
    let lookup = 4.0 * 100.0 * 256.0;
    let motion = 324.0 * 256.0 + 2304.0 * 192.0 + 98.0 * 128.0 + 1152.0 * 64.0 + 2304.0 * 126.0;
    let unit = 2.0 * (256.0 + 128.0) * 5.0 * 256.0;
    let head = 1152.0 * 256.0 + 2304.0 * 2.0;
    let once = 2.0 * 384.0 * 5.0 * 128.0 + 1152.0 * 256.0 + 256.0 * 576.0;
    let pair = 2.0 * eighth * (ITERATIONS as f64 * (lookup + motion + unit + head) + once);
    (2.0 * 2.0 * encoder, 2.0 * pair)
}

fn gmflow(weights: &Path, size: &str, [a, b]: [RgbImage; 2]) -> Result<(), Box<dyn Error>> {
    let net = GmFlow::load(weights, cpu())?;
    PEAK.reset_peak_usage();
    let encode = seconds(|| Ok(net.encode(&a)?))?;
    let (fa, fb) = (net.encode(&a)?, net.encode(&b)?);
    let pair = seconds(|| Ok(net.flow_between(&fa, &fb)?))?;
    let both = seconds(|| Ok(net.flow_both(&fa, &fb)?))?;
    let (encode_ops, pair_ops) = gmflow_operations(a.width(), a.height());
    println!(
        "{size:<10} encode {encode:6.2} s ({:4.0} GFLOP/s), one direction {pair:6.2} s ({:4.0} GFLOP/s), both {both:6.2} s, \
         peak {:.0} MB",
        encode_ops / encode / 1e9,
        pair_ops / pair / 1e9,
        PEAK.peak_usage_as_mb()
    );
    Ok(())
}

fn raft(weights: &Path, size: &str, [a, b]: [RgbImage; 2]) -> Result<(), Box<dyn Error>> {
    let net = Raft::load(weights, cpu())?;
    PEAK.reset_peak_usage();
    let encode = seconds(|| Ok(net.encode(&a)?))?;
    let (fa, fb) = (net.encode(&a)?, net.encode(&b)?);
    let both = seconds(|| Ok(net.flow_both(&fa, &fb, ITERATIONS, None)?))?;
    let (encode_ops, pair_ops) = raft_operations(a.width(), a.height());
    println!(
        "{size:<10} encode {encode:6.2} s ({:4.0} GFLOP/s), both directions {both:6.2} s ({:4.0} GFLOP/s, {:.0} GFLOP), peak {:.0} MB",
        encode_ops / encode / 1e9,
        pair_ops / both / 1e9,
        pair_ops / 1e9,
        PEAK.peak_usage_as_mb()
    );
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [network, weights, sizes @ ..] = args.as_slice() else {
        return Err("give the network (gmflow or raft) and the file of its weights".into());
    };
    let folder = tempfile::TempDir::new()?;
    let made = folder.path().join("weights.safetensors");
    let (run, keys): (fn(&Path, &str, [RgbImage; 2]) -> _, _) = match network.as_str() {
        "gmflow" => (gmflow, include_str!("../../../fixtures/gmflow/keys.txt")),
        "raft" => (raft, include_str!("../../../fixtures/raft/keys.txt")),
        other => return Err(format!("there is no network {other}: gmflow or raft").into()),
    };
    let weights = if weights == "formula" {
        write_formula_weights(keys, &made);
        made.as_path()
    } else {
        Path::new(weights)
    };
    for size in sizes {
        let (w, h) = size.split_once('x').ok_or("sizes are WIDTHxHEIGHT")?;
        let (w, h): (usize, usize) = (w.parse()?, h.parse()?);
        run(weights, size, [picture(w, h, 0.0), picture(w, h, 3.0)])?;
    }
    Ok(())
}
