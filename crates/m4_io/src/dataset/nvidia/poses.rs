//! `poses_bounds.npy`.

use crate::dataset::files::npy::NpyFile;
use crate::dataset::files::pose;
use crate::dataset::{ReadSourceError, SourceFault};
use m4_core::{Intrinsics, Se3};
use std::path::Path;

/// Numbers a camera.
const WIDTH: usize = 17;
/// Largest array: a hundred thousand cameras.
const MAX_BYTES: u64 = 16 << 20;
const REMEDY: &str = "make poses_bounds.npy again";

pub(super) struct Pose {
    pub c2w: Se3<f64>,
    /// Of images of the full size.
    pub intrinsics: Intrinsics,
    /// Depth in view, scene units.
    pub near: f64,
    pub far: f64,
}

/// One per camera, at least one.
pub(super) fn read(path: &Path) -> Result<Vec<Pose>, ReadSourceError> {
    let array = NpyFile::read(path, MAX_BYTES).map_err(|fault| fault.at(path))?;
    match array.shape[..] {
        [n, WIDTH] if n > 0 => {}
        _ => {
            let what = format!("an array of shape {:?}; [cameras, 17] was expected", array.shape);
            return Err(SourceFault::bad(what, REMEDY).at(path));
        }
    }
    let rows = array.values.as_chunks::<WIDTH>().0.iter().enumerate();
    rows.map(|(i, row)| camera(row).map_err(|fault| fault.within(path, format!("camera {i}"))))
        .collect()
}

fn camera(row: &[f64; WIDTH]) -> Result<Pose, SourceFault> {
    let bad = |what: String| Err(SourceFault::bad(what, REMEDY));
    let m = |i: usize, j: usize| row[5 * i + j];
    // down, right, back -> right, down, forward
    let turned = [0, 1, 2].map(|i| [m(i, 1), m(i, 0), -m(i, 2)]);
    let c2w = pose::of_rotation(turned, [0, 1, 2].map(|i| m(i, 3)))?;
    let [height, width, focal] = [0, 1, 2].map(|i| m(i, 4));
    let side = |v: f64| (v.fract() == 0.0 && (1.0..=65536.0).contains(&v)).then_some(v as usize);
    let (Some(w), Some(h)) = (side(width), side(height)) else {
        return bad(format!("images of {width} x {height} pixels"));
    };
    if !(focal.is_finite() && focal > 0.0) {
        return bad(format!("the focal length {focal}; pixels, above 0, were expected"));
    }
    let (near, far) = (row[15], row[16]);
    if !(near > 0.0 && far > near && far.is_finite()) {
        return bad(format!("depth from {near} to {far}; 0 < near < far was expected"));
    }
    Ok(Pose {
        c2w,
        intrinsics: Intrinsics::centred(w, h, focal),
        near,
        far,
    })
}
