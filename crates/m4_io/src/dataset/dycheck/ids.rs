//! The frames of a scene, and its training split.

use crate::dataset::files::json;
use crate::dataset::{ReadSourceError, SourceErrorCause};
use m4_core::Progress;
use serde::Deserialize;
use std::collections::{HashMap, HashSet};
use std::path::Path;

/// Longest name of a frame.
const MAX_NAME: usize = 80;

/// A frame.
#[derive(Debug, Clone)]
pub(super) struct Id {
    pub name: String,
    pub camera: u32,
    /// In the numbers of the files.
    pub time: f64,
}

/// Both at least in part: `train` has one frame or more, in order of time.
pub(super) struct Split {
    pub train: Vec<Id>,
    pub test: Vec<Id>,
}

#[derive(Deserialize)]
struct Names {
    frame_names: Vec<String>,
    camera_ids: Vec<u32>,
    time_ids: Vec<u32>,
}

#[derive(Deserialize)]
struct Dataset {
    #[serde(default)]
    train_ids: Vec<String>,
    #[serde(default)]
    val_ids: Vec<String>,
}

#[derive(Deserialize)]
struct Meta {
    /// Which moment; HyperNeRF calls it `time_id` in some files.
    warp_id: Option<u32>,
    time_id: Option<u32>,
    #[serde(default)]
    camera_id: u32,
}

pub(super) fn read(root: &Path, progress: &dyn Progress) -> Result<Split, ReadSourceError> {
    let (mut train, test, file) = if root.join("splits/train.json").is_file() {
        let file = root.join("splits/train.json");
        let val = root.join("splits/val.json");
        let test = if val.is_file() { of_split(&val)? } else { Vec::new() };
        (of_split(&file)?, test, file)
    } else {
        let (train, test) = of_dataset(root)?;
        (train, test, root.join("dataset.json"))
    };
    for id in train.iter().chain(&test) {
        // a name becomes part of a path
        if !(1..=MAX_NAME).contains(&id.name.len()) || id.name.contains(['/', '\\']) || id.name.contains("..") {
            let short: String = id.name.chars().take(MAX_NAME).collect();
            let what = format!("{short:?} is not the name of a frame");
            return Err(SourceErrorCause::bad(what, "correct the list of frames").at(&file));
        }
    }
    let all = train.len();
    train.retain(|id| id.camera == 0);
    if train.is_empty() {
        let what = format!("a frame of camera 0 among the {all} of the train split");
        return Err(SourceErrorCause::missing(what, "give a scene with training frames").at(&file));
    }
    if train.len() < all {
        progress.warn(&format!(
            "{} of {all} training frames of {} are of other cameras than 0 and are left out: the training video is that of one camera",
            all - train.len(),
            root.display()
        ));
    }
    train.sort_by(|a, b| a.time.total_cmp(&b.time));
    if let Some(pair) = train.windows(2).find(|pair| pair[0].time == pair[1].time) {
        let what = format!("{} and {} are of one moment and one camera", pair[0].name, pair[1].name);
        return Err(SourceErrorCause::bad(what, "give each training frame a moment of its own").at(&file));
    }
    let trains: HashSet<&str> = train.iter().map(|id| id.name.as_str()).collect();
    if let Some(both) = test.iter().find(|id| trains.contains(id.name.as_str())) {
        let what = format!("{} is in both splits", both.name);
        return Err(SourceErrorCause::bad(what, "hold out views that do not train").at(&file));
    }
    Ok(Split { train, test })
}

fn of_split(file: &Path) -> Result<Vec<Id>, ReadSourceError> {
    let names: Names = json(file)?;
    let n = names.frame_names.len();
    if names.camera_ids.len() != n || names.time_ids.len() != n {
        let (c, t) = (names.camera_ids.len(), names.time_ids.len());
        let what = format!("{n} frame_names, {c} camera_ids and {t} time_ids; as many of each were expected");
        return Err(SourceErrorCause::bad(what, "export the split again").at(file));
    }
    let ids = names.frame_names.into_iter().zip(names.camera_ids).zip(names.time_ids);
    Ok(ids
        .map(|((name, camera), time)| Id {
            name,
            camera,
            time: time.into(),
        })
        .collect())
}

fn of_dataset(root: &Path) -> Result<(Vec<Id>, Vec<Id>), ReadSourceError> {
    let file = root.join("dataset.json");
    let dataset: Dataset = json(&file)?;
    let meta: HashMap<String, Meta> = json(&root.join("metadata.json"))?;
    let ids = |names: Vec<String>| -> Result<Vec<Id>, ReadSourceError> {
        let id = |name: String| {
            let found = meta.get(&name);
            let time = found.and_then(|m| m.warp_id.or(m.time_id));
            let Some((meta, time)) = found.zip(time) else {
                let short: String = name.chars().take(MAX_NAME).collect();
                let what = format!("warp_id of {short} in metadata.json");
                return Err(SourceErrorCause::missing(what, "give the moment of each frame").at(&file));
            };
            Ok(Id {
                camera: meta.camera_id,
                time: time.into(),
                name,
            })
        };
        names.into_iter().map(id).collect()
    };
    Ok((ids(dataset.train_ids)?, ids(dataset.val_ids)?))
}
