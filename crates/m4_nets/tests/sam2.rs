//! SAM 2.1 as a caller sees it: its checkpoints, its clips, and what it refuses. The parts are
//! compared with upstream's in the crate.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::loaded;
use m4_core::{Plane, RgbImage, Silent};
use m4_nets::sam2::{Direction, ObjectMask, VideoPredictor, VideoSize};
use m4_nets::{NetError, PointPrompt, Prompt, Sam2, cpu};
use m4_testkit::{FormulaWeights, StopAtPoll, same_on_any_threads};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};

const TINY: &str = include_str!("../../../fixtures/sam2/tiny.keys.txt");

/// The tiny size whose objects are there, as in the fixtures.
fn network() -> Sam2 {
    let weights = FormulaWeights::of_keys(TINY)
        .with("sam_mask_decoder.pred_obj_score_head.layers.2.bias", &[1.0]);
    loaded(&weights, |path| Sam2::load(path, cpu()))
}

/// The same for images of 64 by 64 pixels.
fn smallest() -> Arc<Sam2> {
    static NET: LazyLock<Arc<Sam2>> = LazyLock::new(|| Arc::new(network().with_side(64).unwrap()));
    Arc::clone(&NET)
}

#[test]
fn other_sides_are_multiples_of_32() {
    for side in [0, 32, 100, 2080] {
        let error = network().with_side(side).unwrap_err();
        assert!(
            error.to_string().contains(&format!("not {side}")),
            "{error}"
        );
    }
}

/// Upstream counts pixels from 0.
fn point(at: &[f32], on_object: bool) -> PointPrompt {
    PointPrompt {
        at_px: [at[0] + 0.5, at[1] + 0.5],
        on_object,
    }
}

fn points(points: Vec<PointPrompt>) -> Prompt {
    Prompt {
        points,
        ..Prompt::default()
    }
}

/// A disc that moves over waves.
fn moving(w: usize, h: usize, frame: usize) -> RgbImage {
    Plane::from_fn(w, h, |x, y| {
        let (dx, dy) = (x as f32 - 12.0 - frame as f32, y as f32 - h as f32 / 2.0);
        if dx.hypot(dy) < h as f32 / 4.0 {
            return [220, 60, 40];
        }
        [0.31, 0.17, 0.07]
            .map(|f: f32| (127.0 + 90.0 * (x as f32 * f).sin() * (y as f32 * f * 0.7).cos()) as u8)
    })
}

const CLIP: VideoSize = VideoSize {
    frames: 60,
    width: 90,
    height: 50,
};

fn clip_filled(fill_holes_px: usize) -> VideoPredictor<'static> {
    let images = Box::new(|frame: usize| Ok(moving(90, 50, frame)));
    VideoPredictor::new(smallest(), CLIP, images, fill_holes_px).unwrap()
}

fn clip() -> VideoPredictor<'static> {
    clip_filled(0)
}

fn here() -> Prompt {
    points(vec![point(&[12.0, 25.0], true), point(&[80.0, 5.0], false)])
}

/// All masks of two objects, of which one is prompted later, forward and backward.
#[test]
fn masks_are_the_same_on_any_number_of_threads() {
    let outputs = same_on_any_threads(|| {
        let mut predictor = clip();
        let mut outputs = Vec::new();
        predictor.show(0, 7, &here()).unwrap();
        let mut follow = |predictor: &mut VideoPredictor<'_>, frames, direction| {
            let keep =
                |frame, masks: &BTreeMap<u32, ObjectMask>| outputs.push((frame, masks.clone()));
            predictor.follow(frames, direction, &Silent, keep).unwrap();
        };
        follow(&mut predictor, 0..=3, Direction::Forward);
        predictor.show(3, 9, &here()).unwrap();
        follow(&mut predictor, 3..=4, Direction::Forward);
        follow(&mut predictor, 1..=3, Direction::Backward);
        outputs
    });
    assert_eq!(
        outputs.iter().map(|(frame, _)| *frame).collect::<Vec<_>>(),
        [0, 1, 2, 3, 3, 4, 3, 2, 1]
    );
    for mask in outputs.iter().flat_map(|(_, masks)| masks.values()) {
        assert!(mask.logits.data().iter().all(|x| x.is_finite()));
    }
}

