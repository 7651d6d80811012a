//! `camera/ID.json`.

use crate::dataset::files::{json, pose};
use crate::dataset::{Distortion, Lens, ReadSourceError, SourceErrorCause};
use m4_core::{Intrinsics, Se3};
use serde::Deserialize;
use std::path::Path;

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

pub(super) struct Camera {
    /// Of the images of factor 1.
    pub lens: Lens,
    pub c2w: Se3<f64>,
}

pub(super) fn read(path: &Path) -> Result<Camera, ReadSourceError> {
    let file: File = json(path)?;
    if file.skew != 0.0 {
        let what = format!(
            "skew is {}; only cameras whose pixels are rectangles are read",
            file.skew
        );
        return Err(SourceErrorCause::unsupported(what, "undistort the images").at(path));
    }
    let whole = |v: f64| (v.fract() == 0.0 && (1.0..=65536.0).contains(&v)).then_some(v as usize);
    let [Some(width), Some(height)] = file.image_size.map(whole) else {
        let what = format!(
            "image_size is {:?}; [width, height] in pixels was expected",
            file.image_size
        );
        return Err(SourceErrorCause::bad(what, HINT).at(path));
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
    lens.check()
        .map_err(|what| SourceErrorCause::bad(what, HINT).at(path))?;
    // orientation is world to camera: its transpose turns camera to world
    let o = file.orientation;
    let turned = [0, 1, 2].map(|i| [o[0][i], o[1][i], o[2][i]]);
    let c2w = pose::of_rotation(turned, file.position).map_err(|e| e.within(path, "orientation and position"))?;
    Ok(Camera { lens, c2w })
}
