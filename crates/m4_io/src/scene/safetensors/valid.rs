//! Checks that the numbers of a scene are valid.

use m4_core::{Scene, SourceFrame, nalgebra::Matrix3};

/// Longest side of an image of the source, pixels.
const MAX_SIDE_PX: usize = 1 << 16;
/// Farthest that the product of a rotation and its transpose may be from the identity.
const ROTATION_WITHIN: f64 = 1e-2;
/// Most frames of a clip: nine hours at 30 frames per second. What goes through them frame by frame has to end.
const MAX_FRAMES: usize = 1_000_000;

/// The first NaN, infinite or impossible value of a scene; `None` if it is valid.
pub fn cause(scene: &Scene) -> Option<String> {
    if !scene.splats.is_finite() {
        return Some("a parameter of a splat is not a finite number".into());
    }
    if !scene.background.iter().chain([&scene.near]).all(|v| v.is_finite()) {
        let (background, near) = (scene.background, scene.near);
        return Some(format!("background {background:?} or near {near} is not a number"));
    }
    if let Some(s) = scene.duration_s.filter(|s| !s.is_finite()) {
        return Some(format!("the duration is {s} s"));
    }
    if scene.time_frames > MAX_FRAMES {
        let n = scene.time_frames;
        return Some(format!("the clip has {n} frames; at most {MAX_FRAMES} were expected"));
    }
    let of_frame =
        |(i, frame): (usize, &SourceFrame)| Some(format!("frame {i} of the source has {}", of_source(frame)?));
    scene.source.iter().enumerate().find_map(of_frame)
}

fn of_source(frame: &SourceFrame) -> Option<String> {
    let k = &frame.camera.intrinsics;
    let sides = [k.width, k.height];
    if !sides.iter().all(|side| (1..=MAX_SIDE_PX).contains(side)) {
        return Some(format!("images of {} x {} pixels", k.width, k.height));
    }
    let lens = [k.fx, k.fy, k.cx, k.cy];
    if !(lens.iter().all(|v| v.is_finite()) && k.fx > 0.0 && k.fy > 0.0) {
        return Some(format!("the intrinsics {lens:?} (fx, fy, cx, cy)"));
    }
    let c2w = &frame.camera.c2w;
    if !c2w.translation.iter().all(|v| v.is_finite()) {
        return Some("a place that is not of numbers".into());
    }
    let turned = c2w.rotation.transpose() * c2w.rotation - Matrix3::identity();
    // a comparison that NaN fails
    if !turned.iter().all(|v| v.abs() < ROTATION_WITHIN) || c2w.rotation.determinant() < 0.0 {
        return Some("a pose that is not a rotation".into());
    }
    if !frame.t.is_finite() {
        return Some(format!("the time {}", frame.t));
    }
    let exposure = &frame.exposure;
    let numbers = exposure.matrix.as_flattened().iter().chain(&exposure.offset);
    (!numbers.copied().all(f32::is_finite)).then(|| "an exposure that is not of numbers".into())
}
