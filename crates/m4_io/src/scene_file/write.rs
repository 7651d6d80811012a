//! A scene to a scene file.

use super::WriteSceneError;
use super::convert::{Arrays, source_to_arrays, splats_to_arrays};
use super::header::{Facts, Header, KEY, VERSION, checksum};
use super::read::load;
use super::tensor::Stored;
use crate::atomic::AtomicFile;
use m4_scene::{Scene, TrainState};
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

/// Writes a scene, the state of its training where there is one, and pairs of the caller's own.
///
/// The file is read back before it takes its name, so that success means that the scene is on disk.
///
/// # Errors
///
/// [`WriteSceneError`] when the file system refuses, a parameter is not a finite number, or an array of
/// the state does not have the length of its shape.
pub fn write(
    path: &Path,
    scene: &Scene,
    state: Option<&TrainState>,
    metadata: &BTreeMap<String, String>,
) -> Result<(), WriteSceneError> {
    check(path, scene, state)?;
    let mut arrays = Arrays::new();
    splats_to_arrays(&scene.splats, &mut arrays);
    source_to_arrays(&scene.source, &mut arrays);
    for (name, array) in state.into_iter().flatten() {
        arrays.insert(format!("state.{name}"), array.clone());
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
    };
    let bad = |what: String| WriteSceneError::BadScene {
        path: path.to_path_buf(),
        what,
    };
    let header = Header {
        version: VERSION,
        blake3: checksum(&facts, metadata, &arrays).map_err(|e| bad(e.to_string()))?,
        scene: facts,
        metadata: metadata.clone(),
    };
    let header = serde_json::to_string(&header).map_err(|e| bad(e.to_string()))?;
    save(path, &arrays, Some(header))
}

/// Refuses what would not come back, or would not render.
fn check(path: &Path, scene: &Scene, state: Option<&TrainState>) -> Result<(), WriteSceneError> {
    let bad = |what: String| WriteSceneError::BadScene {
        path: path.to_path_buf(),
        what,
    };
    if !scene.splats.is_finite() {
        return Err(bad(
            "a parameter of a splat is not a finite number; lower the learning rates".into(),
        ));
    }
    let finite = |v: f32| v.is_finite();
    if !(scene.background.iter().copied().all(finite) && finite(scene.near)) {
        return Err(bad(format!(
            "background {:?} or near {} is not a number",
            scene.background, scene.near
        )));
    }
    if let Some(s) = scene.duration_s.filter(|s| !s.is_finite()) {
        return Err(bad(format!("the duration is {s} s")));
    }
    for (name, array) in state.into_iter().flatten() {
        array.check().map_err(|e| bad(format!("state {name:?}: {e}")))?;
    }
    Ok(())
}

/// Writes arrays and reads them back before they are published.
pub fn save(path: &Path, arrays: &Arrays, header: Option<String>) -> Result<(), WriteSceneError> {
    let io = |source| WriteSceneError::Io {
        path: path.to_path_buf(),
        source,
    };
    // One key alone: with more, their order would change from run to run.
    let metadata = header.clone().map(|json| HashMap::from([(KEY.to_owned(), json)]));
    let bytes = safetensors::serialize(arrays.iter().map(|(name, array)| (name, Stored(array))), metadata);
    let bytes = bytes.map_err(|e| WriteSceneError::BadScene {
        path: path.to_path_buf(),
        what: e.to_string(),
    })?;
    let mut file = AtomicFile::create(path).map_err(io)?;
    file.write_all(&bytes).map_err(io)?;
    drop(bytes);
    file.sync().map_err(io)?;
    let verify = |reason: String| WriteSceneError::Verify {
        path: path.to_path_buf(),
        reason,
    };
    let (header_back, arrays_back) = load(file.temporary_path()).map_err(|e| verify(e.to_string()))?;
    if header_back != header || !same(&arrays_back, arrays) {
        return Err(verify("it holds other values".into()));
    }
    file.commit().map_err(io)
}

/// Bit by bit: a state may hold NaN.
fn same(a: &Arrays, b: &Arrays) -> bool {
    let parts = |arrays: &Arrays| arrays.len();
    parts(a) == parts(b)
        && a.iter().zip(b).all(|((a_name, a), (b_name, b))| {
            a_name == b_name && a.shape() == b.shape() && super::tensor::bytes(a) == super::tensor::bytes(b)
        })
}
