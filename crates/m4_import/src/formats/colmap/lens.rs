//! COLMAP's camera models.

use crate::core::{Distortion, Lens, SourceFault};
use m4_formats::cameras::colmap::ColmapCamera;
use m4_scene::Intrinsics;

/// Longest side of a picture, pixels.
const MAX_SIDE: u64 = 1 << 16;

/// The lens of a camera.
pub(super) fn of(camera: &ColmapCamera) -> Result<Lens, SourceFault> {
    let fisheye = |k: [f64; 4]| Distortion::Fisheye { k };
    let radial = |k1, k2| Distortion::brown(k1, k2, 0.0, 0.0, 0.0);
    let ([fx, fy, cx, cy], distortion) = match (camera.model.as_str(), camera.parameters.as_slice()) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f, cx, cy], Distortion::None),
        ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy, cx, cy], Distortion::None),
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => ([f, f, cx, cy], radial(k, 0.0)),
        ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f, cx, cy], radial(k1, k2)),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => ([fx, fy, cx, cy], Distortion::brown(k1, k2, 0.0, p1, p2)),
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            let full = Distortion::Brown {
                radial: [k1, k2, k3, k4, k5, k6],
                tangential: [p1, p2],
            };
            let none = [k1, k2, p1, p2, k3, k4, k5, k6] == [0.0; 8];
            ([fx, fy, cx, cy], if none { Distortion::None } else { full })
        }
        ("SIMPLE_FISHEYE", &[f, cx, cy]) => ([f, f, cx, cy], fisheye([0.0; 4])),
        ("FISHEYE", &[fx, fy, cx, cy]) => ([fx, fy, cx, cy], fisheye([0.0; 4])),
        ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => ([f, f, cx, cy], fisheye([k, 0.0, 0.0, 0.0])),
        ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => ([f, f, cx, cy], fisheye([k1, k2, 0.0, 0.0])),
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => ([fx, fy, cx, cy], fisheye([k1, k2, k3, k4])),
        (model, parameters) => {
            let what = format!("its lens is of the model {model} with {} parameters", parameters.len());
            let remedy = "models of pinholes, RADIAL, OPENCV and their fisheyes are read; undistort the pictures \
                          (`colmap image_undistorter`)";
            return Err(SourceFault::unsupported(what, remedy));
        }
    };
    let side = |px: u64| (1..=MAX_SIDE).contains(&px);
    if !(side(camera.width) && side(camera.height)) {
        let what = format!("its pictures are {} x {} pixels", camera.width, camera.height);
        return Err(SourceFault::bad(what, "export the model again"));
    }
    let lens = Lens {
        intrinsics: Intrinsics {
            width: camera.width as usize,
            height: camera.height as usize,
            fx,
            fy,
            cx,
            cy,
        },
        distortion,
    };
    lens.check()
        .map_err(|what| SourceFault::bad(what, "export the model again"))?;
    Ok(lens)
}
