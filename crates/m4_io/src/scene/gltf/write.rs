//! Writes one instant of a scene as binary glTF.

use super::document::{Accessor, Buffer, BufferView, Document, Mesh, Node, Primitive};
use super::section::Section;
use super::{BIN_CHUNK, EXTENSION, EXTENSION_STATUS, JSON_CHUNK, MAGIC};
use crate::scene::clock::Clock;
use crate::scene::rub::turn_splats;
use crate::scene::verified::VerifiedFile;
use crate::scene::{Loss, WriteFileError, Written, instant};
use m4_core::{Column, Scene, Splats};
use serde_json::json;
use std::io::{self, Write};
use std::path::Path;

/// glTF's number for a buffer of vertices.
const ARRAY_BUFFER: u32 = 34_962;

/// Writes the splats that the instant `t` (frames) sees; the bytes on the disk are compared before the
/// file gets its name.
///
/// # Errors
///
/// [`WriteFileError`]; what was at `path` is then still there.
pub fn write(path: &Path, scene: &Scene, t: f64) -> Result<Written, WriteFileError> {
    let io = |e| WriteFileError::io(path, e);
    let bad = |what: String| WriteFileError::bad("glTF", what);
    if !t.is_finite() {
        return Err(bad(format!("t = {t}; a number of frames was expected")));
    }
    let mut splats = instant(&scene.splats, t, scene.time_frames as f64);
    turn_splats(&mut splats);
    if splats.n() == 0 {
        return Err(bad(format!(
            "no splat is seen at frame {t}, and glTF has no empty arrays; choose another instant"
        )));
    }
    if let Some(column) = splats.columns().iter().find(|c| !c.iter().all(|v| v.is_finite())) {
        let splat = column.iter().position(|v| !v.is_finite()).unwrap_or(0);
        return Err(bad(format!("splat {splat} holds a NaN or infinite value")));
    }
    let sections = Section::all(splats.layout().sh_degree);
    let count = splats.n();
    let document = document(scene, t, &splats, &sections);
    let mut json = serde_json::to_vec(&document).map_err(|e| io(e.into()))?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let bin = document.buffers[0].byte_length;
    let total = u32::try_from(12 + 8 + json.len() as u64 + 8 + bin).map_err(|_| {
        bad(format!(
            "{count} splats take {bin} bytes, and binary glTF ends at 4 GiB"
        ))
    })?;

    let mut file = VerifiedFile::create(path).map_err(io)?;
    let words = |file: &mut VerifiedFile, words: &[u32]| -> io::Result<()> {
        words.iter().try_for_each(|w| file.write_all(&w.to_le_bytes()))
    };
    let mut all = || {
        words(&mut file, &[MAGIC, 2, total, json.len() as u32, JSON_CHUNK])?;
        file.write_all(&json)?;
        words(&mut file, &[bin as u32, BIN_CHUNK])?;
        sections.iter().try_for_each(|s| s.write(&splats, &mut file))
    };
    all().map_err(io)?;
    drop(splats);
    file.verify().map_err(|e| WriteFileError::verify(path, e))?;
    let mut losses = vec![
        Loss::Baked(format!("everything, at frame {t}")),
        Loss::Dropped("motion, the background and the colour corrections of the frames".into()),
    ];
    losses.extend(Loss::of_mip(scene));
    Ok(Written {
        path: path.to_path_buf(),
        bytes: file.commit().map_err(io)?,
        splats: count,
        losses,
    })
}

/// The JSON chunk.
fn document(scene: &Scene, t: f64, splats: &Splats, sections: &[Section]) -> Document {
    let n = splats.n() as u64;
    let mut offset = 0;
    let mut views = Vec::new();
    let mut accessors = Vec::new();
    for (i, section) in sections.iter().enumerate() {
        let byte_length = n * section.width();
        views.push(BufferView {
            buffer: 0,
            byte_offset: offset,
            byte_length,
            target: ARRAY_BUFFER,
        });
        offset += byte_length;
        let bound = |pick: fn(f32, f32) -> f32| {
            let bound = |k| {
                splats
                    .column(Column::Mean, k)
                    .iter()
                    .copied()
                    .reduce(pick)
                    .unwrap_or(0.0)
            };
            Some((0..3).map(|k| f64::from(bound(k))).collect())
        };
        let is_position = section.name == "POSITION";
        accessors.push(Accessor {
            buffer_view: i,
            byte_offset: 0,
            component_type: section.component_type(),
            normalized: section.name == "COLOR_0",
            count: n,
            kind: section.kind().to_owned(),
            min: is_position.then(|| bound(f32::min)).flatten(),
            max: is_position.then(|| bound(f32::max)).flatten(),
        });
    }
    let clock = Clock::of(scene);
    let time_s = if clock.assumed { None } else { Some(t * clock.step_s) };
    let splatting = json!({
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    });
    Document {
        asset: json!({
            "version": "2.0",
            "generator": concat!("minute4d ", env!("CARGO_PKG_VERSION")),
            "extras": { "frame": t, "time_s": time_s, "extension_status": EXTENSION_STATUS },
        }),
        extensions_used: vec![EXTENSION.to_owned()],
        scene: 0,
        scenes: vec![json!({ "nodes": [0] })],
        nodes: vec![Node {
            name: "splats".into(),
            mesh: 0,
        }],
        meshes: vec![Mesh {
            primitives: vec![Primitive {
                attributes: sections.iter().enumerate().map(|(i, s)| (s.name.clone(), i)).collect(),
                mode: 0,
                extensions: [(EXTENSION.to_owned(), splatting)].into(),
            }],
        }],
        accessors,
        buffer_views: views,
        buffers: vec![Buffer { byte_length: offset }],
    }
}
