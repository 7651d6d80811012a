//! Polycam's raw data: key frames with the poses of ARKit, corrected by Polycam where it could.
//!
//! ```text
//! keyframes/corrected_images/T.jpg   keyframes/corrected_cameras/T.json   without distortion, poses optimised; taken where both are
//! keyframes/images/T.jpg             keyframes/cameras/T.json             else these
//! keyframes/depth/T.png              z-depth, 16 bits, millimetres, of another size
//! keyframes/confidence/T.png         0, 127 or 255; depth where it is 0 is dropped
//! ```
//!
//! `T` is the time in microseconds. A camera file has fx fy cx cy width height in pixels and `t_RC`, row R and column C of a camera to
//! world matrix in ARKit's axes (x right, y up, z back; world y up, metres): columns y and z turn round here. The world stays;
//! nerfstudio's `polycam_utils.py` permutes its rows, which is a turn of the world. Source: the README of PolyCam/polyform.

use crate::core::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceFault};
use crate::files::pictures::{Picture, of_file};
use crate::files::{Inside, clock, json, lens, listed, pose, stem};
use crate::side::depth;
use m4_io::capture::Axes;
use m4_math::Se3;
use m4_scene::{Intrinsics, Progress};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Metres a step of depth.
const DEPTH_UNIT: f64 = 1e-3;
const MICROSECONDS: f64 = 1e-6;

#[derive(Deserialize)]
struct Camera {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    width: usize,
    height: usize,
    t_00: f64,
    t_01: f64,
    t_02: f64,
    t_03: f64,
    t_10: f64,
    t_11: f64,
    t_12: f64,
    t_13: f64,
    t_20: f64,
    t_21: f64,
    t_22: f64,
    t_23: f64,
}

impl Camera {
    fn c2w(&self) -> Result<Se3<f64>, SourceFault> {
        let rows = [
            [self.t_00, self.t_01, self.t_02],
            [self.t_10, self.t_11, self.t_12],
            [self.t_20, self.t_21, self.t_22],
        ];
        let arkit = pose::of_rotation(rows, [self.t_03, self.t_13, self.t_23])?;
        Ok(Axes::OpenGl.to_opencv(&arkit))
    }

    fn intrinsics(&self) -> Intrinsics {
        lens::pinhole([self.fx, self.fy, self.cx, self.cy], (self.width, self.height))
    }
}

/// The folder `keyframes`, which may be given itself.
fn keyframes(path: &Path) -> PathBuf {
    let inner = path.join("keyframes");
    if inner.is_dir() { inner } else { path.to_path_buf() }
}

/// Whether a folder is of it.
pub(crate) fn detect(path: &Path) -> bool {
    let root = keyframes(path);
    let has = |name: &str| root.join(name).is_dir();
    let folders = (has("cameras") && has("images")) || (has("corrected_cameras") && has("corrected_images"));
    // others have folders of these names too
    folders && root.ends_with("keyframes")
}

pub(crate) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    let root = keyframes(path);
    let corrected = root.join("corrected_images").is_dir() && root.join("corrected_cameras").is_dir();
    let (images, cameras) = if corrected {
        (root.join("corrected_images"), root.join("corrected_cameras"))
    } else {
        progress.warn(&format!(
            "{} has no corrected cameras: those of the device are taken, and its lens for one without distortion",
            path.display()
        ));
        (root.join("images"), root.join("cameras"))
    };
    let inside = Inside::of(path, options);
    let pictures = listed(options.pictures.as_deref().unwrap_or(&images), &["jpg", "jpeg", "png"])?;
    let pictures = inside.files(pictures)?;
    if pictures.is_empty() {
        return Err(SourceFault::missing("every picture", "export the raw data again").at(&images));
    }
    let times: Vec<f64> = pictures.iter().map(|p| microseconds(p)).collect::<Result<_, _>>()?;
    if let Some(i) = (1..times.len()).find(|&i| times[i] <= times[i - 1]) {
        let what = "its time is not after that of the picture before it";
        return Err(SourceFault::bad(what, "name each picture by its time").at(&pictures[i]));
    }
    let (t, span) = clock::in_frames(&times);
    let unit = depth::unit(options, DEPTH_UNIT).map_err(|fault| fault.at(path))?;
    let frames = pictures
        .iter()
        .zip(t)
        .map(|(picture, t)| frame((&root, &inside), &cameras, picture, t, unit));
    let train = frames.collect::<Result<_, _>>()?;
    Ok(Listing {
        metric: true,
        ..Listing::of_video(train, pictures.len(), Some(span * MICROSECONDS))
    })
}

/// The time that a picture is named by.
fn microseconds(picture: &Path) -> Result<f64, ReadSourceError> {
    stem(picture).parse::<u64>().map(|t| t as f64).map_err(|_| {
        let what = "its name is not a time in microseconds";
        SourceFault::bad(what, "give the pictures as they were exported").at(picture)
    })
}

fn frame(
    (root, inside): (&Path, &Inside),
    cameras: &Path,
    picture: &Path,
    t: f64,
    unit: f64,
) -> Result<ListedFrame, ReadSourceError> {
    let name = stem(picture);
    let file = cameras.join(format!("{name}.json"));
    let camera: Camera = json(&file)?;
    let c2w = camera.c2w().map_err(|fault| fault.within(&file, "t_00 to t_23"))?;
    let lens = Lens::pinhole(camera.intrinsics());
    lens.check()
        .map_err(|what| SourceFault::bad(what, "export the raw data again").at(&file))?;
    let Picture { size, rgb, .. } = of_file(picture).map_err(|fault| fault.at(picture))?;
    let k = lens::resized(&lens.intrinsics, size).map_err(|fault| fault.at(picture))?;
    let (sensed, confidence) = (
        inside.file(root.join(format!("depth/{name}.png")))?,
        inside.file(root.join(format!("confidence/{name}.png")))?,
    );
    Ok(ListedFrame {
        depth: sensed
            .is_file()
            .then(|| FrameSource::new(move || depth::read_sensed(&sensed, &confidence, unit))),
        ..ListedFrame::new(name, Lens::pinhole(k), c2w, t, rgb)
    })
}
