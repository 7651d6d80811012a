//! The frames of a scene, its training split, and the unit of its depth: that of the poses, or thousandths of it.

use crate::dataset::ImportOptions;
use crate::dataset::files::Inside;
use crate::dataset::side::depth::{self, read_depth};
use crate::error::AtPath;
use crate::files::json;
use crate::{Fault, ReadError};
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

pub(super) fn read(root: &Path, progress: &dyn Progress) -> Result<Split, ReadError> {
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
            return Err(Fault::bad(what, "correct the list of frames").at(&file));
        }
    }
    let all = train.len();
    train.retain(|id| id.camera == 0);
    if train.is_empty() {
        let what = format!("a frame of camera 0 among the {all} of the train split");
        return Err(Fault::missing(what, "give a scene with training frames").at(&file));
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
        return Err(Fault::bad(what, "give each training frame a moment of its own").at(&file));
    }
    let trains: HashSet<&str> = train.iter().map(|id| id.name.as_str()).collect();
    if let Some(both) = test.iter().find(|id| trains.contains(id.name.as_str())) {
        let what = format!("{} is in both splits", both.name);
        return Err(Fault::bad(what, "hold out views that do not train").at(&file));
    }
    Ok(Split { train, test })
}

fn of_split(file: &Path) -> Result<Vec<Id>, ReadError> {
    let names: Names = json(file)?;
    let n = names.frame_names.len();
    if names.camera_ids.len() != n || names.time_ids.len() != n {
        let (c, t) = (names.camera_ids.len(), names.time_ids.len());
        let what = format!("{n} frame_names, {c} camera_ids and {t} time_ids; as many of each were expected");
        return Err(Fault::bad(what, "export the split again").at(file));
    }
    let ids = names.frame_names.into_iter().zip(names.camera_ids).zip(names.time_ids);
    Ok(ids.map(|((name, camera), time)| Id { name, camera, time: time.into() }).collect())
}

fn of_dataset(root: &Path) -> Result<(Vec<Id>, Vec<Id>), ReadError> {
    let file = root.join("dataset.json");
    let dataset: Dataset = json(&file)?;
    let meta: HashMap<String, Meta> = json(&root.join("metadata.json"))?;
    let ids = |names: Vec<String>| -> Result<Vec<Id>, ReadError> {
        let id = |name: String| {
            let found = meta.get(&name);
            let time = found.and_then(|m| m.warp_id.or(m.time_id));
            let Some((meta, time)) = found.zip(time) else {
                let short: String = name.chars().take(MAX_NAME).collect();
                let what = format!("warp_id of {short} in metadata.json");
                return Err(Fault::missing(what, "give the moment of each frame").at(&file));
            };
            Ok(Id { camera: meta.camera_id, time: time.into(), name })
        };
        names.into_iter().map(id).collect()
    };
    Ok((ids(dataset.train_ids)?, ids(dataset.val_ids)?))
}

/// Maps that are examined.
const MAPS: usize = 5;
/// Of these each this many-th pixel.
const STRIDE: usize = 7;
/// From where on a median of depth cannot be metres: the sensor sees 5 m.
const NO_METRES: f64 = 50.0;
/// The unit of the maps where they are not in that of the poses.
const MILLI: f64 = 1e-3;

/// The unit of depth maps.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unit {
    /// Scene units per step of the maps.
    pub scene_units: f64,
    /// Whether a scene unit is a metre: what the sensor of a phone saw.
    pub metric: bool,
}

#[derive(Deserialize)]
struct Scene {
    scale: f64,
    near: f64,
    far: f64,
}

/// `None` where there are no maps.
pub(super) fn unit_of_depth(
    (root, inside): (&Path, &Inside),
    factor: u32,
    train: &[Id],
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Option<Unit>, ReadError> {
    let folder = root.join(format!("depth/{factor}x"));
    let step = train.len().div_ceil(MAPS).max(1);
    let mut seen = Vec::new();
    for id in train.iter().step_by(step) {
        let file = inside.file(folder.join(format!("{}.npy", id.name)))?;
        if file.is_file() {
            let map = read_depth(&file, 1.0).at(&file)?;
            seen.extend(map.every(STRIDE).filter(|&z| z > 0.0));
        }
    }
    if seen.is_empty() {
        return Ok(None);
    }
    let middle = seen.len() / 2;
    let median = f64::from(*seen.select_nth_unstable_by(middle, f32::total_cmp).1);
    if options.depth_unit.is_some() {
        let unit = depth::unit(options, 1.0).at(root)?;
        let metric = median * unit < NO_METRES;
        return Ok(Some(Unit { scene_units: unit, metric }));
    }
    let file = root.join("scene.json");
    let milli = if file.is_file() {
        let scene: Scene = json(&file)?;
        // near and far are of the scaled scene
        let middle = (scene.near * scene.far).sqrt() / scene.scale;
        if !(middle.is_finite() && middle > 0.0) {
            let what = format!(
                "scale {}, near {} and far {}; numbers above 0 were expected",
                scene.scale, scene.near, scene.far
            );
            return Err(Fault::bad(what, "correct them").at(&file));
        }
        let off = |unit: f64| (median * unit / middle).ln().abs();
        off(MILLI) < off(1.0)
    } else {
        median > NO_METRES
    };
    if milli {
        progress.warn(&format!(
            "depth of {} is in thousandths of the unit of its poses (its median is {median:.0}) and is scaled",
            root.display()
        ));
    }
    let scene_units = if milli { MILLI } else { 1.0 };
    Ok(Some(Unit { scene_units, metric: median * scene_units < NO_METRES }))
}
