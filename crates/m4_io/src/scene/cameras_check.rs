//! Checks that cameras of files can produce an image.

use m4_core::SourceFrame;

/// Longest side of an image, pixels, and farthest position, world units, of a valid camera.
const MAX_SIDE_PX: usize = 16_384;
const MAX_PLACE: f64 = 1e12;

/// True for a camera that an image can be made with, at a moment that is a number.
pub(crate) fn usable(frame: &SourceFrame) -> bool {
    let k = &frame.camera.intrinsics;
    let side = |px: usize| (1..=MAX_SIDE_PX).contains(&px);
    let focal = |px: f64| px.is_finite() && (1e-3..=1e9).contains(&px);
    let centre = |px: f64| px.is_finite() && px.abs() < 1e9;
    let rotation = &frame.camera.c2w.rotation;
    let turned = rotation * rotation.transpose();
    let orthonormal = turned
        .iter()
        .enumerate()
        .all(|(i, &v)| (v - f64::from(u8::from(i % 4 == 0))).abs() < 1e-3);
    side(k.width)
        && side(k.height)
        && focal(k.fx)
        && focal(k.fy)
        && centre(k.cx)
        && centre(k.cy)
        && frame.t.is_finite()
        && frame.camera.c2w.translation.iter().all(|v| v.abs() < MAX_PLACE)
        && orthonormal
        && rotation.determinant() > 0.0
}
