//! Measures the motion that first splats give to dynamic surfaces.

use crate::error::Error;
use crate::truth::read_truth;
use m4_io::capture::CaptureOptions;
use m4_io::reach::Reach;
use m4_train::init::{MotionErrors, motion_errors};
use minute4d::Observer;
use minute4d::settings::Settings;
use std::path::Path;

/// Tracks of a benchmark scene; its list of frames does not name them, so that no training reads
/// them.
const TRACKS_FILE: &str = "tracks.npz";

/// Follows the true tracks of a benchmark scene by the motion that first splats get from its own
/// frames, cameras, depth and masks. `reach` is which files it may name.
///
/// # Errors
///
/// What could not be read; [`minute4d::Error::Missing`] without tracks.
pub fn motion(scene: &Path, reach: Reach, observer: &dyn Observer) -> Result<MotionErrors, Error> {
    let settings = Settings::fast();
    let options = CaptureOptions {
        reach,
        ..settings.capture.clone()
    };
    let capture = read_truth(scene, &options, observer)?;
    let path = scene.join(TRACKS_FILE);
    if !path.is_file() {
        return Err(minute4d::Error::missing("true tracks", &path).into());
    }
    let tracks = m4_io::tracks::read(&path, capture.frames.len(), options.max_memory_bytes)?;
    Ok(motion_errors(
        &capture,
        &tracks,
        &settings.init_config(),
        observer,
    )?)
}

/// Formats the errors: a line per time that points are carried, one for points without a node, and
/// one for the ends of lives.
pub fn motion_table(errors: &MotionErrors) -> String {
    let px = |value: Option<f32>| value.map_or("-".to_owned(), |v| format!("{v:.2}"));
    let mut out = "\nmotion against true tracks, pixels of an image 480 wide\n".to_owned();
    for row in &errors.carried {
        let share = row
            .within_sigma
            .map_or("-".to_owned(), |v| format!("{:.0} %", 100.0 * v));
        out += &format!(
            "  after {:.0} frames at 24 a second: median {}, 80 % {}, within one standard deviation {share} ({} pairs)\n",
            row.after,
            px(row.median_px),
            px(row.p80_px),
            row.count
        );
    }
    out += &format!(
        "  {} points of frames, {:.1} % of them without a node\n",
        errors.points,
        100.0 * errors.without_node
    );
    let lives = errors.lives;
    let [on_time, late, early] =
        [lives.on_time, lives.late, lives.early].map(|share| 100.0 * share);
    out += &format!(
        "  lives that end within two frames of the moment when the error passes 1.5: {on_time:.0} %, later {late:.0} %, earlier {early:.0} %\n"
    );
    out
}
