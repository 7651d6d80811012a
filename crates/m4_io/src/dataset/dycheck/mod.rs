//! Nerfies, HyperNeRF and the iPhone scenes of DyCheck, which share one layout.
//!
//! ```text
//! dataset.json            ids, train_ids, val_ids
//! metadata.json           id -> warp_id (or time_id), camera_id
//! scene.json              scale, center, near, far: of the scene after `(x - center) * scale`; used here to tell the unit of depth
//! extra.json              fps (DyCheck)
//! splits/{train,val}.json frame_names, camera_ids, time_ids (DyCheck; else train_ids and val_ids of dataset.json)
//! camera/ID.json          orientation (3x3, world to camera), position (the camera's centre), focal_length, principal_point (from the
//!                         corner), image_size [w, h], skew, pixel_aspect_ratio, radial_distortion [3], tangential_distortion [2]
//! rgb/Fx/ID.png           shrunk F times; depth/Fx/ID.npy z-depth [h][w][1], 0 where unknown; covisible/Fx/val/ID.png ([`covisible`])
//! ```
//!
//! Source: `dycheck/geometry/camera.py`, `dycheck/datasets/{nerfies,iphone}.py` of KAIR-BAIR/dycheck.
//!
//! The training video is what camera 0 took of the train split, in order of time; the test views are all of the val split within
//! its time. Axes are OpenCV's there too; `orientation` is inverted. World units stay those of `position`: neither `center`
//! nor `scale` is applied. Intrinsics are of factor 1 and shrink with the images. Depth may be in millimetres while places are in metres
//! (the authors' page says so, their code takes both as equal): the unit is the one that puts the median of depth between `near` and
//! `far`.

mod ids;

use self::ids::{Id, Split, Unit, unit_of_depth};
use crate::dataset::files::images::{self, StoredImage, of_file};
use crate::dataset::files::{Inside, clock};
use crate::dataset::side::depth;
use crate::dataset::{Distortion, ImportOptions, Lens, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::json;
use crate::{Fault, ReadError, pose};
use m4_core::{Intrinsics, Progress, Se3};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// By what images are shrunk: 2 in the tables of the papers.
const DEFAULT_FACTOR: u32 = 2;

/// Detects a folder of the format.
pub(crate) fn detect(path: &Path) -> bool {
    path.join("dataset.json").is_file() && path.join("camera").is_dir() && path.join("rgb").is_dir()
}

/// Where the mask of co-visibility of a test view lies: white where enough training frames see the place. `name` is that of the view's
/// frame, `factor` what [`ImportOptions::factor`] was (2 where it was not given). The file need not exist: Nerfies and HyperNeRF come
/// without.
#[must_use]
pub fn covisible(root: &Path, name: &str, factor: Option<u32>) -> PathBuf {
    let factor = factor.unwrap_or(DEFAULT_FACTOR);
    root.join(format!("covisible/{factor}x/val/{name}.png"))
}

#[derive(Deserialize)]
struct Extra {
    fps: Option<f64>,
}

pub(crate) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadError> {
    let factor = options.factor.unwrap_or(DEFAULT_FACTOR);
    let folder = path.join(format!("rgb/{factor}x"));
    if !folder.is_dir() {
        let hint = "choose a factor whose images exist (the option factor)";
        return Err(Fault::missing(format!("rgb/{factor}x"), hint).at(path));
    }
    let Split { train, test } = ids::read(path, progress)?;
    let (first, last) = (train[0].time, train[train.len() - 1].time);
    // the video's own frames are one apart; ids may have gaps, such as those of held-out moments
    let step = (last - first) / (train.len().max(2) - 1) as f64;
    let inside = Inside::of(path, options);
    let unit = unit_of_depth((path, &inside), factor, &train, options, progress)?;
    let reader = Reader {
        root: path,
        inside,
        factor,
        first,
        step: if step > 0.0 { step } else { 1.0 },
        steps: (train.len() - 1) as f64,
        unit,
    };
    let within: Vec<&Id> = test.iter().filter(|id| (first..=last).contains(&id.time)).collect();
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
        train: train.iter().map(|id| reader.frame(id, None)).collect::<Result<_, _>>()?,
        test: within.iter().map(|id| reader.frame(id, Some(id.camera))).collect::<Result<_, _>>()?,
        tracks: None,
    })
}

fn fps(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<f64, ReadError> {
    let file = path.join("extra.json");
    let given = clock::fps(options).at(path)?;
    let own = if file.is_file() { json::<Extra>(&file)?.fps } else { None };
    if own.or(given).is_none() {
        progress.warn(&format!("{} does not state its frame rate; 30 frames per second are assumed", path.display()));
    }
    let fps = own.or(given).unwrap_or(clock::DEFAULT_FPS);
    if fps.is_finite() && fps > 0.0 {
        return Ok(fps);
    }
    let what = format!("fps is {fps}; frames per second, above 0, were expected");
    Err(Fault::bad(what, "correct it").at(&file))
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
        let camera = read_camera(&file)?;
        let image = self.root.join(format!("rgb/{}x/{}.png", self.factor, id.name));
        let image = self.inside.file(image)?;
        let StoredImage { size, rgb } = of_file(&image)?;
        let mut lens = camera.lens;
        lens.intrinsics = images::resized(&lens.intrinsics, size).at(&image)?;
        let depth = self.root.join(format!("depth/{}x/{}.npy", self.factor, id.name));
        let depth = self.inside.file(depth)?;
        let unit = self.unit.filter(|_| depth.is_file());
        let t = ((id.time - self.first) / self.step).clamp(0.0, self.steps);
        Ok(ListedFrame {
            depth: unit.map(|unit| depth::source(depth, unit.scene_units, unit.scene_units)),
            camera_index,
            ..ListedFrame::new(id.name.clone(), lens, camera.c2w, t, rgb)
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

struct Camera {
    /// Of the images of factor 1.
    lens: Lens,
    c2w: Se3<f64>,
}

fn read_camera(path: &Path) -> Result<Camera, ReadError> {
    let file: File = json(path)?;
    if file.skew != 0.0 {
        let what = format!("skew is {}; only cameras whose pixels are rectangles are read", file.skew);
        return Err(Fault::unsupported(what, "undistort the images").at(path));
    }
    let whole = |v: f64| (v.fract() == 0.0 && (1.0..=65536.0).contains(&v)).then_some(v as usize);
    let [Some(width), Some(height)] = file.image_size.map(whole) else {
        let what = format!("image_size is {:?}; [width, height] in pixels was expected", file.image_size);
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
    let c2w = pose::of_rotation(turned, file.position).map_err(|e| e.within(path, "orientation and position"))?;
    Ok(Camera { lens, c2w })
}
