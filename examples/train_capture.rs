//! Trains a scene on a capture, from `minute4d geometry` or another tool (`minute4d import`), and
//! exports it:
//! `cargo run --release -p minute4d --example train_capture -- CAPTURE OUT.ply [ITERATIONS]`.

#![expect(clippy::print_stdout, reason = "a program for a terminal")]

use minute4d::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    run(std::env::args().skip(1))
}

/// What the arguments ask for.
pub fn run(mut args: impl Iterator<Item = String>) -> Result<(), Box<dyn std::error::Error>> {
    let (Some(capture), Some(out)) = (args.next(), args.next()) else {
        return Err("usage: train_capture CAPTURE OUT [ITERATIONS]".into());
    };
    let iterations = args.next().map_or(Ok(500), |text| text.parse())?;
    let capture = Capture::read(capture)?;
    let scene = train(&capture, &Options::new().iterations(iterations))?;
    let middle = (scene.time_frames as f64 - 1.0) / 2.0;
    println!(
        "{} splats, {} of them visible at frame {middle}",
        scene.splats.n(),
        scene.at(middle).n()
    );
    scene.export(out)?;
    Ok(())
}
