//! Reads a scene file.

use super::ReadSceneError;
use super::convert::{Arrays, Mismatch, arrays_to_source, arrays_to_splats};
use super::header::{Header, KEY, VERSION, Version, checksum};
use super::tensor::{self, Source};
use super::valid;
use m4_core::{Scene, TrainState};
use safetensors::tensor::Metadata;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Highest degrees that a layout may have; see [`m4_core::SplatLayout`].
const MAX_DEGREES: (usize, usize) = (3, 2);

/// What a scene file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneFile {
    /// The scene.
    pub scene: Scene,
    /// The state of training, where it was stored.
    pub state: Option<TrainState<'static>>,
    /// The pairs that the writer added.
    pub metadata: BTreeMap<String, String>,
}

/// Reads a scene file and compares its checksum.
///
/// # Errors
///
/// [`ReadSceneError`] if the file is missing, damaged, or of a newer format.
pub fn read(path: &Path) -> Result<SceneFile, ReadSceneError> {
    let (header, arrays) = load(path)?;
    let Some(header) = header else {
        return Err(ReadSceneError::NotScene {
            path: path.to_path_buf(),
            reason: format!("its metadata has no {KEY:?}"),
        });
    };
    let damaged = |reason: String| ReadSceneError::Damaged {
        path: path.to_path_buf(),
        reason,
    };
    let version: Version = serde_json::from_str(&header).map_err(|e| damaged(e.to_string()))?;
    if version.version > VERSION {
        return Err(ReadSceneError::NewerVersion {
            path: path.to_path_buf(),
            found: version.version,
            known: VERSION,
        });
    }
    let header: Header = serde_json::from_str(&header).map_err(|e| damaged(e.to_string()))?;
    let views = arrays
        .iter()
        .map(|(name, array)| (name.clone(), Source::Array(array.view())));
    let found = checksum(&header.scene, &header.metadata, &views.collect()).map_err(|e| damaged(e.to_string()))?;
    if found != header.blake3 {
        return Err(ReadSceneError::Checksum {
            path: path.to_path_buf(),
            expected: header.blake3,
            found,
        });
    }
    scene(path, header, arrays)
}

/// The arrays of a safetensors file and the JSON under [`KEY`], one array after the other. Sizes are
/// compared with the bytes that are there before any array is read.
pub fn load(path: &Path) -> Result<(Option<String>, Arrays), ReadSceneError> {
    let io = |source| ReadSceneError::Io {
        path: path.to_path_buf(),
        source,
    };
    let file = File::open(path).map_err(io)?;
    let len = file.metadata().map_err(io)?.len();
    let mut file = BufReader::new(file);
    let not_scene = |reason: String| ReadSceneError::NotScene {
        path: path.to_path_buf(),
        reason,
    };
    // The head first: a large file of another kind is not read whole.
    let mut start = [0; 9];
    if len < start.len() as u64 {
        return Err(not_scene(format!("it is {len} bytes long")));
    }
    file.read_exact(&mut start).map_err(io)?;
    let [head @ .., brace] = start;
    let head = u64::from_le_bytes(head);
    if brace != b'{' {
        return Err(not_scene("it does not start like a safetensors file".into()));
    }
    let damaged = |reason: String| ReadSceneError::Damaged {
        path: path.to_path_buf(),
        reason,
    };
    if head > len - 8 {
        return Err(damaged(format!("its header says {head} bytes and the file has {len}")));
    }
    let mut json = vec![brace];
    let rest = file.by_ref().take(head.saturating_sub(1));
    read_to_end(rest, &mut json).map_err(io)?;
    let metadata: Metadata = serde_json::from_slice(&json).map_err(|e| damaged(e.to_string()))?;
    let bytes = metadata.data_len() as u64;
    if bytes != len - 8 - head {
        return Err(damaged(format!(
            "its arrays have {bytes} bytes and the file has {} for them",
            len - 8 - head
        )));
    }
    let mut arrays = Arrays::new();
    for name in metadata.offset_keys() {
        let Some(info) = metadata.info(&name) else { continue };
        let (from, to) = info.data_offsets;
        let mut bytes = Vec::new();
        read_to_end(file.by_ref().take((to - from) as u64), &mut bytes).map_err(io)?;
        if bytes.len() != to - from {
            return Err(damaged(format!("it ends within the array {name:?}")));
        }
        let array = tensor::load(info.dtype, &info.shape, bytes)
            .ok_or_else(|| damaged(format!("array {name:?} has the type {:?}", info.dtype)))?;
        arrays.insert(name, array);
    }
    let header = metadata.metadata().as_ref().and_then(|m| m.get(KEY)).cloned();
    Ok((header, arrays))
}

fn read_to_end(mut from: impl Read, to: &mut Vec<u8>) -> std::io::Result<()> {
    from.read_to_end(to).map(|_| ())
}

fn scene(path: &Path, header: Header, mut arrays: Arrays) -> Result<SceneFile, ReadSceneError> {
    let facts = header.scene;
    if facts.sh_degree > MAX_DEGREES.0 || facts.time_degree > MAX_DEGREES.1 {
        return Err(ReadSceneError::Damaged {
            path: path.to_path_buf(),
            reason: format!(
                "it says degree {} in space and {} in time",
                facts.sh_degree, facts.time_degree
            ),
        });
    }
    let cause = |cause| mismatch_error(path, cause);
    let splats =
        arrays_to_splats(&mut arrays, facts.layout(), facts.splats_static, facts.splats_dynamic).map_err(cause)?;
    let source = arrays_to_source(&arrays).map_err(cause)?;
    let state = facts.has_state.then(|| {
        let named: Vec<String> = arrays.keys().filter(|n| n.starts_with("state.")).cloned().collect();
        let take = |name: String| Some((name["state.".len()..].to_owned(), arrays.remove(&name)?));
        named.into_iter().filter_map(take).collect()
    });
    let scene = Scene {
        splats,
        background: facts.background,
        time_frames: facts.time_frames,
        duration_s: facts.duration_s,
        mip: facts.mip,
        near: facts.near,
        source,
    };
    if let Some(reason) = valid::cause(&scene) {
        let path = path.to_path_buf();
        return Err(ReadSceneError::Damaged { path, reason });
    }
    Ok(SceneFile {
        scene,
        state,
        metadata: header.metadata,
    })
}

/// A fault of arrays with the name of the file.
pub fn mismatch_error(path: &Path, cause: Mismatch) -> ReadSceneError {
    let path = path.to_path_buf();
    match cause {
        Mismatch::Missing(name) => ReadSceneError::MissingArray { path, name },
        Mismatch::Other { name, found, expected } => ReadSceneError::BadArray {
            path,
            name,
            found,
            expected,
        },
    }
}
