//! The training cameras of a scene file.

use super::tensor::{Arrays, Source, Sources, f32_array, f64_array};
use crate::Fault;
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{Camera, Exposure, Intrinsics, Se3, SourceFrame, StateTensor};

/// Deviations of distances, 0 where there is none; the array is absent where no frame has one.
const SIGMA: &str = "source.distance_sigma";

/// The arrays of the training cameras.
pub fn source_to_arrays(source: &[SourceFrame], arrays: &mut Sources<'_>) {
    let n = source.len();
    let lens = |f: &SourceFrame| {
        let k = f.camera.intrinsics;
        [k.width as f64, k.height as f64, k.fx, k.fy, k.cx, k.cy]
    };
    let pose = |f: &SourceFrame| -> [f64; 12] {
        let Se3 {
            rotation,
            translation,
        } = f.camera.c2w;
        std::array::from_fn(|i| {
            if i % 4 == 3 {
                translation[i / 4]
            } else {
                rotation[(i / 4, i % 4)]
            }
        })
    };
    let exposure = |f: &SourceFrame| -> [f32; 12] {
        let Exposure { matrix, offset } = f.exposure;
        std::array::from_fn(|i| {
            if i % 4 == 3 {
                offset[i / 4]
            } else {
                matrix[i / 4][i % 4]
            }
        })
    };
    let f64s = |shape: Vec<usize>, data: Vec<f64>| {
        let data = data.into();
        Source::Array(StateTensor::F64 { shape, data })
    };
    arrays.insert(
        "source.intrinsics".into(),
        f64s(vec![n, 6], source.iter().flat_map(lens).collect()),
    );
    arrays.insert(
        "source.c2w".into(),
        f64s(vec![n, 3, 4], source.iter().flat_map(pose).collect()),
    );
    arrays.insert(
        "source.t".into(),
        f64s(vec![n], source.iter().map(|f| f.t).collect()),
    );
    let data = source.iter().flat_map(exposure).collect();
    arrays.insert(
        "source.exposure".into(),
        Source::Array(StateTensor::F32 {
            shape: vec![n, 3, 4],
            data,
        }),
    );
    if source.iter().any(|f| f.distance_sigma.is_some()) {
        let sigma = |f: &SourceFrame| f.distance_sigma.unwrap_or(0.0);
        let data = source.iter().map(sigma).collect();
        let shape = vec![n];
        arrays.insert(
            SIGMA.into(),
            Source::Array(StateTensor::F32 { shape, data }),
        );
    }
}

/// The training cameras of arrays.
pub fn arrays_to_source(arrays: &Arrays) -> Result<Vec<SourceFrame>, Fault> {
    let n = arrays.get("source.t").map_or(0, StateTensor::len);
    let t = f64_array(arrays, "source.t", &[n])?;
    let lens = f64_array(arrays, "source.intrinsics", &[n, 6])?
        .as_chunks::<6>()
        .0;
    let pose = f64_array(arrays, "source.c2w", &[n, 3, 4])?
        .as_chunks::<12>()
        .0;
    let exposure = f32_array(arrays, "source.exposure", &[n, 3, 4])?
        .as_chunks::<12>()
        .0;
    let sigma = match arrays.contains_key(SIGMA) {
        true => f32_array(arrays, SIGMA, &[n])?,
        false => &[],
    };
    let frame = |i: usize| {
        let [width, height, fx, fy, cx, cy] = lens[i];
        let (p, e) = (&pose[i], &exposure[i]);
        SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics {
                    // A cast from float saturates.
                    width: width as usize,
                    height: height as usize,
                    fx,
                    fy,
                    cx,
                    cy,
                },
                c2w: Se3 {
                    rotation: Matrix3::from_fn(|r, c| p[4 * r + c]),
                    translation: Vector3::from_fn(|r, _| p[4 * r + 3]),
                },
            },
            t: t[i],
            exposure: Exposure {
                matrix: std::array::from_fn(|r| std::array::from_fn(|c| e[4 * r + c])),
                offset: std::array::from_fn(|r| e[4 * r + 3]),
            },
            distance_sigma: sigma.get(i).copied().filter(|&s| s != 0.0),
        }
    };
    Ok((0..n).map(frame).collect())
}
