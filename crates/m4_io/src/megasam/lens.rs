//! Intrinsics in MegaSaM's files: the principal point is measured from the image's corner (see [the module](super)).

use super::MegasamFault;
use m4_core::Intrinsics;

/// The pinhole of `[fx, fy, cx, cy]`, pixels of an image of `size`.
pub(super) fn of_numbers(
    array: &'static str,
    frame: usize,
    [fx, fy, cx, cy]: [f64; 4],
    (width, height): (usize, usize),
) -> Result<Intrinsics, MegasamFault> {
    let bad = |what: String| MegasamFault::Value { array, frame, what };
    for (name, focal) in [("fx", fx), ("fy", fy)] {
        if !(focal.is_finite() && focal > 0.0) {
            return Err(bad(format!(
                "{name} = {focal}; a focal length above 0 pixels was expected"
            )));
        }
    }
    for (name, c, side) in [("cx", cx, width as f64), ("cy", cy, height as f64)] {
        if !(c >= -side && c <= 2.0 * side) {
            let what = format!("{name} = {c}; the principal point of an image {side} pixels long was expected");
            return Err(bad(what));
        }
    }
    Ok(Intrinsics {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    })
}

/// The pinhole of a matrix `[3][3]`.
pub(super) fn of_matrix(k: &[f64], size: (usize, usize)) -> Result<Intrinsics, MegasamFault> {
    const ARRAY: &str = "intrinsic";
    let zeros = [k[1], k[3], k[6], k[7]];
    let largest = k[0].abs();
    if k[8] != 1.0 || zeros.iter().any(|v| v.is_nan() || v.abs() > 1e-6 * largest) {
        return Err(MegasamFault::Value {
            array: ARRAY,
            frame: 0,
            what: format!("{k:?}; [fx, 0, cx, 0, fy, cy, 0, 0, 1] was expected (is it transposed?)"),
        });
    }
    of_numbers(ARRAY, 0, [k[0], k[4], k[2], k[5]], size)
}
