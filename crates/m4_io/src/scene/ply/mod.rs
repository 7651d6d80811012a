//! PLY files in the layout of 3DGS: one instant, or a folder with one file per frame.
//!
//! A file is a header of text and a table of 32-bit numbers, little-endian, a row per splat:
//!
//! ```text
//! x y z            mean, world units             nx ny nz         0
//! f_dc_0..2        constant colour coefficient: colour = 1/2 + C0 f_dc
//! f_rest_0..       the other harmonics, channel major: all of red, then green, then blue
//! opacity          logit                          scale_0..2       logarithms, world units
//! rot_0..3         quaternion (w, x, y, z)
//! ```
//!
//! Read are also: other orders of the properties, missing normals, harmonics of degree 0 to 3, one scale in
//! place of three, `red green blue` instead of coefficients, any number type, big-endian and text.

mod header;
mod read;
#[cfg(test)]
mod tests;

pub use read::{parse, read};

use crate::WriteError;
use crate::scene::common::{check_finite, publish};
use crate::scene::splats::Row;
use crate::scene::{Loss, Written, instant, plural};
use m4_core::{Column, Scene, Splats};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Writes the splats that time `t` (frames) sees, atomically.
///
/// # Errors
///
/// [`WriteError`] when the scene has values that are not finite, or the file system refuses.
pub fn write(path: &Path, scene: &Scene, t: f64) -> Result<Written, WriteError> {
    check_finite(path, scene)?;
    let splats = seen(scene, t);
    let bytes = encode(&splats, t);
    publish(path, &bytes)?;
    let mut losses = Vec::new();
    if scene.splats.n_dynamic() > 0 {
        losses.push(Loss::Baked(format!("time, at frame {t}")));
    }
    let unseen = scene.splats.n() - splats.n();
    if unseen > 0 {
        losses.push(Loss::Dropped(format!("{} that this instant does not see", plural(unseen, "splat"))));
    }
    losses.extend(unheld(scene));
    Ok(Written { path: path.to_path_buf(), bytes: bytes.len() as u64, splats: splats.n(), losses })
}

/// The splats of an instant, frames.
fn seen(scene: &Scene, t: f64) -> Splats {
    instant(&scene.splats, t, (scene.time_frames.max(2) - 1) as f64)
}

/// Returns the properties of a scene that PLY cannot store.
fn unheld(scene: &Scene) -> Vec<Loss> {
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
fn encode(splats: &Splats, t: f64) -> Vec<u8> {
    let rest = 3 * (splats.layout().sh_terms() - 1);
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    // Writing to a string cannot fail.
    let _ = writeln!(text, "comment minute4d {}, frame {t}", env!("CARGO_PKG_VERSION"));
    let _ = writeln!(text, "element vertex {}", splats.n());
    let mut property = |name: &str| {
        let _ = writeln!(text, "property float {name}");
    };
    ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].iter().for_each(|name| property(name));
    (0..rest).for_each(|k| property(&format!("f_rest_{k}")));
    ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
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

/// Name of file `i` of a sequence: `frame_00012.ply`.
#[must_use]
pub fn frame_name(i: usize) -> String {
    format!("frame_{i:05}.ply")
}

/// Writes a file for each of `times` (frames) into `folder`, each atomically. Files of a longer
/// sequence that was there before are removed. `each` is called after every file, and may stop the work by
/// returning false; the files written until then stay.
///
/// # Errors
///
/// [`WriteError`] when the scene has values that are not finite, or the file system refuses.
pub fn write_sequence(
    folder: &Path,
    scene: &Scene,
    times: &[f64],
    mut each: impl FnMut(usize) -> bool,
) -> Result<Written, WriteError> {
    check_finite(folder, scene)?;
    let io = WriteError::io;
    fs::create_dir_all(folder).map_err(|e| io(folder, e))?;
    let mut written = Written { path: folder.to_path_buf(), bytes: 0, splats: 0, losses: Vec::new() };
    for (i, &t) in times.iter().enumerate() {
        let path = folder.join(frame_name(i));
        let splats = seen(scene, t);
        let bytes = encode(&splats, t);
        publish(&path, &bytes)?;
        written.bytes += bytes.len() as u64;
        written.splats += splats.n();
        if !each(i + 1) {
            return Ok(written);
        }
    }
    for i in times.len().. {
        let path = folder.join(frame_name(i));
        if !path.is_file() {
            break;
        }
        fs::remove_file(&path).map_err(|e| io(&path, e))?;
    }
    if scene.splats.n_dynamic() > 0 {
        written.losses.push(Loss::Baked(format!("time, at {} instants", times.len())));
    }
    written.losses.extend(unheld(scene));
    Ok(written)
}
