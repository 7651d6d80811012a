//! The iPhone scenes of DyCheck, and the scenes of Nerfies and HyperNeRF that DyCheck republished
//! in the same layout.
//!
//! ```text
//! dataset.json            tells the format
//! scene.json              scale, center, near, far: of the scene after `(x - center) * scale`; used here to tell the unit of depth
//! extra.json              fps (DyCheck)
//! splits/{train,val}.json frame_names, camera_ids, time_ids
//! camera/ID.json          orientation (3x3, world to camera), position (the camera's centre), focal_length, principal_point (from the
//!                         corner), image_size [w, h], skew, pixel_aspect_ratio, radial_distortion [3], tangential_distortion [2]
//! rgb/Fx/ID.png           shrunk F times; depth/Fx/ID.npy z-depth [h][w][1], 0 where unknown; covisible/Fx/val/ID.png ([`covisible`])
//! ```
//!
//! Source: `dycheck/geometry/camera.py`, `dycheck/datasets/{nerfies,iphone}.py` of
//! KAIR-BAIR/dycheck.
//!
//! The training video is what camera 0 took of the train split, in order of time; the test views
//! are all of the val split within its time. Axes are OpenCV's there too; `orientation` is
//! inverted. World units stay those of `position`: neither `center` nor `scale` is applied.
//! Intrinsics are of factor 1 and shrink with the images. Depth may be in millimetres while places
//! are in metres (the authors' page says so, their code takes both as equal): the unit is the one
//! that puts the median of depth between `near` and `far`.

