//! Seconds and memory of MobileSAM on this machine.
//!
//! ```text
//! cargo run --release -p m4_nets --example sam_speed -- WEIGHTS [WIDTHxHEIGHT...]
//! ```
#![expect(clippy::print_stdout, reason = "the table is what it is for")]

use m4_nets::{MobileSam, PointPrompt, Prompt, cpu};
use m4_scene::{Plane, RgbImage};
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

/// Tries, of which the fastest counts.
const TRIES: usize = 3;

fn seconds<T>(work: impl Fn() -> Result<T, Box<dyn Error>>) -> Result<f64, Box<dyn Error>> {
    let mut best = f64::INFINITY;
    for _ in 0..TRIES {
        let start = Instant::now();
        work()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(best)
}

/// A disc on waves.
fn picture(width: usize, height: usize) -> RgbImage {
    Plane::from_fn(width, height, |x, y| {
        let (dx, dy) = (x as f32 - width as f32 / 2.0, y as f32 - height as f32 / 2.0);
        if dx.hypot(dy) < height as f32 / 4.0 {
            return [220, 60, 40];
        }
        [0.031, 0.017, 0.007].map(|f: f32| (127.0 + 50.0 * (dx * f).sin() * (dy * f * 0.7).cos()) as u8)
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (weights, sizes) = args.split_first().ok_or("give the file of weights")?;
    let net = MobileSam::load(Path::new(weights), cpu())?;
    println!("size       encode s  masks s  to the picture's size s  peak MB  disc found, IoU");
    for size in sizes {
        let (w, h) = size.split_once('x').ok_or("sizes are WIDTHxHEIGHT")?;
        let (w, h): (usize, usize) = (w.parse()?, h.parse()?);
        let image = picture(w, h);
        let centre = PointPrompt {
            at_px: [w as f32 / 2.0, h as f32 / 2.0],
            on_object: true,
        };
        let prompt = Prompt {
            points: vec![centre],
            ..Prompt::default()
        };
        PEAK.reset_peak_usage();
        let encode = seconds(|| Ok(net.encode(&image)?))?;
        let embedding = net.encode(&image)?;
        let decode = seconds(|| Ok(net.masks(&embedding, &prompt)?))?;
        let masks = net.masks(&embedding, &prompt)?;
        let best = masks.iter().skip(1).max_by(|a, b| a.iou.total_cmp(&b.iou));
        let best = best.ok_or("no masks")?;
        let enlarge = seconds(|| Ok(best.picture_logits()))?;
        let logits = best.picture_logits();
        let truth = image.data().iter().map(|&pixel| pixel == [220, 60, 40]);
        let pairs = logits.data().iter().map(|&x| x > 0.0).zip(truth);
        let (both, either) = pairs.fold((0, 0), |(both, either), (a, b)| {
            (both + usize::from(a && b), either + usize::from(a || b))
        });
        println!(
            "{size:<10} {encode:8.2} {decode:8.3} {enlarge:24.3} {:8.0}  {:.3}",
            PEAK.peak_usage_as_mb(),
            both as f64 / either as f64
        );
    }
    Ok(())
}
