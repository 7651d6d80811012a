//! Checks that the data returned by a reader are valid.

use m4_core::{Camera, Capture, CaptureFrame, CompactDepth, DepthMap, Scene, Splats, Tracks, Video};
use m4_io::trajectory::{KeyPose, Trajectory};

/// More frames than any clip has: what goes through them would not end.
const MAX_FRAMES: usize = 1_000_000;

pub fn splats(splats: &Splats) -> Option<String> {
    (!splats.is_finite()).then(|| "a splat is not finite".into())
}

pub fn scene(scene: &Scene) -> Option<String> {
    if let Some(fault) = splats(&scene.splats) {
        return Some(fault);
    }
    let faults = [
        (scene.near.is_finite(), "near"),
        (scene.background.iter().all(|v| v.is_finite()), "the background"),
        ((1..=MAX_FRAMES).contains(&scene.time_frames), "the number of frames"),
        (scene.duration_s.is_none_or(f64::is_finite), "the duration"),
        (scene.source.iter().all(|f| f.t.is_finite()), "a time"),
    ];
    if let Some((_, what)) = faults.into_iter().find(|(valid, _)| !valid) {
        return Some(what.into());
    }
    let exposures = scene.source.iter().map(|f| f.exposure);
    let numbers = exposures.flat_map(|e| e.matrix.into_iter().flatten().chain(e.offset).collect::<Vec<_>>());
    if !numbers.into_iter().all(f32::is_finite) {
        return Some("an exposure".into());
    }
    scene.source.iter().find_map(|f| camera(&f.camera))
}

pub fn camera(camera: &Camera) -> Option<String> {
    let k = &camera.intrinsics;
    let c2w = camera.c2w.matrix();
    let lens = k.fx > 0.0 && k.fy > 0.0 && [k.fx, k.fy, k.cx, k.cy].iter().all(|v| v.is_finite());
    let rigid = c2w.iter().all(|v| v.is_finite()) && (c2w.determinant() - 1.0).abs() < 1e-2;
    [(lens, "a lens"), (rigid, "a pose")]
        .into_iter()
        .find_map(|(valid, what)| (!valid).then(|| format!("{what}: {camera:?}")))
}

pub fn tracks(tracks: &Tracks) -> Option<String> {
    let valid = tracks.xyz().as_flattened().iter().all(|v| !v.is_infinite());
    (!valid).then(|| "tracks".into())
}

pub fn depth(depth: &CompactDepth) -> Option<String> {
    (!depth.every(1).all(|z| z.is_finite() && z >= 0.0)).then(|| "depth".into())
}

pub fn map(map: &DepthMap) -> Option<String> {
    (!map.data().iter().all(|z| z.is_finite() && *z >= 0.0)).then(|| "depth".into())
}

fn frame(frame: &CaptureFrame, last: f64) -> Option<String> {
    let k = &frame.camera.intrinsics;
    if frame.rgb.size() != (k.width, k.height) {
        return Some("the size of an image".into());
    }
    if !(0.0..=last).contains(&frame.t) {
        return Some(format!("a time: {}", frame.t));
    }
    camera(&frame.camera).or_else(|| frame.depth.as_ref().and_then(depth))
}

pub fn capture(capture: &Capture) -> Option<String> {
    if capture.frames.is_empty() || !capture.duration_s.is_none_or(f64::is_finite) {
        return Some("no frames, or their duration".into());
    }
    let of_tracks = capture.tracks.as_ref().and_then(|t| {
        let fits = t.frames() == capture.frames.len();
        if fits { tracks(t) } else { Some("the length of tracks".into()) }
    });
    let last = capture.time_frames as f64 - 1.0;
    of_tracks.or_else(|| capture.frames.iter().find_map(|f| frame(f, last)))
}

pub fn video(video: &Video) -> Option<String> {
    if !video.frames.iter().all(|f| f.time_s.is_finite()) {
        return Some("a time".into());
    }
    let size = video.frames.first().map(|f| f.rgb.size());
    let same = video.frames.iter().all(|f| Some(f.rgb.size()) == size);
    (!same).then(|| "images of several sizes".into())
}

pub fn trajectory(path: &Trajectory) -> Option<String> {
    match path {
        Trajectory::Listed(listed) => {
            if !listed.iter().all(|(_, t)| t.is_finite()) {
                return Some("a time".into());
            }
            listed.iter().find_map(|(c, _)| camera(c))
        }
        Trajectory::Keyed(keyed) => {
            let times = keyed.keyframes.iter().map(|k| k.time_s).chain(keyed.back_s).chain(keyed.fps);
            if keyed.keyframes.is_empty() || !times.into_iter().all(f64::is_finite) {
                return Some("a time, or no keyframes".into());
            }
            let valid = keyed.keyframes.iter().all(|k| match &k.pose {
                KeyPose::C2w(c2w) => c2w.matrix().iter().all(|v| v.is_finite()),
                KeyPose::LookAt { position, look_at, up } => {
                    let up = up.unwrap_or_default();
                    position.iter().chain(look_at.iter()).chain(up.iter()).all(|v| v.is_finite())
                }
            });
            (!valid).then(|| "a pose".into())
        }
    }
}