#[test]
fn frames_are_read_once_for_any_number_of_objects() {
    let asked = AtomicUsize::new(0);
    let images = Box::new(|frame: usize| {
        asked.fetch_add(1, Ordering::Relaxed);
        Ok(moving(33, 20, frame))
    });
    let mut predictor = VideoPredictor::new(smallest(), CLIP, images, 0).unwrap();
    for object in [3, 1, 2, 9, 8] {
        let prompt = points(vec![point(&[8.0 * object as f32, 25.0], true)]);
        predictor.show(0, object, &prompt).unwrap();
    }
    predictor.show(2, 4, &here()).unwrap();
    let mut all = Vec::new();
    let keep = |_, masks: &BTreeMap<u32, ObjectMask>| {
        all.push(masks.keys().copied().collect::<Vec<u32>>())
    };
    predictor
        .follow(0..=3, Direction::Forward, &Silent, keep)
        .unwrap();
    assert_eq!(all, vec![vec![1, 2, 3, 4, 8, 9]; 4]);
    assert_eq!(predictor.objects().collect::<Vec<_>>(), [1, 2, 3, 4, 8, 9]);
    predictor.remove(3).unwrap();
    assert_eq!(predictor.objects().count(), 5);
    drop(predictor);
    assert_eq!(asked.load(Ordering::Relaxed), 4);
}

#[test]
fn a_mask_is_taken_as_it_is() {
    let mut predictor = clip();
    let disc = moving(180, 100, 20).map(|&pixel| pixel == [220, 60, 40]);
    let actual = predictor.show_mask(0, 1, &disc).unwrap();
    assert!(actual.is_there() && (actual.iou, actual.score) == (1.0, 10.0));
    let back = actual.mask_at((180, 100));
    let differ = back
        .data()
        .iter()
        .zip(disc.data())
        .filter(|(a, b)| a != b)
        .count();
    let area = disc.data().iter().filter(|&&on| on).count();
    assert!(area > 1000 && differ * 4 < area, "{differ} of {area}");
    // nothing is an object that is missing
    let none = predictor
        .show_mask(0, 2, &Plane::filled(5, 5, false))
        .unwrap();
    assert!(!none.is_there() && none.mask_at((90, 50)).data().iter().all(|&on| !on));
    let mut last = BTreeMap::new();
    let keep = |_, masks: &BTreeMap<u32, ObjectMask>| last.clone_from(masks);
    predictor
        .follow(0..=2, Direction::Forward, &Silent, keep)
        .unwrap();
    assert_ne!(last[&1], last[&2]);
}

#[test]
fn every_prompted_frame_counts() {
    let run = |shown: &[usize]| {
        let mut predictor = clip();
        for &frame in shown {
            predictor.show(frame, 1, &here()).unwrap();
        }
        let mut last = None;
        let keep = |_, masks: &BTreeMap<u32, ObjectMask>| last = masks.get(&1).cloned();
        predictor
            .follow(31..=32, Direction::Forward, &Silent, keep)
            .unwrap();
        last.unwrap().logits
    };
    assert_ne!(run(&[0, 5, 20, 40, 59]), run(&[0, 5, 20, 40]));
}

#[test]
fn holes_are_filled_where_asked() {
    let run = |fill_holes_px| {
        clip_filled(fill_holes_px)
            .show(0, 1, &here())
            .unwrap()
            .logits
    };
    let (open, filled) = (run(0), run(256));
    assert!(open.data().iter().any(|&x| x <= 0.0) && open.data().iter().any(|&x| x > 0.0));
    assert!(filled.data().iter().all(|&x| x > 0.0));
}

#[test]
fn the_user_can_stop() {
    let mut predictor = clip();
    predictor.show(0, 1, &here()).unwrap();
    let mut n_frames = 0;
    let stopped = predictor.follow(0..=59, Direction::Forward, &StopAtPoll::after(4), |_, _| {
        n_frames += 1
    });
    assert!(matches!(stopped, Err(NetError::Cancelled)));
    assert_eq!(n_frames, 3);
}

