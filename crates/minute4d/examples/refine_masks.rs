//! How much better masks become over time: intersection over union with the truth, of the masks of a capture as they are and refined.
//!
//! ```text
//! cargo run --release -p minute4d --example refine_masks -- SCENE CAPTURE [masks|motion] [none|mobilesam] [REFINE_JSON] [FOLLOW_JSON]
//! ```
//!
//! SCENE is a capture whose masks are true, CAPTURE one of the same frames whose masks are to be refined. `motion` takes these masks as a map of
//! motion of an eighth of the size, as a network gives it. Settings (JSON) replace the defaults.
#![forbid(unsafe_code)]
#![expect(clippy::print_stdout, reason = "an example says what it found")]

use minute4d::enhance::{Follower, masks};
use minute4d::geometry::Segmenter;
use minute4d::io::capture::{CaptureOptions, Split, read};
use minute4d::scene::{Capture, CompactMask, Plane, Silent};
use std::path::Path;
use std::time::Instant;

type Fault = Box<dyn std::error::Error>;

/// Side of what one number of a map of motion stands for, pixels.
const BLOCK: usize = 8;

fn main() -> Result<(), Fault> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [scene, capture] = args.get(..2).ok_or("give SCENE and CAPTURE")? else {
        return Err("give SCENE and CAPTURE".into());
    };
    let arg = |k: usize, default: &str| args.get(k).cloned().unwrap_or_else(|| default.to_owned());
    let load = |path: &str| read(Path::new(path), Split::Train, &CaptureOptions::default(), &Silent);
    let (truth, mut capture) = (load(scene)?, load(capture)?);
    let truth: Vec<CompactMask> = truth.frames.into_iter().filter_map(|frame| frame.mask).collect();
    if truth.len() != capture.frames.len() {
        return Err(format!("{} true masks for {} frames", truth.len(), capture.frames.len()).into());
    }
    line("as given", &truth, &capture);
    if arg(2, "masks") == "motion" {
        for frame in &mut capture.frames {
            frame.motion = frame.mask.as_ref().map(blocks);
        }
        let mut rough = capture.clone();
        for frame in &mut rough.frames {
            let motion = frame.motion.as_ref().ok_or("a frame has no mask")?;
            let (w, h) = frame.rgb.size();
            let share = motion.map(|&m| f32::from(m) / 255.0);
            let full = minute4d::slam::megasam::resize_bilinear(&share, w, h);
            frame.mask = Some(CompactMask::from_fn(w, h, |x, y| full[(x, y)] > 0.7));
        }
        line("map of an eighth, above 0.7", &truth, &rough);
    }
    let segmenter = match arg(3, "none").as_str() {
        "none" => Segmenter::None,
        "mobilesam" => Segmenter::Mobilesam,
        other => return Err(format!("{other} is no segmenter; none or mobilesam").into()),
    };
    let settings = serde_json::from_str(&arg(4, "{}"))?;
    let follower = Follower::load(segmenter, serde_json::from_str(&arg(5, "{}"))?)?;
    let start = Instant::now();
    let (found, report) = masks(
        capture,
        &settings,
        &follower.segmenter(),
        Some(follower.flow()),
        &Silent,
    )?;
    let seconds = start.elapsed().as_secs_f64();
    line(
        &format!("refined by {}, every {} frames", report.segmenter, report.every_frames),
        &truth,
        &found,
    );
    println!(
        "  {seconds:.1} s, {} things, {} parts refused, {:.4} of the pixels unexplained",
        report.instances.len(),
        report.rejected.len(),
        report.unexplained_share
    );
    if std::env::var_os("REFINE_REPORT").is_some() {
        println!("{}", minute4d::pretty_json(&report)?);
    }
    Ok(())
}

/// The share of each block that is set, 255 for all of it.
fn blocks(mask: &CompactMask) -> Plane<u8> {
    let (w, h) = mask.size();
    Plane::from_fn(w.div_ceil(BLOCK), h.div_ceil(BLOCK), |bx, by| {
        let pixels = (by * BLOCK..h.min((by + 1) * BLOCK))
            .flat_map(|y| (bx * BLOCK..w.min((bx + 1) * BLOCK)).map(move |x| (x, y)));
        let (set, all) = pixels.fold((0, 0), |(set, all), (x, y)| (set + usize::from(mask.at(x, y)), all + 1));
        (255 * set / all) as u8
    })
}

fn line(name: &str, truth: &[CompactMask], capture: &Capture) {
    let (mut both, mut found, mut there) = (0usize, 0usize, 0usize);
    for (truth, frame) in truth.iter().zip(&capture.frames) {
        if let Some(mask) = &frame.mask {
            both += mask.set_pixels().filter(|&(x, y)| truth.at(x, y)).count();
            found += mask.count();
            there += truth.count();
        }
    }
    let share = |a: usize, b: usize| a as f64 / b.max(1) as f64;
    println!(
        "{name:<45} IoU {:.3} precision {:.3} recall {:.3}",
        share(both, found + there - both),
        share(both, found),
        share(both, there)
    );
}
