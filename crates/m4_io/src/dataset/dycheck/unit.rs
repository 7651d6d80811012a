//! Detects whether depth is in the unit of the poses or in thousandths of it.

use super::ids::Id;
use crate::dataset::files::{Inside, json};
use crate::dataset::side::depth::{self, read_depth};
use crate::dataset::{ImportOptions, ReadSourceError, SourceErrorCause};
use m4_core::Progress;
use serde::Deserialize;
use std::path::Path;

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
pub(super) fn of_depth(
    (root, inside): (&Path, &Inside),
    factor: u32,
    train: &[Id],
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Option<Unit>, ReadSourceError> {
    let folder = root.join(format!("depth/{factor}x"));
    let step = train.len().div_ceil(MAPS).max(1);
    let mut seen = Vec::new();
    for id in train.iter().step_by(step) {
        let file = inside.file(folder.join(format!("{}.npy", id.name)))?;
        if file.is_file() {
            let map = read_depth(&file, 1.0).map_err(|e| e.at(&file))?;
            seen.extend(map.every(STRIDE).filter(|&z| z > 0.0));
        }
    }
    if seen.is_empty() {
        return Ok(None);
    }
    let middle = seen.len() / 2;
    let median = f64::from(*seen.select_nth_unstable_by(middle, f32::total_cmp).1);
    if options.depth_unit.is_some() {
        let unit = depth::unit(options, 1.0).map_err(|e| e.at(root))?;
        let metric = median * unit < NO_METRES;
        return Ok(Some(Unit {
            scene_units: unit,
            metric,
        }));
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
            return Err(SourceErrorCause::bad(what, "correct them").at(&file));
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
    Ok(Some(Unit {
        scene_units,
        metric: median * scene_units < NO_METRES,
    }))
}
