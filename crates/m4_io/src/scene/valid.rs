//! Checks the numbers of a scene.

use crate::range;
use m4_core::nalgebra::Matrix3;
use m4_core::{Scene, SourceFrame};

/// Farthest that the product of a rotation and its transpose may be from the identity.
const ROTATION_WITHIN: f64 = 1e-2;

/// The first value of a scene that is out of its range; `None` if it is valid.
pub(crate) fn fault(scene: &Scene) -> Option<String> {
    if let Some(what) = range::of_splats(&scene.splats).or_else(|| of_facts(scene)) {
        return Some(what);
    }
    let of_frame = |(i, frame): (usize, &SourceFrame)| {
        Some(format!("frame {i} of the source has {}", of_source(frame)?))
    };
    scene.source.iter().enumerate().find_map(of_frame)
}

fn of_facts(scene: &Scene) -> Option<String> {
    let near = f64::from(scene.near);
    let colours = scene
        .background
        .map(|v| ("the background", f64::from(v), range::COLOUR, ""));
    let duration = scene
        .duration_s
        .map(|s| ("the duration", s, 0.0..=*range::SECONDS.end(), "seconds"));
    let mut all = colours
        .into_iter()
        .chain([("near", near, range::NEAR, "scene units")])
        .chain(duration);
    let fault =
        all.find_map(|(field, value, range, unit)| range::of_number(field, value, &range, unit));
    if fault.is_some() {
        return fault;
    }
    let n = scene.time_frames;
    let most = range::FRAMES.end();
    (n > *most).then(|| format!("the clip has {n} frames; at most {most} were expected"))
}

fn of_source(frame: &SourceFrame) -> Option<String> {
    if let Some(what) = range::of_lens(&frame.camera.intrinsics) {
        return Some(what);
    }
    let c2w = &frame.camera.c2w;
    if let Some(what) = range::of_place("a pose whose translation", &c2w.translation) {
        return Some(what);
    }
    let turned = c2w.rotation.transpose() * c2w.rotation - Matrix3::identity();
    // a comparison that NaN fails
    if !turned.iter().all(|v| v.abs() < ROTATION_WITHIN) || c2w.rotation.determinant() < 0.0 {
        return Some("a pose that is not a rotation".into());
    }
    range::of_source(frame)
}
