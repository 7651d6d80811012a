//! How long a clip takes to decode in this process and in one of its own (docs/video.md):
//! `cargo run --release -p m4_io --example decode_speed -- CLIP [ROUNDS]`.

use m4_io::video::{DecoderProgram, VideoOptions, read_with, serve_decoder};
use m4_scene::Silent;
use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

const ARGUMENT: &str = "__decode-h264";

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    if arguments.first().is_some_and(|a| a == ARGUMENT) {
        return Ok(serve_decoder(
            &arguments[1..],
            std::io::stdin().lock(),
            std::io::stdout().lock(),
        )?);
    }
    let clip = PathBuf::from(arguments.first().ok_or("which clip?")?);
    let rounds: usize = match arguments.get(1).and_then(|a| a.to_str()) {
        Some(text) => text.parse()?,
        None => 5,
    };
    let child = DecoderProgram::new(std::env::current_exe()?, ARGUMENT);
    let options = VideoOptions {
        size: None,
        ..VideoOptions::default()
    };
    let places = [("in this process", None), ("in its own", Some(&child))];
    let mut seconds = [Vec::new(), Vec::new()];
    let (mut frames, mut size) = (0, (0, 0));
    // In turns, so that what else the machine does hits both.
    for _ in 0..rounds.max(1) {
        for ((_, decoder), seconds) in places.iter().zip(&mut seconds) {
            let start = Instant::now();
            let video = read_with(*decoder, &clip, &options, &Silent)?;
            seconds.push(start.elapsed().as_secs_f64());
            (frames, size) = (video.frames.len(), video.frames[0].rgb.size());
        }
    }
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{frames} frames of {} x {}, {} rounds",
        size.0,
        size.1,
        rounds.max(1)
    )?;
    for ((name, _), seconds) in places.iter().zip(&mut seconds) {
        seconds.sort_by(f64::total_cmp);
        let (least, median) = (seconds[0], seconds[seconds.len() / 2]);
        let rate = frames as f64 / median;
        writeln!(
            out,
            "{name}: median {median:.3} s ({rate:.0} frames a second), least {least:.3} s"
        )?;
    }
    Ok(())
}
