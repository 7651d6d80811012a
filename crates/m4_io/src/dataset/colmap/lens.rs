//! COLMAP's camera models.

use crate::Fault;
use crate::dataset::colmap::ColmapCamera;
use crate::dataset::{Distortion, Lens};
use m4_core::Intrinsics;

/// Longest side of an image, pixels.
const MAX_SIDE: u64 = 1 << 16;

/// The lens of a camera.
pub(super) fn of(camera: &ColmapCamera) -> Result<Lens, Fault> {
    let fisheye = |k: [f64; 4]| Distortion::Fisheye { k };
    let radial = |k1, k2| Distortion::brown(k1, k2, 0.0, 0.0, 0.0);
    let ([fx, fy, cx, cy], distortion) = match (camera.model.as_str(), camera.parameters.as_slice()) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f, cx, cy], Distortion::None),
        ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy, cx, cy], Distortion::None),
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => ([f, f, cx, cy], radial(k, 0.0)),
        ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f, cx, cy], radial(k1, k2)),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => ([fx, fy, cx, cy], Distortion::brown(k1, k2, 0.0, p1, p2)),
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            let full = Distortion::Brown { radial: [k1, k2, k3, k4, k5, k6], tangential: [p1, p2] };
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
            let hint = "models of pinholes, RADIAL, OPENCV and their fisheyes are read; undistort the images \
                          (`colmap image_undistorter`)";
            return Err(Fault::unsupported(what, hint));
        }
    };
    let side = |px: u64| (1..=MAX_SIDE).contains(&px);
    if !(side(camera.width) && side(camera.height)) {
        let what = format!("its images are {} x {} pixels", camera.width, camera.height);
        return Err(Fault::bad(what, "export the model again"));
    }
    let lens = Lens {
        intrinsics: Intrinsics { width: camera.width as usize, height: camera.height as usize, fx, fy, cx, cy },
        distortion,
    };
    lens.check()?;
    Ok(lens)
}

#[cfg(test)]
mod tests {
    use super::of;
    use crate::dataset::Distortion;
    use crate::dataset::colmap::ColmapCamera;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct Fixture {
        points: Vec<[f64; 2]>,
        models: Vec<Case>,
        opencv: Vec<[f64; 2]>,
        opencv_fisheye: Vec<[f64; 2]>,
    }

    #[derive(Deserialize)]
    struct Case {
        model: String,
        parameters: Vec<f64>,
        pixels: Vec<[f64; 2]>,
    }

    #[test]
    fn lens_models_match_pycolmap_and_opencv() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/import/clip/lenses.json");
        let fixture: Fixture = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        assert_eq!(fixture.models.len(), 11);
        for case in &fixture.models {
            let camera = ColmapCamera {
                id: 1,
                model: case.model.clone(),
                width: 48,
                height: 36,
                parameters: case.parameters.clone(),
            };
            let lens = of(&camera).unwrap();
            let pinhole = ["SIMPLE_PINHOLE", "PINHOLE"].contains(&case.model.as_str());
            assert_eq!(lens.distortion == Distortion::None, pinhole, "{}", case.model);
            let by_opencv = match case.model.as_str() {
                "OPENCV" => Some(&fixture.opencv),
                "OPENCV_FISHEYE" => Some(&fixture.opencv_fisheye),
                _ => None,
            };
            assert_eq!(case.pixels.len(), fixture.points.len());
            for pixels in [Some(&case.pixels), by_opencv].into_iter().flatten() {
                for ([x, y], [u, v]) in fixture.points.iter().zip(pixels) {
                    let [a, b] = lens.distortion.distorted(*x, *y);
                    let k = lens.intrinsics;
                    let off = (k.fx * a + k.cx - u).abs().max((k.fy * b + k.cy - v).abs());
                    assert!(off < 1e-9, "{} at ({x}, {y}): {off:e}", case.model);
                }
            }
        }
    }

    #[test]
    fn other_models_and_sizes_are_refused() {
        let camera = |model: &str, width, parameters: &[f64]| ColmapCamera {
            id: 1,
            model: model.into(),
            width,
            height: 36,
            parameters: parameters.to_vec(),
        };
        let refused = |c: &ColmapCamera| of(c).unwrap_err().to_string();
        assert!(refused(&camera("FOV", 48, &[50.0, 50.0, 24.0, 18.0, 0.9])).contains("FOV"));
        assert!(refused(&camera("PINHOLE", 48, &[50.0, 24.0, 18.0])).contains("3 parameters"));
        assert!(refused(&camera("PINHOLE", 1 << 40, &[50.0, 50.0, 24.0, 18.0])).contains("1099511627776 x 36"));
        assert!(refused(&camera("PINHOLE", 48, &[50.0, f64::NAN, 24.0, 18.0])).contains("NaN"));
    }
}