use crate::dataset::depth::{self, read_depth};
use crate::dataset::files::{
    DEFAULT_FPS, Inside, StoredImage, fps_of, given_fps, resized, stored_image,
};
use crate::dataset::{Distortion, ImportOptions, Lens, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::json;
use crate::{Fault, ReadError, pose};
use m4_core::{Intrinsics, Progress, Se3};
use serde::Deserialize;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// By what images are shrunk: 2 in the tables of the papers.
const DEFAULT_FACTOR: u32 = 2;

/// Detects a folder of the format.
pub(crate) fn detect(path: &Path) -> bool {
    path.join("dataset.json").is_file() && path.join("camera").is_dir() && path.join("rgb").is_dir()
}

/// Where the mask of co-visibility of a test view lies: white where enough training frames see the
/// place. `name` is that of the view's frame, `factor` what [`ImportOptions::factor`] was (2 where
/// it was not given). The file need not exist: Nerfies and HyperNeRF come without.
#[must_use]
pub fn covisible(root: &Path, name: &str, factor: Option<u32>) -> PathBuf {
    let factor = factor.unwrap_or(DEFAULT_FACTOR);
    root.join(format!("covisible/{factor}x/val/{name}.png"))
}

#[derive(Deserialize)]
struct Extra {
    fps: Option<f64>,
}

pub(crate) fn list(
    path: &Path,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Listing, ReadError> {
    let factor = options.factor.unwrap_or(DEFAULT_FACTOR);
    let folder = path.join(format!("rgb/{factor}x"));
    if !folder.is_dir() {
        let hint = "choose a factor whose images exist (the option factor)";
        return Err(Fault::missing(format!("rgb/{factor}x"), hint).at(path));
    }
    let Split { train, test } = read_split(path, progress)?;
    let (first, last) = (train[0].time, train[train.len() - 1].time);
    // the video's own frames are one apart; ids may have gaps, such as those of held-out moments
    let step = (last - first) / (train.len().max(2) - 1) as f64;
    let inside = Inside::of(path, options);
    let unit = unit_of_depth((path, &inside), factor, &train, progress)?;
    let reader = Reader {
        root: path,
        inside,
        factor,
        first,
        step: if step > 0.0 { step } else { 1.0 },
        steps: (train.len() - 1) as f64,
        unit,
    };
    let within: Vec<&Id> = test
        .iter()
        .filter(|id| (first..=last).contains(&id.time))
        .collect();
    if within.len() < test.len() {
        progress.warn(&format!(
            "{} of {} held-out views are before the first or after the last training frame and are left out",
            test.len() - within.len(),
            test.len()
        ));
    }
    let fps = fps(path, options, progress)?;
    Ok(Listing {
        time_frames: train.len(),
        duration_s: Some((last - first) / fps),
        metric: reader.unit.is_some_and(|u| u.metric),
        train: train
            .iter()
            .map(|id| reader.frame(id, None))
            .collect::<Result<_, _>>()?,
        test: within
            .iter()
            .map(|id| reader.frame(id, Some(id.camera)))
            .collect::<Result<_, _>>()?,
        tracks: None,
    })
}

fn fps(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<f64, ReadError> {
    let file = path.join("extra.json");
    let option_fps = given_fps(options).at(path)?;
    let own = if file.is_file() {
        json::<Extra>(&file)?.fps
    } else {
        None
    };
    if own.or(option_fps).is_none() {
        progress.warn(&format!(
            "{} does not state its frame rate; 30 frames per second are assumed",
            path.display()
        ));
    }
    let fps = own.or(option_fps).unwrap_or(DEFAULT_FPS);
    fps_of("fps", fps).at(&file)
}

struct Reader<'a> {
    root: &'a Path,
    inside: Inside,
    factor: u32,
    /// Time of the first training frame and from one to the next, in the numbers of the files.
    first: f64,
    step: f64,
    /// From the first to the last training frame, in frames.
    steps: f64,
    unit: Option<Unit>,
}

impl Reader<'_> {
    fn frame(&self, id: &Id, camera_index: Option<u32>) -> Result<ListedFrame, ReadError> {
        let file = self.root.join(format!("camera/{}.json", id.name));
        let (mut lens, c2w) = read_camera(&file)?;
        let image = self
            .root
            .join(format!("rgb/{}x/{}.png", self.factor, id.name));
        let image = self.inside.file(image)?;
        let StoredImage { size, rgb } = stored_image(&image)?;
        lens.intrinsics = resized(&lens.intrinsics, size).at(&image)?;
        let depth = self
            .root
            .join(format!("depth/{}x/{}.npy", self.factor, id.name));
        let depth = self.inside.file(depth)?;
        let unit = self.unit.filter(|_| depth.is_file());
        let t = ((id.time - self.first) / self.step).clamp(0.0, self.steps);
        Ok(ListedFrame {
            depth: unit.map(|unit| depth::source(depth, unit.scene_units, unit.scene_units)),
            camera_index,
            ..ListedFrame::new(id.name.clone(), lens, c2w, t, rgb)
        })
    }
}

const HINT: &str = "correct the camera, or export it again";

#[derive(Deserialize)]
struct File {
    orientation: [[f64; 3]; 3],
    position: [f64; 3],
    focal_length: f64,
    principal_point: [f64; 2],
    image_size: [f64; 2],
    #[serde(default)]
    skew: f64,
    #[serde(default = "one")]
    pixel_aspect_ratio: f64,
    #[serde(default)]
    radial_distortion: [f64; 3],
    /// Early files call it `tangential`.
    #[serde(default, alias = "tangential")]
    tangential_distortion: [f64; 2],
}

fn one() -> f64 {
    1.0
}

/// The lens, of the images of factor 1, and the pose.
fn read_camera(path: &Path) -> Result<(Lens, Se3<f64>), ReadError> {
    let file: File = json(path)?;
    if file.skew != 0.0 {
        let what = format!(
            "skew is {}; only cameras whose pixels are rectangles are read",
            file.skew
        );
        return Err(Fault::unsupported(what, "undistort the images").at(path));
    }
    let whole = |v: f64| (v.fract() == 0.0 && (1.0..=65536.0).contains(&v)).then_some(v as usize);
    let [Some(width), Some(height)] = file.image_size.map(whole) else {
        let what = format!(
            "image_size is {:?}; [width, height] in pixels was expected",
            file.image_size
        );
        return Err(Fault::bad(what, HINT).at(path));
    };
    let [k1, k2, k3] = file.radial_distortion;
    let [p1, p2] = file.tangential_distortion;
    let lens = Lens {
        intrinsics: Intrinsics {
            width,
            height,
            fx: file.focal_length,
            fy: file.focal_length * file.pixel_aspect_ratio,
            cx: file.principal_point[0],
            cy: file.principal_point[1],
        },
        distortion: Distortion::brown(k1, k2, k3, p1, p2),
    };
    lens.check().at(path)?;
    // orientation is world to camera: its transpose turns camera to world
    let o = file.orientation;
    let turned = [0, 1, 2].map(|i| [o[0][i], o[1][i], o[2][i]]);
    let c2w = pose::of_rotation(turned, file.position)
        .map_err(|e| e.within(path, "orientation and position"))?;
    Ok((lens, c2w))
}

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

pub(super) fn read_split(root: &Path, progress: &dyn Progress) -> Result<Split, ReadError> {
    let file = root.join("splits/train.json");
    if !file.is_file() {
        let hint =
            "give a scene of DyCheck, or one of Nerfies or HyperNeRF with the splits of DyCheck";
        return Err(Fault::missing("splits/train.json", hint).at(root));
    }
    let val = root.join("splits/val.json");
    let mut train = of_split(&file)?;
    let test = if val.is_file() {
        of_split(&val)?
    } else {
        Vec::new()
    };
    for id in train.iter().chain(&test) {
        // a name becomes part of a path
        if !(1..=MAX_NAME).contains(&id.name.len())
            || id.name.contains(['/', '\\'])
            || id.name.contains("..")
        {
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
        let what = format!(
            "{} and {} are of one moment and one camera",
            pair[0].name, pair[1].name
        );
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
        let what = format!(
            "{n} frame_names, {c} camera_ids and {t} time_ids; as many of each were expected"
        );
        return Err(Fault::bad(what, "export the split again").at(file));
    }
    let ids = names
        .frame_names
        .into_iter()
        .zip(names.camera_ids)
        .zip(names.time_ids);
    Ok(ids
        .map(|((name, camera), time)| Id {
            name,
            camera,
            time: time.into(),
        })
        .collect())
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
    /// SceneJson units per step of the maps.
    pub scene_units: f64,
    /// Whether a scene unit is a metre: what the sensor of a phone saw.
    pub metric: bool,
}

#[derive(Deserialize)]
struct SceneJson {
    scale: f64,
    near: f64,
    far: f64,
}

/// `None` where there are no maps.
pub(super) fn unit_of_depth(
    (root, inside): (&Path, &Inside),
    factor: u32,
    train: &[Id],
    progress: &dyn Progress,
) -> Result<Option<Unit>, ReadError> {
    let folder = root.join(format!("depth/{factor}x"));
    let step = train.len().div_ceil(MAPS).max(1);
    let mut depths = Vec::new();
    for id in train.iter().step_by(step) {
        let file = inside.file(folder.join(format!("{}.npy", id.name)))?;
        if file.is_file() {
            let map = read_depth(&file, 1.0).at(&file)?;
            depths.extend(map.every(STRIDE).filter(|&z| z > 0.0));
        }
    }
    let Some(median) = m4_core::median(&mut depths).map(f64::from) else {
        return Ok(None);
    };
    let file = root.join("scene.json");
    let milli = if file.is_file() {
        let scene: SceneJson = json(&file)?;
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
    Ok(Some(Unit {
        scene_units,
        metric: median * scene_units < NO_METRES,
    }))
}
