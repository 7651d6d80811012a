//! Binary glTF (`.glb`) with `KHR_gaussian_splatting`: one instant, 60 bytes per splat and 12 for
//! each harmonic, in f32.
//!
//! The splats are the vertices of one primitive of points:
//!
//! ```text
//! POSITION                                  vec3 f32   right, up, back
//! KHR_gaussian_splatting:ROTATION           vec4 f32   x y z w
//! KHR_gaussian_splatting:SCALE              vec3 f32   standard deviations
//! KHR_gaussian_splatting:OPACITY            f32        0..1
//! KHR_gaussian_splatting:SH_DEGREE_l_COEF_n vec3 f32   as in a PLY of 3D Gaussian splatting
//! COLOR_0                                   vec4 u8    colour and opacity of the point, for players that
//!                                                      do not know the extension
//! ```
//!
//! The extension is complete and ratified by Khronos (`EXTENSION_STATUS`, which is also in the
//! file). An earlier draft had the logarithm of the scale; the readers of today (three r187 and
//! fourdgs 0.6 were checked) take it as it is written here.
//!
//! Source: `extensions/2.0/Khronos/KHR_gaussian_splatting` of `KhronosGroup/glTF`.

use super::splats::{sigmoid, turn_splats, unit};
use super::{C0, Clock, Loss, VerifiedFile, Written, check_unbound, instant};
use crate::WriteError;
use m4_core::{Column, Scene, Splats};
use serde_json::{Map, Value, json};
use std::io::{self, Write};
use std::path::Path;

/// What the extension is, said in the file too.
const EXTENSION_STATUS: &str = "KHR_gaussian_splatting, ratified by Khronos";
/// Name of the extension.
const EXTENSION: &str = "KHR_gaussian_splatting";
/// "glTF", "JSON" and "BIN\0", little-endian.
const MAGIC: u32 = 0x4654_6c67;
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BIN_CHUNK: u32 = 0x004e_4942;
/// glTF's numbers for f32, u8 and a buffer of vertices.
const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const ARRAY_BUFFER: u32 = 34_962;

/// Writes the splats that the instant `t` (frames) sees; the file gets its name when the bytes on
/// the disk are compared.
pub fn write(path: &Path, scene: &Scene, t: f64) -> Result<Written, WriteError> {
    let io = |e| WriteError::io(path, e);
    let bad = |what: String| Err(WriteError::bad(path, what));
    if !t.is_finite() {
        return bad(format!("t = {t}; a number of frames was expected"));
    }
    check_unbound(path, &scene.splats)?;
    let mut splats = instant(&scene.splats, t, scene.period_frames());
    turn_splats(&mut splats);
    let count = splats.n();
    if count == 0 {
        return bad(format!(
            "no splat is seen at frame {t}, and glTF has no empty arrays; choose another instant"
        ));
    }
    if let Some(column) = splats
        .columns()
        .iter()
        .find(|c| !c.iter().all(|v| v.is_finite()))
    {
        let splat = column.iter().position(|v| !v.is_finite()).unwrap_or(0);
        return bad(format!("splat {splat} holds a NaN or infinite value"));
    }
    let sections = Section::all(splats.layout().sh_degree);
    let bin = sections.iter().map(|s| s.layout().2).sum::<u64>() * count as u64;
    let mut json =
        serde_json::to_vec(&document(scene, t, &splats, &sections)).map_err(|e| io(e.into()))?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let Ok(total) = u32::try_from(12 + 8 + json.len() as u64 + 8 + bin) else {
        return bad(format!(
            "{count} splats take {bin} bytes, and binary glTF ends at 4 GiB"
        ));
    };

    let mut file = VerifiedFile::create(path).map_err(io)?;
    let words = |file: &mut VerifiedFile, words: &[u32]| -> io::Result<()> {
        words
            .iter()
            .try_for_each(|w| file.write_all(&w.to_le_bytes()))
    };
    let mut all = || {
        words(&mut file, &[MAGIC, 2, total, json.len() as u32, JSON_CHUNK])?;
        file.write_all(&json)?;
        words(&mut file, &[bin as u32, BIN_CHUNK])?;
        sections
            .iter()
            .try_for_each(|s| s.write(&splats, &mut file))
    };
    all().map_err(io)?;
    drop(splats);
    let mut losses = vec![
        Loss::Baked(format!("everything, at frame {t}")),
        Loss::Dropped("motion, the background and the colour corrections of the frames".into()),
    ];
    losses.extend(Loss::of_mip(scene));
    Ok(Written {
        path: path.to_path_buf(),
        bytes: file.publish(path)?,
        splats: count,
        losses,
    })
}

