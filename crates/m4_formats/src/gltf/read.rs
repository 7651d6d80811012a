//! Binary glTF to splats.

use super::accessor::{Fault, floats};
use super::document::{Document, Primitive};
use super::error::ReadGltfError;
use super::{BIN_CHUNK, EXTENSION, JSON_CHUNK, MAGIC, harmonic_names};
use crate::file::load;
use crate::row::logit;
use crate::rub::turn_splats;
use m4_scene::{SplatLayout, Splats};
use std::path::Path;

/// Highest degree of harmonics that is read.
const MAX_DEGREE: usize = 3;

/// Reads the splats of a `.glb` file, static all of them, in our axes (right, down, forward). One
/// primitive of splats with f32 attributes, placed at the origin, is read: what [`super::write()`] and
/// `splat-transform` write.
///
/// # Errors
///
/// [`ReadGltfError`], which names the file and what is wrong with it.
pub fn read(path: &Path) -> Result<Splats, ReadGltfError> {
    let file = load(path).map_err(|source| ReadGltfError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    let unsupported = |what: String, instead| ReadGltfError::Unsupported {
        path: path.to_path_buf(),
        what,
        instead,
    };
    let (json, bin) = chunks(path, &file)?;
    let document: Document = serde_json::from_slice(json).map_err(|e| ReadGltfError::Damaged {
        path: path.to_path_buf(),
        reason: format!("its JSON chunk: {e}"),
    })?;
    let mut found = Vec::new();
    for (m, mesh) in document.meshes.iter().enumerate() {
        let splats = mesh.primitives.iter().filter(|p| p.extensions.contains_key(EXTENSION));
        found.extend(splats.map(|p| (m, p)));
    }
    let &[(mesh, primitive)] = found.as_slice() else {
        let what = format!("{} primitives with {EXTENSION}", found.len());
        return Err(unsupported(what, "write all splats as one primitive"));
    };
    if document.nodes.iter().any(|n| n.mesh == Some(mesh) && n.moves()) {
        let instead = "apply the transform of the node to the splats first";
        return Err(unsupported("splats that a node moves".into(), instead));
    }
    if document.buffers.first().is_some_and(|b| b.uri.is_some()) {
        return Err(unsupported("its data in another file".into(), "write a single .glb"));
    }
    let mut splats = splats(path, &document, bin, primitive)?;
    turn_splats(&mut splats);
    Ok(splats)
}

/// The JSON and the binary chunk.
fn chunks<'a>(path: &Path, file: &'a [u8]) -> Result<(&'a [u8], &'a [u8]), ReadGltfError> {
    let word = |at: usize| {
        let bytes = file.get(at..at + 4)?;
        Some(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    };
    let not_glb = |reason: String| ReadGltfError::NotGlb {
        path: path.to_path_buf(),
        reason,
    };
    let damaged = |reason: String| ReadGltfError::Damaged {
        path: path.to_path_buf(),
        reason,
    };
    if word(0) != Some(MAGIC) {
        return Err(not_glb("it does not begin with \"glTF\"".into()));
    }
    let version = word(4).unwrap_or(0);
    if version != 2 {
        return Err(not_glb(format!("its version is {version}, not 2")));
    }
    let total = word(8).unwrap_or(0);
    if total as usize != file.len() {
        let len = file.len();
        return Err(damaged(format!("its header says {total} bytes and the file has {len}")));
    }
    let chunk = |at: usize, kind: u32, name: &str| {
        let (len, found) = (word(at), word(at + 4));
        let (Some(len), Some(found)) = (len, found) else {
            return Err(damaged(format!("the {name} chunk is missing")));
        };
        if found != kind {
            return Err(damaged(format!(
                "a chunk of type {found:#010x} lies where the {name} chunk was expected"
            )));
        }
        let body = file.get(at + 8..).and_then(|rest| rest.get(..len as usize));
        body.ok_or_else(|| damaged(format!("the {name} chunk of {len} bytes ends beyond the file")))
    };
    let json = chunk(12, JSON_CHUNK, "JSON")?;
    let bin = chunk(20 + json.len(), BIN_CHUNK, "binary")?;
    Ok((json, bin))
}

fn splats(path: &Path, document: &Document, bin: &[u8], primitive: &Primitive) -> Result<Splats, ReadGltfError> {
    let damaged = |reason: String| ReadGltfError::Damaged {
        path: path.to_path_buf(),
        reason,
    };
    let array = |name: &str, width: usize| {
        let index = primitive
            .attributes
            .get(name)
            .ok_or_else(|| damaged(format!("the splats have no {name}")))?;
        floats(document, bin, name, *index, width).map_err(|fault| match fault {
            Fault::Damaged(reason) => damaged(reason),
            Fault::Unsupported(what) => ReadGltfError::Unsupported {
                path: path.to_path_buf(),
                what,
                instead: "write attributes as f32 arrays",
            },
        })
    };
    let of = |name: &str| format!("{EXTENSION}:{name}");
    let position = array("POSITION", 3)?;
    let n = position.len() / 3;
    let has = |name: &str| primitive.attributes.contains_key(name);
    let sh_degree = (1..=MAX_DEGREE)
        .take_while(|l| has(&of(&format!("SH_DEGREE_{l}_COEF_0"))))
        .count();
    let layout = SplatLayout {
        isotropic: false,
        sh_degree,
        time_degree: 0,
    };
    let mut columns: Vec<Vec<f32>> = Vec::with_capacity(layout.columns());
    let mut put = |name: &str, order: &[usize], data: Vec<f32>, value: &dyn Fn(f32) -> Result<f32, &'static str>| {
        let width = order.len();
        if data.len() != n * width {
            return Err(damaged(format!(
                "{name} has {} rows where POSITION has {n}",
                data.len() / width
            )));
        }
        for &k in order {
            let mut column = Vec::with_capacity(n);
            for (splat, row) in data.chunks_exact(width).enumerate() {
                let bad = |expected| ReadGltfError::BadValue {
                    path: path.to_path_buf(),
                    splat,
                    attribute: name.to_owned(),
                    value: row[k],
                    expected,
                };
                let number = if row[k].is_finite() {
                    Ok(row[k])
                } else {
                    Err("a number")
                };
                column.push(number.and_then(value).map_err(bad)?);
            }
            columns.push(column);
        }
        Ok(())
    };
    put("POSITION", &[0, 1, 2], position, &Ok)?;
    let name = of("SCALE");
    // a flat splat has a scale of 0: as thin as can be
    put(&name, &[0, 1, 2], array(&name, 3)?, &|v| match v {
        v if v >= 0.0 => Ok(v.max(f32::MIN_POSITIVE).ln()),
        _ => Err("a standard deviation of at least 0"),
    })?;
    let name = of("ROTATION");
    put(&name, &[3, 0, 1, 2], array(&name, 4)?, &Ok)?;
    let name = of("OPACITY");
    put(&name, &[0], array(&name, 1)?, &|v| match v {
        v if (0.0..=1.0).contains(&v) => Ok(logit(f64::from(v))),
        _ => Err("an opacity from 0 to 1"),
    })?;
    for name in harmonic_names(sh_degree) {
        put(&name, &[0, 1, 2], array(&name, 3)?, &Ok)?;
    }
    columns.resize_with(layout.columns(), Vec::new);
    Splats::from_columns(layout, n, 0, columns).map_err(|e| damaged(e.to_string()))
}
