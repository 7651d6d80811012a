//! Reads a scene file.

use super::bound::arrays_to_bound;
use super::cameras::arrays_to_source;
use super::tensor::{
    self, Arrays, Header, KEY, Source, VERSION, Version, arrays_to_splats, checksum,
};
use crate::error::AtPath;
use crate::scene::valid::fault;
use crate::{Fault, ReadError, files, shortened};
use m4_core::{Scene, TrainState};
use safetensors::tensor::Metadata;
use std::collections::BTreeMap;
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

/// Reads a scene file and compares its checksum. Fails if the file is missing, damaged, or of a
/// newer format.
pub fn read(path: &Path) -> Result<SceneFile, ReadError> {
    file(path).at(path)
}

fn file(path: &Path) -> Result<SceneFile, Fault> {
    let (header, arrays) = load(path)?;
    let header = header.ok_or_else(|| not_scene(format!("its metadata has no {KEY:?}")))?;
    let Version { version } = serde_json::from_str(&header).map_err(Fault::damaged)?;
    if version > VERSION {
        let what =
            format!("it has format version {version}, and this program reads up to {VERSION}");
        return Err(Fault::unsupported(what, "update minute4d"));
    }
    let header: Header = serde_json::from_str(&header).map_err(Fault::damaged)?;
    let views = arrays
        .iter()
        .map(|(name, array)| (name.clone(), Source::Array(array.view())));
    let actual =
        checksum(&header.scene, &header.metadata, &views.collect()).map_err(Fault::damaged)?;
    if actual != header.blake3 {
        return Err(Fault::damaged(format!(
            "its checksum is {actual} where {} was written",
            shortened(header.blake3)
        )));
    }
    scene(header, arrays)
}

fn not_scene(reason: String) -> Fault {
    Fault::bad(
        format!("it is not a scene file: {reason}"),
        "give the scene.safetensors of a run",
    )
}

/// The arrays of a file and the JSON under [`KEY`]; sizes are compared with the bytes that are
/// there before any is read.
fn load(path: &Path) -> Result<(Option<String>, Arrays), Fault> {
    let file = files::open(path)?;
    let len = file.metadata()?.len();
    let mut file = BufReader::new(file);
    // The head first: a large file of another kind is not read whole.
    let mut start = [0; 9];
    if len < start.len() as u64 {
        return Err(not_scene(format!("it is {len} bytes long")));
    }
    file.read_exact(&mut start)?;
    let [head @ .., brace] = start;
    let head = u64::from_le_bytes(head);
    if brace != b'{' {
        return Err(not_scene(
            "it does not start like a safetensors file".into(),
        ));
    }
    if head > len - 8 {
        return Err(Fault::damaged(format!(
            "its header says {head} bytes and the file has {len}"
        )));
    }
    let mut json = vec![brace];
    file.by_ref()
        .take(head.saturating_sub(1))
        .read_to_end(&mut json)?;
    let metadata: Metadata = serde_json::from_slice(&json).map_err(Fault::damaged)?;
    let (bytes, rest) = (metadata.data_len() as u64, len - 8 - head);
    if bytes != rest {
        return Err(Fault::damaged(format!(
            "its arrays have {bytes} bytes and the file has {rest} for them"
        )));
    }
    let mut arrays = Arrays::new();
    for name in metadata.offset_keys() {
        let Some(info) = metadata.info(&name) else {
            continue;
        };
        let (from, to) = info.data_offsets;
        let mut bytes = Vec::new();
        file.by_ref()
            .take((to - from) as u64)
            .read_to_end(&mut bytes)?;
        if bytes.len() != to - from {
            return Err(Fault::damaged(format!("it ends within the array {name:?}")));
        }
        let array = tensor::load(info.dtype, &info.shape, bytes).ok_or_else(|| {
            Fault::damaged(format!("array {name:?} has the type {:?}", info.dtype))
        })?;
        arrays.insert(name, array);
    }
    let header = metadata
        .metadata()
        .as_ref()
        .and_then(|m| m.get(KEY))
        .cloned();
    Ok((header, arrays))
}

fn scene(header: Header, mut arrays: Arrays) -> Result<SceneFile, Fault> {
    let facts = header.scene;
    if facts.sh_degree > MAX_DEGREES.0 || facts.time_degree > MAX_DEGREES.1 {
        let (space, time) = (facts.sh_degree, facts.time_degree);
        return Err(Fault::damaged(format!(
            "it says degree {space} in space and {time} in time"
        )));
    }
    let mut splats = arrays_to_splats(
        &mut arrays,
        facts.layout(),
        facts.splats_static,
        facts.splats_dynamic,
    )?;
    if let Some(bound) = facts.splats_bound {
        arrays_to_bound(&mut arrays, &mut splats, bound)?;
    }
    let source = arrays_to_source(&arrays)?;
    let state = facts.has_state.then(|| {
        let named: Vec<String> = arrays
            .keys()
            .filter(|n| n.starts_with("state."))
            .cloned()
            .collect();
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
    if let Some(reason) = fault(&scene) {
        return Err(Fault::damaged(reason));
    }
    Ok(SceneFile {
        scene,
        state,
        metadata: header.metadata,
    })
}