/// The JSON chunk.
fn document(scene: &Scene, t: f64, splats: &Splats, sections: &[Section]) -> Value {
    let n = splats.n() as u64;
    let mut offset = 0;
    let (mut views, mut accessors, mut attributes) = (Vec::new(), Vec::new(), Map::new());
    for (i, section) in sections.iter().enumerate() {
        let (kind, component_type, width) = section.layout();
        let byte_length = n * width;
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": byte_length, "target": ARRAY_BUFFER }));
        offset += byte_length;
        let mut accessor = json!({
            "bufferView": i,
            "byteOffset": 0,
            "componentType": component_type,
            "normalized": section.name == "COLOR_0",
            "count": n,
            "type": kind,
        });
        if section.name == "POSITION" {
            let bound = |pick: fn(f32, f32) -> f32| -> Vec<f64> {
                let column = |k| splats.column(Column::Mean, k).iter().copied();
                (0..3)
                    .map(|k| f64::from(column(k).reduce(pick).unwrap_or(0.0)))
                    .collect()
            };
            accessor["min"] = json!(bound(f32::min));
            accessor["max"] = json!(bound(f32::max));
        }
        accessors.push(accessor);
        attributes.insert(section.name.clone(), json!(i));
    }
    let clock = Clock::of(scene);
    let time_s = if clock.assumed {
        None
    } else {
        Some(t * clock.step_s)
    };
    let splatting = json!({
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    });
    json!({
        "asset": {
            "version": "2.0",
            "generator": concat!("minute4d ", env!("CARGO_PKG_VERSION")),
            "extras": { "frame": t, "time_s": time_s, "extension_status": EXTENSION_STATUS },
        },
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "name": "splats", "mesh": 0 }],
        "meshes": [{ "primitives": [{
            "attributes": attributes,
            "mode": 0,
            "extensions": { EXTENSION: splatting },
        }] }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": offset }],
    })
}

/// What an array holds of each splat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Content {
    Position,
    Rotation,
    Scale,
    Opacity,
    /// Index of a spatial harmonic.
    Harmonic(usize),
    Fallback,
}

/// One attribute of the points.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Section {
    name: String,
    content: Content,
}

impl Section {
    /// Those of splats of a degree.
    fn all(sh_degree: usize) -> Vec<Self> {
        let named = |name: &str, content| Self {
            name: name.to_owned(),
            content,
        };
        let own = |name: &str, content| named(&format!("{EXTENSION}:{name}"), content);
        let mut sections = vec![
            named("POSITION", Content::Position),
            own("ROTATION", Content::Rotation),
            own("SCALE", Content::Scale),
            own("OPACITY", Content::Opacity),
        ];
        let harmonics = harmonic_names(sh_degree).enumerate();
        sections.extend(harmonics.map(|(term, name)| named(&name, Content::Harmonic(term))));
        sections.push(named("COLOR_0", Content::Fallback));
        sections
    }

    /// glTF's name of the element, its number of a component's type, and bytes per splat: a
    /// multiple of 4, so that every array is aligned.
    fn layout(&self) -> (&'static str, u32, u64) {
        match self.content {
            Content::Rotation => ("VEC4", FLOAT, 16),
            Content::Position | Content::Scale | Content::Harmonic(_) => ("VEC3", FLOAT, 12),
            Content::Opacity => ("SCALAR", FLOAT, 4),
            Content::Fallback => ("VEC4", UNSIGNED_BYTE, 4),
        }
    }

    /// Writes the array of static splats with three scales.
    fn write(&self, splats: &Splats, out: &mut impl Write) -> io::Result<()> {
        let at = |column, k, i: usize| splats.column(column, k)[i];
        for i in 0..splats.n() {
            match self.content {
                Content::Position => floats(out, [0, 1, 2].map(|k| at(Column::Mean, k, i)))?,
                Content::Rotation => {
                    let [w, x, y, z] = unit([0, 1, 2, 3].map(|k| at(Column::Quat, k, i)));
                    floats(out, [x, y, z, w])?;
                }
                Content::Scale => floats(out, [0, 1, 2].map(|k| at(Column::LogScale, k, i).exp()))?,
                Content::Opacity => floats(out, [sigmoid(at(Column::Opacity, 0, i)) as f32])?,
                Content::Harmonic(term) => {
                    floats(out, [0, 1, 2].map(|k| at(Column::Colour, 3 * term + k, i)))?;
                }
                Content::Fallback => {
                    // a cast to u8 clips
                    let [r, g, b] =
                        [0, 1, 2].map(|k| 0.5 + C0 * f64::from(at(Column::Colour, k, i)));
                    let point = [r, g, b, sigmoid(at(Column::Opacity, 0, i))];
                    out.write_all(&point.map(|v| (v * 255.0).round() as u8))?;
                }
            }
        }
        Ok(())
    }
}

fn floats<const N: usize>(out: &mut impl Write, values: [f32; N]) -> io::Result<()> {
    values
        .iter()
        .try_for_each(|v| out.write_all(&v.to_le_bytes()))
}

/// Attributes of the harmonics of a degree, in the order of a splat's coefficients.
fn harmonic_names(sh_degree: usize) -> impl Iterator<Item = String> {
    (0..=sh_degree)
        .flat_map(|l| (0..=2 * l).map(move |n| format!("{EXTENSION}:SH_DEGREE_{l}_COEF_{n}")))
}
