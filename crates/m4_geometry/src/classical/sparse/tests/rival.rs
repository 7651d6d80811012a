//! A room, and a body before it that moves by itself.

use super::{HEIGHT, ROOM, Scene, WIDTH, errors, features};
use crate::classical::sparse::SparseConfig;
use crate::classical::sparse::reconstruct::from_tracks;
use crate::classical::sparse::tracking::RawTrack;
use m4_core::{CounterRng, Se3, Silent, exp_so3, nalgebra::Vector3};

/// Tracks of a room and of a rigid body before it with `body` points, which sways; it covers the
/// rectangle of the image about `centre`, `half` to each side, pixels from the image's centre.
fn room_behind(body: usize, centre: [f64; 2], half: [f64; 2]) -> Vec<RawTrack> {
    let scene = Scene {
        moving: 0.0,
        ..ROOM
    };
    let hidden = |at: &[f64; 2]| (0..2).all(|k| (at[k] - centre[k]).abs() < half[k]);
    // What the body hides of the room ends there.
    let mut tracks: Vec<RawTrack> = scene.tracks().0;
    for track in &mut tracks {
        let seen = track.seen.iter().take_while(|at| !hidden(at)).count();
        track.seen.truncate(seen);
    }
    let mut rng = CounterRng::new(22, 0, 0);
    for _ in 0..body {
        let birth = rng.below(scene.frames + 12).saturating_sub(12);
        let life = 6 + rng.below(scene.frames);
        let depth = 2.0 + rng.uniform();
        let pixel = [0, 1].map(|k| centre[k] + half[k] * (2.0 * rng.uniform() - 1.0));
        let ray = Vector3::new(pixel[0] / scene.focal, pixel[1] / scene.focal, 1.0);
        // It keeps its place before the camera, but sways and turns by itself.
        let body = |frame: usize| {
            let t = frame as f64;
            Se3 {
                rotation: exp_so3(&Vector3::new(0.0, 0.012 * t, 0.1 * (0.2 * t).sin())),
                translation: Vector3::new(0.2 * (0.15 * t).sin(), 0.1 * (0.3 * t).sin(), 2.5),
            }
        };
        let local = body(birth).inverse().transform(&(ray * depth));
        let mut track = RawTrack {
            first: birth,
            seen: Vec::new(),
            again: Vec::new(),
        };
        for frame in birth..(birth + life).min(scene.frames) {
            let p = body(frame).transform(&local);
            let q = [scene.focal * p.x / p.z, scene.focal * p.y / p.z];
            if p.z < 0.5 || q[0].abs() > WIDTH as f64 / 2.0 || q[1].abs() > HEIGHT as f64 / 2.0 {
                break;
            }
            track
                .seen
                .push(q.map(|v| v + scene.noise_px * rng.normal()));
        }
        tracks.push(track);
    }
    tracks.retain(|track| track.seen.len() >= 2);
    tracks
}

#[test]
fn a_body_that_fills_the_image_is_not_taken_for_the_room() {
    for body in [300, 600, 900] {
        let half = [0.3 * WIDTH as f64, 0.3 * HEIGHT as f64];
        let features = features(room_behind(body, [0.0; 2], half), ROOM.frames);
        let config = SparseConfig::default();
        let recovered = from_tracks(features, None, &config, &Silent).expect("a reconstruction");
        let (error, turn) = errors(&recovered.sparse, &ROOM);
        assert!(error < 0.002 && turn < 0.002, "{body}: {error} {turn}");
        assert!(!recovered.tied);
    }
}

#[test]
fn two_halves_that_move_against_each_other_tie() {
    let quarter = 0.25 * WIDTH as f64;
    let tracks = room_behind(250, [quarter, 0.0], [quarter, HEIGHT as f64]);
    let features = features(tracks, ROOM.frames);
    let config = SparseConfig::default();
    let recovered = from_tracks(features, None, &config, &Silent).expect("a reconstruction");
    assert!(recovered.tied);
    let warnings = recovered.sparse.warnings.join("; ");
    assert!(
        warnings.contains("either may be the static one"),
        "{warnings}"
    );
}
