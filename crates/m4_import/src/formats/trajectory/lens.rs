//! The lens of a trajectory that brings none.

use crate::core::{Distortion, ImportOptions, Lens, ReadSourceError, SourceFault};
use crate::files::lens::{of_matrix, pinhole};
use crate::files::{table, text};
use m4_math::nalgebra::{Matrix3, Vector3};
use m4_scene::Intrinsics;
use std::path::Path;

/// Half a pixel: from the centre of the first pixel to the image's corner.
const CORNER: f64 = 0.5;

/// The lens of `intrinsics.txt` in `folder`, or of the options, for pictures of that size; `None` if neither is there.
pub fn given(folder: &Path, size: (usize, usize), options: &ImportOptions) -> Result<Option<Lens>, ReadSourceError> {
    if let Some(focal_px) = options.focal_px {
        let lens = Lens::pinhole(Intrinsics::centred(size.0, size.1, focal_px));
        return match lens.check() {
            Ok(()) => Ok(Some(lens)),
            Err(what) => Err(SourceFault::bad(what, "correct the option focal_px").at(folder)),
        };
    }
    let file = folder.join("intrinsics.txt");
    if !file.is_file() {
        return Ok(None);
    }
    let rows = table::read(
        &file,
        |n| matches!(n, 3 | 4 | 8 | 9),
        "fx fy cx cy (and k1 k2 p1 p2, k3), or 9 numbers of a matrix,",
    )?;
    let numbers: Vec<f64> = rows.iter().flat_map(|row| row.values.iter().copied()).collect();
    let lens = match *numbers.as_slice() {
        [fx, fy, cx, cy] => Lens::pinhole(pinhole([fx, fy, cx, cy], size)),
        [_, _, _, _, _, _, 0.0, 0.0, 1.0] => Lens::pinhole(of_matrix(&numbers, size).map_err(|fault| fault.at(&file))?),
        [fx, fy, cx, cy, k1, k2, p1, p2, ref k3 @ ..] if k3.len() <= 1 => Lens {
            intrinsics: pinhole([fx, fy, cx, cy], size),
            distortion: Distortion::brown(k1, k2, k3.first().copied().unwrap_or(0.0), p1, p2),
        },
        _ => {
            let what = format!("it has {} numbers", numbers.len());
            let remedy = "write fx fy cx cy, or these with k1 k2 p1 p2 (k3), or the 9 numbers of a matrix";
            return Err(SourceFault::bad(what, remedy).at(&file));
        }
    };
    lens.check()
        .map_err(|what| SourceFault::bad(what, "correct the file").at(&file))?;
    Ok(Some(lens))
}

/// What to do where no lens is given.
pub fn missing(file: &Path, also: &str) -> ReadSourceError {
    let remedy = format!("write fx fy cx cy, pixels, to intrinsics.txt beside the trajectory{also}, or give focal_px");
    SourceFault::missing("the lens", remedy).at(file)
}

/// A camera of KITTI.
#[derive(Debug)]
pub struct Projection {
    pub intrinsics: Intrinsics,
    /// Place of camera 0 seen from this camera, metres.
    pub offset_m: Vector3<f64>,
}

/// `P{camera}` of `calib.txt` for pictures of that size.
pub fn kitti(file: &Path, camera: usize, size: (usize, usize)) -> Result<Projection, ReadSourceError> {
    let key = format!("P{camera}");
    let at = |fault: SourceFault| fault.within(file, key.clone());
    let text = text(file)?;
    let line = text.lines().find_map(|line| {
        let (name, numbers) = line.split_once([':', ' '])?;
        (name.trim() == key || name.trim() == format!("P_rect_0{camera}")).then_some(numbers)
    });
    let line = line.ok_or_else(|| at(SourceFault::missing("the line", "give the calib.txt of this sequence")))?;
    let words = table::words(line).filter(|word| *word != ":");
    let numbers: Result<Vec<f64>, _> = words.map(str::parse).collect();
    let numbers = numbers
        .ok()
        .filter(|p| p.len() == 12 && p.iter().all(|v| v.is_finite()));
    let p = numbers.ok_or_else(|| {
        at(SourceFault::bad(
            format!("{line:?} are no 12 numbers"),
            "give the calib.txt of this sequence",
        ))
    })?;
    let k: Vec<f64> = (0..9).map(|i| p[4 * (i / 3) + i % 3]).collect();
    let mut intrinsics = of_matrix(&k, size).map_err(at)?;
    let matrix = Matrix3::from_row_slice(&k);
    let inverse = matrix.try_inverse();
    let inverse = inverse.ok_or_else(|| {
        at(SourceFault::bad(
            "it has no inverse",
            "give the calib.txt of this sequence",
        ))
    })?;
    intrinsics.cx += CORNER;
    intrinsics.cy += CORNER;
    Ok(Projection {
        intrinsics,
        offset_m: inverse * Vector3::new(p[3], p[7], p[11]),
    })
}
