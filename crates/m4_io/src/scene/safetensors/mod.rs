//! `scene.safetensors`: a trained scene in full precision, and the state of its training.
//!
//! A safetensors file, so that any language reads the arrays:
//!
//! ```text
//! splats.mean         f32 [n, 3]            static splats first; units as in m4_core::Column
//! splats.log_scale    f32 [n, 3] or [n, 1]
//! splats.quat         f32 [n, 4]            (w, x, y, z); absent for isotropic splats
//! splats.opacity      f32 [n]               logit
//! splats.colour       f32 [n, time_degree + 1, (sh_degree + 1)^2, 3]
//! splats.time_mean    f32 [dynamic]         frames
//! splats.log_time_sd  f32 [dynamic]
//! splats.velocity     f32 [dynamic, 3]
//! source.intrinsics   f64 [frames, 6]       width, height, fx, fy, cx, cy
//! source.c2w          f64 [frames, 3, 4]    OpenCV axes
//! source.t            f64 [frames]          frames
//! source.exposure     f32 [frames, 3, 4]    matrix, offset
//! source.distance_sigma f32 [frames]        of dynamic objects, relative, 0 for none; may be absent
//! state.NAME          any                   what training handed over, as it was
//! ```
//!
//! With windows and bound splats ([`m4_core::Binding`]; the first of the dynamic ones), in files of
//! version 2, also:
//!
//! ```text
//! windows.counts      u32 [windows, 2]      keys and nodes of each; in the next four the windows follow each other
//! windows.key         f32 [keys]            frames, rising within a window by 0.001 at least
//! windows.anchor      f32 [nodes, 3]        where nodes are when they have not moved
//! windows.position    f32 [keys x nodes, 3] in a window key by key, in a key node by node
//! windows.rotation    f32 [keys x nodes, 4] (w, x, y, z), of length 1 within 1 %
//! bound.window        u32 [bound]
//! bound.node          u16 [bound, 4]        of the window
//! bound.weight        f32 [bound, 4]        0 or more; the sum is 1 within 0.001
//! bound.life          f32 [bound, 2]        frames; -inf and inf where it begins before or ends after the video
//! bound.trend         f32 [bound, 3]        change of the colour a frame
//! ```
//!
//! The metadata has one key, `minute4d_scene`: JSON with the version of the format, what is not an
//! array (background, near, ...), the caller's own key-value pairs, and a BLAKE3 checksum over all
//! of it, which is compared on every read.

mod bound;
mod cameras;
mod read;
mod tensor;

pub use read::{SceneFile, read};

use super::VerifiedFile;
use super::valid::fault;
use crate::WriteError;
use bound::{bound_to_arrays, is_bound};
use cameras::source_to_arrays;
use m4_core::{Scene, TrainState};
use safetensors::tensor::{Metadata, TensorInfo};
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;
use tensor::{
    Facts, Header, KEY, Source, Sources, UNBOUND_VERSION, VERSION, checksum, splats_to_arrays,
};

/// Writes a scene, the state of its training where there is one, and pairs of the caller's own.
///
/// The file is read back before it takes its name, so that success means that the scene is on disk.
/// Fails when the file system refuses, a parameter is not a finite number, or an array of the state
/// does not have the length of its shape.
pub fn write(
    path: &Path,
    scene: &Scene,
    state: Option<&TrainState<'_>>,
    metadata: &BTreeMap<String, String>,
) -> Result<(), WriteError> {
    check(path, scene, state)?;
    let mut arrays = Sources::new();
    splats_to_arrays(&scene.splats, &mut arrays);
    bound_to_arrays(&scene.splats, &mut arrays);
    source_to_arrays(&scene.source, &mut arrays);
    for (name, array) in state.into_iter().flatten() {
        arrays.insert(format!("state.{name}"), Source::Array(array.view()));
    }
    let layout = scene.splats.layout();
    let facts = Facts {
        isotropic: layout.isotropic,
        sh_degree: layout.sh_degree,
        time_degree: layout.time_degree,
        splats_static: scene.splats.n_static(),
        splats_dynamic: scene.splats.n_dynamic(),
        background: scene.background,
        time_frames: scene.time_frames,
        duration_s: scene.duration_s,
        mip: scene.mip,
        near: scene.near,
        has_state: state.is_some(),
        splats_bound: is_bound(&scene.splats).then(|| scene.splats.bindings().len()),
    };
    let bad = |what: String| WriteError::bad(path, what);
    let header = Header {
        version: if facts.splats_bound.is_some() {
            VERSION
        } else {
            UNBOUND_VERSION
        },
        blake3: checksum(&facts, metadata, &arrays).map_err(|e| bad(e.to_string()))?,
        scene: facts,
        metadata: metadata.clone(),
    };
    let header = serde_json::to_string(&header).map_err(|e| bad(e.to_string()))?;
    save(path, &arrays, header)
}

/// Refuses what would not come back, or would not render.
fn check(path: &Path, scene: &Scene, state: Option<&TrainState<'_>>) -> Result<(), WriteError> {
    let bad = |what: String| WriteError::bad(path, what);
    if !scene.splats.is_finite() {
        return Err(bad(
            "a parameter of a splat is not a finite number; lower the learning rates".into(),
        ));
    }
    if let Some(what) = fault(scene) {
        return Err(bad(what));
    }
    for (name, array) in state.into_iter().flatten() {
        array
            .check()
            .map_err(|e| bad(format!("state {name:?}: {e}")))?;
    }
    Ok(())
}

/// Writes arrays piece by piece, so that no copy is in memory, and reads them back before they are
/// published.
fn save(path: &Path, arrays: &Sources<'_>, header: String) -> Result<(), WriteError> {
    let io = |e| WriteError::io(path, e);
    let bad = |what: String| WriteError::bad(path, what);
    // By type, widest first, so that every array is aligned; then by name.
    let mut order: Vec<(&String, &Source<'_>)> = arrays.iter().collect();
    order.sort_by(|(a_name, a), (b_name, b)| b.dtype().cmp(&a.dtype()).then(a_name.cmp(b_name)));
    let head = head(&order, header).map_err(bad)?;

    let mut file = VerifiedFile::create(path).map_err(io)?;
    file.write_all(&head).map_err(io)?;
    for (_, array) in &order {
        array.pieces(|piece| file.write_all(piece)).map_err(io)?;
    }
    file.publish(path).map(|_| ())
}

/// The head of a safetensors file: its length in 8 bytes, then JSON, padded so that arrays start at
/// a multiple of 8.
fn head(arrays: &[(&String, &Source<'_>)], header: String) -> Result<Vec<u8>, String> {
    let mut offset = 0;
    let mut infos = Vec::with_capacity(arrays.len());
    for (name, array) in arrays {
        let start = offset;
        offset += array.bytes();
        let info = TensorInfo {
            dtype: array.dtype(),
            shape: array.shape().to_vec(),
            data_offsets: (start, offset),
        };
        infos.push(((*name).clone(), info));
    }
    // One key alone: with more, their order would change from run to run.
    let pairs = Some(HashMap::from([(KEY.to_owned(), header)]));
    let metadata = Metadata::new(pairs, infos).map_err(|e| e.to_string())?;
    let mut json = serde_json::to_vec(&metadata).map_err(|e| e.to_string())?;
    json.resize(json.len().next_multiple_of(8), b' ');
    let mut head = (json.len() as u64).to_le_bytes().to_vec();
    head.append(&mut json);
    Ok(head)
}
