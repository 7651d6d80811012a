//! Follows what moves in the training frames of a capture along the optical flow, with the capture's own depth and masks.
//!
//! ```text
//! cargo run --release -p m4_slam --example follow_capture -- FOLDER TRACKS.npz [--chains]
//! ```
//!
//! `--chains` leaves out what cannot be seen. The file is what a capture may name as its tracks (`docs/formats.md`).
#![expect(clippy::print_stdout, reason = "a report is its output")]

use m4_io::capture::{CaptureOptions, Split, read};
use m4_scene::Silent;
use m4_slam::dense::{InverseSearch, TrackConfig};
use m4_slam::tracks3d::{CaptureClip, FlowTracker, QueryGrid, Tracker3d};
use std::path::PathBuf;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let folder = PathBuf::from(words.next().ok_or("which capture?")?);
    let out = PathBuf::from(words.next().ok_or("to which file?")?);
    let mut config = TrackConfig::default();
    config.fill.enabled = words.next().as_deref() != Some("--chains");
    let capture = read(&folder, Split::Train, &CaptureOptions::default(), &Silent)?;
    let started = Instant::now();
    let grid = QueryGrid {
        every: config.every,
        spacing_px: config.spacing_px,
        most: config.most,
        rounds: 1,
    };
    let flow = InverseSearch::default();
    let clip = CaptureClip::new(&capture, 480);
    let tracks = FlowTracker { flow: &flow, config }
        .follow_grid(&clip, &grid, &Silent)?
        .tracks;
    let known = tracks.xyz().iter().filter(|p| p[0].is_finite()).count();
    let seen = tracks.visible().iter().filter(|v| **v).count();
    let share = |n: usize| 100.0 * n as f64 / tracks.xyz().len().max(1) as f64;
    println!(
        "{} tracks, seen in {:.1} % and known in {:.1} % of the frames, {:.1} s",
        tracks.count(),
        share(seen),
        share(known),
        started.elapsed().as_secs_f64()
    );
    m4_io::tracks::write(&out, &tracks)?;
    Ok(())
}
