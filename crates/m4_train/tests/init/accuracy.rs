//! Motion errors against tracks that are true, and against tracks that are not.

use m4_core::{Capture, CaptureFrame, CompactMask, ShapeError, Silent, Tracks, nalgebra::Vector3};
use m4_testkit::BoxScene;
use m4_train::init::{InitConfig, InitError, MotionErrors, motion_errors};

const FRAMES: usize = 24;

fn capture(scene: &BoxScene) -> Capture {
    let frame = |t: usize| {
        let mask = scene.mask(t);
        let (w, h) = mask.size();
        CaptureFrame {
            name: format!("{t}"),
            camera: scene.cameras[t],
            t: t as f64,
            rgb: scene.rgb(t),
            depth: Some(scene.depth(t).into()),
            mask: Some(CompactMask::from_fn(w, h, |x, y| mask[(x, y)] > 0)),
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        }
    };
    let duration_s = Some((FRAMES - 1) as f64 / 24.0);
    Capture {
        frames: (0..FRAMES).map(frame).collect(),
        time_frames: FRAMES,
        duration_s,
        metric: true,
        tracks: None,
    }
}

/// Points that frames show of the boxes; off by `drift` along x, world units per frame.
fn tracks(scene: &BoxScene, drift: f64) -> Result<Tracks, ShapeError> {
    let (w, h) = scene.mask(0).size();
    let pixels = (0..w * h)
        .filter(|i| i % 5 == 0 && (i / w) % 5 == 0)
        .map(|i| (i % w, i / w));
    let points: Vec<(usize, Vector3<f64>)> = [0, FRAMES / 2, FRAMES - 1]
        .into_iter()
        .flat_map(|t| pixels.clone().map(move |(x, y)| scene.hit(t, x, y)))
        .filter(|hit| BoxScene::moves(hit.body))
        .map(|hit| (hit.body, hit.local))
        .collect();
    let all =
        || (0..FRAMES).flat_map(|t| points.iter().map(move |(body, local)| (t, *body, local)));
    let place = |(t, body, local): (usize, usize, &Vector3<f64>)| {
        let p = scene.place(body, local, t);
        [(p.x + drift * t as f64) as f32, p.y as f32, p.z as f32]
    };
    let visible = all()
        .map(|(t, body, local)| scene.sees(body, local, t))
        .collect();
    Tracks::new(FRAMES, points.len(), all().map(place).collect(), visible)
}

fn errors(capture: &Capture, tracks: &Tracks) -> Result<MotionErrors, InitError> {
    motion_errors(capture, tracks, &InitConfig::fast(), &Silent)
}

#[test]
fn motion_of_boxes_is_right_and_wrong_tracks_contradict_it() {
    let scene = BoxScene::new(160, 120, FRAMES);
    let capture = capture(&scene);
    let right = errors(&capture, &tracks(&scene, 0.0).unwrap()).unwrap();
    println!("{right:?}");
    let after = |errors: &MotionErrors, k: usize| {
        (
            errors.carried[k].after,
            errors.carried[k].median_px.unwrap(),
        )
    };
    assert!(right.carried.iter().all(|row| row.count > 300));
    assert!(
        after(&right, 0).1 < 1.0 && after(&right, 1).1 < 1.5,
        "{right:?}"
    );
    assert!(
        right
            .carried
            .iter()
            .all(|row| row.within_sigma.unwrap() > 0.5),
        "{right:?}"
    );
    assert!(right.points > 4000 && right.without_node < 0.1, "{right:?}");
    let lives = right.lives;
    assert!(
        (lives.on_time + lives.late + lives.early - 1.0).abs() < 1e-5 && lives.count > 1000,
        "{lives:?}"
    );
    assert!(lives.on_time > 0.5 && lives.late < 0.1, "{lives:?}");

    // 0.02 units are a pixel of the 160 at depth 3.2, and three of 480
    let wrong = errors(&capture, &tracks(&scene, 0.01).unwrap()).unwrap();
    println!("{wrong:?}");
    let (frames, off) = after(&wrong, 0);
    assert!((off / frames as f32 - 1.5).abs() < 0.4, "{wrong:?}");
    assert!(
        wrong.lives.late > 0.5 && wrong.carried[0].within_sigma.unwrap() < 0.3,
        "{wrong:?}"
    );
}

#[test]
fn tracks_of_another_clip_and_clips_without_content_are_no_errors_of_motion() {
    let scene = BoxScene::new(48, 36, FRAMES);
    let mut capture = capture(&scene);
    let other = Tracks::new(2, 1, vec![[0.0; 3]; 2], vec![true; 2]).unwrap();
    assert!(matches!(
        errors(&capture, &other),
        Err(InitError::Tracks {
            frames: FRAMES,
            tracks: 2
        })
    ));
    let own = tracks(&scene, 0.0).unwrap();
    // a frame a second: none is five frames at 24 a second away
    let slow = Capture {
        duration_s: Some((FRAMES - 1) as f64),
        ..capture.clone()
    };
    let slow = errors(&slow, &own).unwrap();
    assert!(
        slow.points > 0 && slow.carried.iter().all(|row| row.count == 0),
        "{slow:?}"
    );
    capture
        .frames
        .iter_mut()
        .for_each(|frame| frame.mask = None);
    let none = errors(&capture, &own).unwrap();
    assert!(
        none.lives.count == 0 && none.carried.iter().all(|row| row.median_px.is_none()),
        "{none:?}"
    );
}
