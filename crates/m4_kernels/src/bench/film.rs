//! A rendered sequence of the synthetic room: frames with poses, depth and masks, in the form that training reads.

use super::scene::{FRAMES, camera, cast, colour, drift, is_ball};
use m4_core::{Camera, Capture, CaptureFrame, CompactMask, Plane, Se3, nalgebra::Vector3};
use rayon::prelude::*;

/// The first balls, which are the largest in the image, are static: an eighth of the image moves.
const STILL: usize = 2;
/// How far the camera walks to the side, metres.
const WALK: f64 = 0.8;

/// `frames` images of `width` x `height` pixels with exact depth, masks of the balls that move, and
/// a camera that walks past them.
#[must_use]
pub fn film(frames: usize, width: usize, height: usize) -> Capture {
    let last = (frames.max(2) - 1) as f64;
    let frames: Vec<CaptureFrame> = (0..frames)
        .into_par_iter()
        .map(|i| {
            let share = i as f64 / last;
            let mut camera = camera(width, height);
            camera.c2w = Se3 {
                translation: Vector3::new(WALK * (share - 0.5), 0.05 * (9.0 * share).sin(), 0.0),
                ..Se3::identity()
            };
            frame(camera, i, share * FRAMES as f64)
        })
        .collect();
    Capture { time_frames: frames.len(), frames, duration_s: Some(last / 24.0), metric: true, tracks: None }
}

/// Frame `i`, with the balls where they are at the instant `t`.
fn frame(camera: Camera, i: usize, t: f64) -> CaptureFrame {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let origin = camera.centre();
    let shift = |ball: usize| if ball < STILL { Vector3::zeros() } else { drift(ball, t) };
    let hit = |x: usize, y: usize| {
        let ray = camera.unproject(x as f64, y as f64, 1.0) - origin;
        let (unit, length) = (ray.normalize(), ray.norm());
        let (distance, _, id) = cast(&origin, &unit, shift);
        // balls carry their colours along
        let home = origin + unit * distance - is_ball(id).map_or(Vector3::zeros(), shift);
        let moves = is_ball(id).is_some_and(|ball| ball >= STILL);
        (distance / length, colour(&home, id), moves)
    };
    let hits: Vec<_> = (0..width * height).map(|i| hit(i % width, i / width)).collect();
    let at = |x: usize, y: usize| &hits[y * width + x];
    CaptureFrame {
        name: format!("{i:05}"),
        camera,
        t: i as f64,
        rgb: Plane::from_fn(width, height, |x, y| at(x, y).1.map(|c| (255.0 * c.clamp(0.0, 1.0)).round() as u8)),
        depth: Some(Plane::from_fn(width, height, |x, y| at(x, y).0 as f32).into()),
        mask: Some(CompactMask::from_fn(width, height, |x, y| at(x, y).2)),
        motion: None,
        instances: None,
        camera_index: None,
    }
}

#[cfg(test)]
mod tests {
    use super::film;

    #[test]
    fn the_room_has_walls_and_moving_balls() {
        let capture = film(3, 64, 48);
        assert_eq!((capture.frames.len(), capture.time_frames), (3, 3));
        let share = |i: usize| {
            let mask = capture.frames[i].mask.as_ref().unwrap();
            mask.count() as f64 / (mask.size().0 * mask.size().1) as f64
        };
        assert!((0.05..0.3).contains(&share(1)), "{}", share(1));
        let depth = |i: usize| capture.frames[i].depth.as_ref().unwrap().to_map().into_vec();
        assert!(depth(0).iter().all(|z| (1.0..7.0).contains(z)), "inside the room");
        assert_ne!(depth(0), depth(2));
    }
}
