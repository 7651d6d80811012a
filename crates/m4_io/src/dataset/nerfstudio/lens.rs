//! The intrinsics of a frame.

use super::json::LensKeys;
use crate::dataset::{Distortion, Lens, SourceErrorCause};
use m4_core::Intrinsics;

const HINT: &str = "correct the intrinsics in the file";

/// The lens of an image of that size.
pub fn of(keys: &LensKeys, (width, height): (usize, usize)) -> Result<Lens, SourceErrorCause> {
    let (w, h) = (width as f64, height as f64);
    for (key, given, found) in [("w", keys.w, w), ("h", keys.h, h)] {
        if let Some(given) = given.filter(|given| (given - found).abs() > 0.5) {
            let what = format!("{key} = {given}, but the image has {found}");
            return Err(SourceErrorCause::bad(
                what,
                "use the images that the cameras were computed from",
            ));
        }
    }
    let from_angle = |key: &str, angle: f64, side: f64| {
        if angle > 0.0 && angle < std::f64::consts::PI {
            return Ok(side / (2.0 * (angle / 2.0).tan()));
        }
        let what = format!("{key} = {angle}; a field of view from 0 to pi radians was expected");
        Err(SourceErrorCause::bad(what, HINT))
    };
    let fx = match (keys.fl_x, keys.camera_angle_x) {
        (Some(fx), _) => fx,
        (None, Some(angle)) => from_angle("camera_angle_x", angle, w)?,
        (None, None) => {
            let what = "fl_x, the focal length in pixels (or camera_angle_x),";
            return Err(SourceErrorCause::missing(what, "add it to the file"));
        }
    };
    let fy = match (keys.fl_y, keys.fl_x, keys.camera_angle_y) {
        (Some(fy), _, _) => fy,
        (None, None, Some(angle)) => from_angle("camera_angle_y", angle, h)?,
        _ => fx,
    };
    for (key, focal) in [("fl_x", fx), ("fl_y", fy)] {
        if !(focal.is_finite() && focal > 0.0) {
            let what = format!("{key} = {focal}; a focal length above 0 pixels was expected");
            return Err(SourceErrorCause::bad(what, HINT));
        }
    }
    let lens = Lens {
        intrinsics: Intrinsics {
            width,
            height,
            fx,
            fy,
            cx: keys.cx.unwrap_or(w / 2.0),
            cy: keys.cy.unwrap_or(h / 2.0),
        },
        distortion: distortion(keys)?,
    };
    let inside = |c: f64, side: f64| c >= -side && c <= 2.0 * side;
    let (cx, cy) = (lens.intrinsics.cx, lens.intrinsics.cy);
    if !(inside(cx, w) && inside(cy, h)) {
        let what = format!("the principal point is ({cx}, {cy}) in an image of {w} x {h} pixels");
        return Err(SourceErrorCause::bad(what, HINT));
    }
    lens.check().map_err(|what| SourceErrorCause::bad(what, HINT))?;
    Ok(lens)
}

fn distortion(keys: &LensKeys) -> Result<Distortion, SourceErrorCause> {
    let value = |key: Option<f64>| key.unwrap_or(0.0);
    let k = [keys.k1, keys.k2, keys.k3, keys.k4].map(value);
    let (p1, p2) = (value(keys.p1), value(keys.p2));
    let model = keys.camera_model.as_deref().unwrap_or("OPENCV");
    let fisheye = keys.is_fisheye == Some(true) || matches!(model, "OPENCV_FISHEYE" | "FISHEYE");
    if fisheye {
        if (p1, p2) != (0.0, 0.0) {
            let what = format!("a fisheye with p1 = {p1}, p2 = {p2}");
            return Err(SourceErrorCause::unsupported(what, "undistort the images"));
        }
        return Ok(Distortion::Fisheye { k });
    }
    match model {
        "SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" | "PERSPECTIVE" => {}
        other => {
            let hint = "PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV and OPENCV_FISHEYE are read; undistort the images";
            return Err(SourceErrorCause::unsupported(
                format!("camera_model is {other:?}"),
                hint,
            ));
        }
    }
    if k[3] != 0.0 {
        let what = format!("k4 = {} of a lens that is not a fisheye", k[3]);
        return Err(SourceErrorCause::unsupported(
            what,
            "undistort the images and set it to 0",
        ));
    }
    Ok(Distortion::brown(k[0], k[1], k[2], p1, p2))
}