#[test]
fn invalid_clips_and_prompts_are_refused() {
    let says = |error: NetError, message: &str| {
        assert!(
            error.to_string().contains(message),
            "{error}, not {message}"
        )
    };
    let images = |size: (usize, usize)| Box::new(move |_: usize| Ok(moving(size.0, size.1, 0)));
    let open = |clip, size| VideoPredictor::new(smallest(), clip, images(size), 0);
    for (frames, width, message) in [
        (0, 9, "without frames"),
        (4, 0, "a clip has no pixels: it is 0 x 9"),
    ] {
        says(
            open(
                VideoSize {
                    frames,
                    width,
                    height: 9,
                },
                (9, 9),
            )
            .unwrap_err(),
            message,
        );
    }
    says(
        open(CLIP, (0, 9)).unwrap().show(0, 1, &here()).unwrap_err(),
        "an image has no pixels",
    );
    let broken = Box::new(|_: usize| Err("no such file".into()));
    let mut broken = VideoPredictor::new(smallest(), CLIP, broken, 0).unwrap();
    says(
        broken.show(3, 1, &here()).unwrap_err(),
        "frame 3 is not available: no such file",
    );

    let mut predictor = clip();
    let follow = |predictor: &mut VideoPredictor<'_>, frames| {
        predictor.follow(frames, Direction::Forward, &Silent, |_, _| ())
    };
    says(
        follow(&mut predictor, 0..=3).unwrap_err(),
        "no object to track",
    );
    assert!(matches!(
        predictor.remove(5),
        Err(NetError::UnknownObject(5))
    ));
    let at = |x, y| {
        points(vec![PointPrompt {
            at_px: [x, y],
            on_object: true,
        }])
    };
    let with_box = |corners| Prompt {
        box_px: Some(corners),
        ..Prompt::default()
    };
    let with_mask = |mask| Prompt {
        mask_logits: Some(mask),
        ..here()
    };
    let outside = "of an image of 90 x 50 pixels";
    for (prompt, message) in [
        (at(-1.0, 3.0), outside),
        (at(3.0, 90.5), outside),
        (at(90.5, 3.0), outside),
        (at(f32::NAN, 3.0), outside),
        (at(3.0, f32::INFINITY), outside),
        (with_box([9.0, 9.0, 30.0, f32::NAN]), outside),
        (
            with_box([9.0, 9.0, 3.0, 12.0]),
            "first column and row, then last",
        ),
        (Prompt::default(), "a point, a box or a mask"),
        (
            with_mask(Plane::filled(16, 9, 0.0)),
            "has 16 x 16 pixels, as the logits of a prediction, not 16 x 9",
        ),
        (
            with_mask(Plane::filled(16, 16, f32::NAN)),
            "NaN or infinite",
        ),
    ] {
        says(predictor.show(0, 1, &prompt).unwrap_err(), message);
    }
    for prompt in [
        at(90.0, 50.0),
        at(0.0, 0.0),
        with_mask(Plane::filled(16, 16, 1e30)),
    ] {
        predictor.show(0, 1, &prompt).unwrap();
    }
    says(
        predictor
            .show_mask(0, 1, &Plane::filled(0, 9, true))
            .unwrap_err(),
        "a mask has no pixels",
    );

    let far = predictor.show(60, 1, &here());
    assert!(matches!(
        far,
        Err(NetError::NoSuchFrame {
            frame: 60,
            frames: 60
        })
    ));
    assert!(matches!(
        follow(&mut predictor, 50..=60),
        Err(NetError::NoSuchFrame { .. })
    ));
    #[expect(clippy::reversed_empty_ranges, reason = "what is tested")]
    let backward = 5..=3;
    follow(&mut predictor, backward).unwrap();
    // frames from the last on, and before all that was shown
    follow(&mut predictor, 59..=59).unwrap();
    predictor.show(40, 2, &here()).unwrap();
    follow(&mut predictor, 0..=1).unwrap();
}

#[test]
fn a_clip_of_one_frame_can_be_corrected() {
    let images = Box::new(|_: usize| Ok(moving(64, 64, 0)));
    let clip = VideoSize {
        frames: 1,
        width: 64,
        height: 64,
    };
    let mut predictor = VideoPredictor::new(smallest(), clip, images, 0).unwrap();
    predictor
        .show(0, 1, &points(vec![point(&[12.0, 30.0], true)]))
        .unwrap();
    predictor
        .follow(0..=0, Direction::Forward, &Silent, |_, _| ())
        .unwrap();
    let corrected = predictor
        .show(0, 1, &points(vec![point(&[40.0, 30.0], false)]))
        .unwrap();
    assert!(corrected.logits.data().iter().all(|x| x.is_finite()));
    predictor
        .follow(0..=0, Direction::Backward, &Silent, |_, masks| {
            assert_eq!(masks[&1], corrected)
        })
        .unwrap();
}
