//! Writes one instant of a scene as a PLY file.

use crate::scene::row::Row;
use crate::scene::{Loss, WriteFileError, Written, instant, plural};
use m4_core::{Column, Scene, Splats};
use std::fmt::Write;
use std::path::Path;

/// Writes the splats that time `t` (frames) sees, atomically.
///
/// # Errors
///
/// [`WriteFileError`] when the scene has values that are not finite, or the file system refuses.
pub fn write(path: &Path, scene: &Scene, t: f64) -> Result<Written, WriteFileError> {
    check(scene)?;
    let splats = seen(scene, t);
    let bytes = encode(&splats, t);
    crate::scene::file::publish(path, &bytes).map_err(|e| WriteFileError::io(path, e))?;
    let mut losses = Vec::new();
    if scene.splats.n_dynamic() > 0 {
        losses.push(Loss::Baked(format!("time, at frame {t}")));
    }
    let unseen = scene.splats.n() - splats.n();
    if unseen > 0 {
        losses.push(Loss::Dropped(format!(
            "{} that this instant does not see",
            plural(unseen, "splat")
        )));
    }
    losses.extend(unheld(scene));
    Ok(Written {
        path: path.to_path_buf(),
        bytes: bytes.len() as u64,
        splats: splats.n(),
        losses,
    })
}

/// Refuses what would not render.
pub(super) fn check(scene: &Scene) -> Result<(), WriteFileError> {
    if scene.splats.is_finite() {
        return Ok(());
    }
    Err(WriteFileError::bad(
        "PLY",
        "a parameter of a splat is not a finite number",
    ))
}

/// The splats of an instant, frames.
pub(super) fn seen(scene: &Scene, t: f64) -> Splats {
    instant(&scene.splats, t, (scene.time_frames.max(2) - 1) as f64)
}

/// Returns the properties of a scene that PLY cannot store.
pub(super) fn unheld(scene: &Scene) -> Vec<Loss> {
    let mut losses = Vec::from_iter(Loss::of_mip(scene));
    if !scene.source.is_empty() {
        losses.push(Loss::Dropped("the cameras of the video".to_owned()));
    }
    if scene.background != [0.0; 3] {
        losses.push(Loss::Dropped("the colour of the background".to_owned()));
    }
    losses
}

/// The bytes of a file with static splats.
pub(super) fn encode(splats: &Splats, t: f64) -> Vec<u8> {
    let rest = 3 * (splats.layout().sh_terms() - 1);
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    // Writing to a string cannot fail.
    let _ = writeln!(text, "comment minute4d {}, frame {t}", env!("CARGO_PKG_VERSION"));
    let _ = writeln!(text, "element vertex {}", splats.n());
    let mut property = |name: &str| {
        let _ = writeln!(text, "property float {name}");
    };
    ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
        .iter()
        .for_each(|name| property(name));
    (0..rest).for_each(|k| property(&format!("f_rest_{k}")));
    [
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ]
    .iter()
    .for_each(|name| property(name));
    text.push_str("end_header\n");

    let mut bytes = text.into_bytes();
    bytes.reserve(splats.n() * 4 * (17 + rest));
    let terms = rest / 3;
    for i in 0..splats.n() {
        let row = Row::of(splats, i);
        let colour = |k: usize| splats.column(Column::Colour, k)[i];
        let harmonics = (0..rest).map(|k| colour(3 * (k % terms + 1) + k / terms));
        let numbers = row
            .mean
            .into_iter()
            .chain([0.0; 3])
            .chain((0..3).map(colour))
            .chain(harmonics)
            .chain([row.opacity])
            .chain(row.log_scale)
            .chain(row.quat);
        bytes.extend(numbers.flat_map(f32::to_le_bytes));
    }
    bytes
}
