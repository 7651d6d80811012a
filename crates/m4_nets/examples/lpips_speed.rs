//! Milliseconds and memory of LPIPS on this machine.
//!
//! ```text
//! cargo run --release -p m4_nets --example lpips_speed -- alex|vgg WEIGHTS [WIDTHxHEIGHT...]
//! ```
#![expect(clippy::print_stdout, reason = "the table is what it is for")]

use m4_nets::{Lpips, LpipsNet, LpipsPicture, cpu};
use m4_scene::Plane;
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

/// Tries, of which the fastest and the middle one are shown.
const TRIES: usize = 5;

/// Waves of sRGB values.
fn picture(width: usize, height: usize, phase: f32) -> LpipsPicture {
    LpipsPicture::from(&Plane::from_fn(width, height, |x, y| {
        let (x, y) = (x as f32 + phase, y as f32);
        [0.131, 0.057, 0.017].map(|f: f32| (127.0 + 100.0 * (x * f).sin() * (y * f * 0.7).cos()) as u8)
    }))
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [net, weights, sizes @ ..] = &args[..] else {
        return Err("give alex or vgg, the file of weights, and sizes".into());
    };
    let net = match net.as_str() {
        "alex" => LpipsNet::Alex,
        "vgg" => LpipsNet::Vgg,
        other => return Err(format!("{other} is neither alex nor vgg").into()),
    };
    let lpips = Lpips::load(net, Path::new(weights), cpu())?;
    println!("size       fastest ms  middle ms  peak MB  distance");
    for size in sizes {
        let (w, h) = size.split_once('x').ok_or("sizes are WIDTHxHEIGHT")?;
        let (w, h): (usize, usize) = (w.parse()?, h.parse()?);
        let (image, reference) = (picture(w, h, 3.0), picture(w, h, 0.0));
        PEAK.reset_peak_usage();
        let mut distance = 0.0;
        let mut times = Vec::with_capacity(TRIES);
        for _ in 0..TRIES {
            let start = Instant::now();
            distance = lpips.compare(&image, &reference)?.distance;
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        times.sort_by(f64::total_cmp);
        let (fastest, middle) = (times[0], times[TRIES / 2]);
        let peak = PEAK.peak_usage_as_mb();
        println!("{size:<10} {fastest:10.0} {middle:10.0} {peak:8.0}  {distance:.4}");
    }
    Ok(())
}
