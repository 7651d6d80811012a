//! nerfstudio's `transforms.json`.
//!
//! ```text
//! fl_x fl_y cx cy w h      pixels; of all frames, or inside each frame where they differ
//! frames[].file_path        name of the image, relative to the file
//!         .transform_matrix 4 x 4, camera to world, OpenGL axes (right, up, back)
//!         .time             0..1, first to last frame
//! ```
//!
//! [`crate::trajectory::read`] reads it back, as does `minute4d render --path`.

use super::BadName;
use super::names::names;
use crate::ErrorKind;
use crate::capture::Axes;
use crate::scene::WriteFileError;
use crate::scene::cameras_check::usable;
use crate::scene::verified::VerifiedFile;
use crate::scene::{Loss, Written};
use crate::trajectory;
use m4_core::{Intrinsics, Scene, SourceFrame};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Largest difference of a pose that is read back, world units and entries of the rotation.
const POSE_WITHIN: f64 = 1e-6;

/// Settings of [`write()`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NerfstudioOptions {
    /// Names of the images, relative to the file, one per camera of the scene. Default: `00000.png`, ...
    pub names: Option<Vec<String>>,
}

/// Why `transforms.json` could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteNerfstudioError {
    /// The file did not get to the disk as it was made.
    #[error(transparent)]
    File(#[from] WriteFileError),
    /// The scene has no cameras, or one that is no camera.
    #[error("cannot write {}: {what}", path.display())]
    BadScene {
        /// The file.
        path: PathBuf,
        /// The fault, and where it is.
        what: String,
    },
    /// The names do not fit.
    #[error("cannot write {}: {source}", path.display())]
    Names {
        /// The file.
        path: PathBuf,
        /// The fault.
        source: BadName,
    },
}

impl WriteNerfstudioError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(e) => e.kind(),
            Self::BadScene { .. } | Self::Names { .. } => ErrorKind::BadData,
        }
    }
}

/// Writes the cameras of a scene and reads them back before the file gets its name.
///
/// # Errors
///
/// [`WriteNerfstudioError`]; what was at `path` is then still there.
pub fn write(path: &Path, scene: &Scene, options: &NerfstudioOptions) -> Result<Written, WriteNerfstudioError> {
    let io = |e| WriteNerfstudioError::File(WriteFileError::io(path, e));
    let bad = |what: String| WriteNerfstudioError::BadScene {
        path: path.to_path_buf(),
        what,
    };
    let Some(first) = scene.source.first() else {
        return Err(bad("the scene has no cameras".into()));
    };
    let last = scene.time_frames.max(2) as f64 - 1.0;
    let timely = |f: &SourceFrame| (0.0..=last).contains(&f.t);
    if let Some(i) = scene.source.iter().position(|f| !usable(f) || !timely(f)) {
        let SourceFrame { camera, t, .. } = scene.source[i];
        return Err(bad(format!(
            "camera {i} of the scene is none, or not of its time: {camera:?} at frame {t}"
        )));
    }
    let names = names(scene, options.names.as_deref()).map_err(|source| WriteNerfstudioError::Names {
        path: path.to_path_buf(),
        source,
    })?;
    let shared = scene
        .source
        .iter()
        .all(|f| f.camera.intrinsics == first.camera.intrinsics);
    let mut root = Map::new();
    root.insert("camera_model".into(), json!("OPENCV"));
    if shared {
        lens(&mut root, &first.camera.intrinsics);
    }
    if let Some(duration_s) = scene.duration_s {
        root.insert("duration_s".into(), json!(duration_s));
    }
    let frames = scene.source.iter().zip(names).map(|(frame, name)| {
        let pose = Axes::OpenGl.to_opencv(&frame.camera.c2w).matrix();
        let rows: [[f64; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| pose[(i, j)] + 0.0));
        let mut entry = Map::new();
        entry.insert("file_path".into(), json!(name));
        entry.insert("time".into(), json!(frame.t / last));
        if !shared {
            lens(&mut entry, &frame.camera.intrinsics);
        }
        entry.insert("transform_matrix".into(), json!(rows));
        Value::Object(entry)
    });
    root.insert("frames".into(), frames.collect());
    let mut text = serde_json::to_vec_pretty(&root).map_err(|e| io(e.into()))?;
    text.push(b'\n');
    let mut file = VerifiedFile::create(path).map_err(io)?;
    file.write_all(&text).map_err(io)?;
    let verify = |reason: String| WriteNerfstudioError::File(WriteFileError::verify(path, reason));
    let temporary = file.verify().map_err(|e| verify(e.to_string()))?;
    let back = trajectory::read(temporary, scene.time_frames.max(2)).map_err(|e| verify(e.to_string()))?;
    let same = back.len() == scene.source.len()
        && back.iter().zip(&scene.source).all(|((camera, t), frame)| {
            let off = (camera.c2w.matrix() - frame.camera.c2w.matrix()).amax();
            off <= POSE_WITHIN * (1.0 + frame.camera.c2w.translation.amax())
                && (t - frame.t).abs() < 1e-6
                && camera.intrinsics == frame.camera.intrinsics
        });
    if !same {
        return Err(verify("a camera is another one".into()));
    }
    Ok(Written {
        path: path.to_path_buf(),
        bytes: file.commit().map_err(io)?,
        splats: 0,
        losses: vec![Loss::Dropped("the splats: cameras alone".into())],
    })
}

fn lens(to: &mut Map<String, Value>, k: &Intrinsics) {
    for (key, value) in [("fl_x", k.fx), ("fl_y", k.fy), ("cx", k.cx), ("cy", k.cy)] {
        to.insert(key.into(), json!(value));
    }
    to.insert("w".into(), json!(k.width));
    to.insert("h".into(), json!(k.height));
}
