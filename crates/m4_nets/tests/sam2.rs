//! SAM 2.1 as a caller sees it: its checkpoints, its clips, and what it refuses. The parts are compared with upstream's in the crate.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{fixtures, floats};
use m4_core::{Plane, Progress, RgbImage, Silent};
use m4_nets::sam2::{Clip, Direction, ObjectMask, VideoOptions, VideoPredictor};
use m4_nets::{LoadError, PointPrompt, Prompt, Sam2, Sam2Error, Sam2Size, cpu};
use m4_testkit::{FormulaWeights, write_formula_weights};
use safetensors::SafeTensors;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};
use tempfile::TempDir;

const TINY: &str = include_str!("../../../fixtures/sam2/tiny.keys.txt");
const SMALL: &str = include_str!("../../../fixtures/sam2/small.keys.txt");
/// Numbers of the tiny checkpoint; `no_mem_pos_enc` is not used.
const ALL: usize = 38_962_754;
const UNUSED: usize = 256;

fn load(folder: &Path, keys: &str) -> Result<Sam2, LoadError> {
    let path = folder.join("weights.safetensors");
    write_formula_weights(keys, &path);
    Sam2::load(&path, cpu())
}

/// The tiny size whose objects are there, as in the fixtures.
fn weights() -> FormulaWeights {
    FormulaWeights::of_keys(TINY).with("sam_mask_decoder.pred_obj_score_head.layers.2.bias", &[1.0])
}

fn network(side: usize) -> Arc<Sam2> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    weights().write(&path);
    Arc::new(Sam2::load(&path, cpu()).unwrap().with_side(side).unwrap())
}

/// The same for images of 64 by 64 pixels.
fn smallest() -> Arc<Sam2> {
    static NET: LazyLock<Arc<Sam2>> = LazyLock::new(|| network(64));
    Arc::clone(&NET)
}

#[test]
fn takes_exactly_the_published_keys() {
    let folder = TempDir::new().unwrap();
    let net = load(folder.path(), TINY).unwrap();
    assert_eq!(net.parameters(), ALL - UNUSED);
    assert_eq!((net.size(), net.mask_side()), (Sam2Size::Tiny, 256));
    drop(net);
    let line = TINY.lines().find(|line| line.starts_with("obj_ptr_tpos_proj.bias")).unwrap();
    let Err(LoadError::OtherNetwork { missing, .. }) = load(folder.path(), &TINY.replace(&format!("{line}\n"), ""))
    else {
        panic!("{line} is missing and nothing was said");
    };
    assert_eq!(missing.len(), 1);
    let Err(error) = load(folder.path(), &format!("{TINY}memory_encoder.head.weight 2 2\n")) else {
        panic!("a tensor is left over");
    };
    assert!(error.to_string().contains("memory_encoder.head.weight"), "{error}");
    // below `model`, as published
    let published: String = TINY.lines().map(|line| format!("model.{line}\n")).collect();
    assert_eq!(load(folder.path(), &published).unwrap().parameters(), ALL - UNUSED);
    let small = load(folder.path(), SMALL).unwrap();
    assert_eq!((small.size(), small.parameters()), (Sam2Size::Small, 46_060_610 - UNUSED));
    let Err(error) = load(folder.path(), include_str!("../../../fixtures/droid/keys.txt")) else {
        panic!("another network");
    };
    assert!(matches!(error, LoadError::OtherNetwork { .. }), "{error}");
}

#[test]
fn other_sides_are_multiples_of_32() {
    let folder = TempDir::new().unwrap();
    for side in [0, 32, 100, 2080] {
        let error = load(folder.path(), TINY).unwrap().with_side(side).unwrap_err();
        assert!(matches!(error, Sam2Error::Side(s) if s == side), "{error}");
    }
}

/// The frames of a fixture, each pixel four times per side.
fn frames(file: &[u8]) -> Vec<RgbImage> {
    let tensors = SafeTensors::deserialize(file).unwrap();
    let bytes = tensors.tensor("frames_u8_64").unwrap().data().to_vec();
    let frame = |bytes: &[u8]| {
        RgbImage::from_fn(256, 256, |x, y| {
            let at = (y / 4 * 64 + x / 4) * 3;
            [bytes[at], bytes[at + 1], bytes[at + 2]]
        })
    };
    bytes.chunks_exact(64 * 64 * 3).map(frame).collect()
}

/// Upstream counts pixels from 0.
fn point(at: &[f32], on_object: bool) -> PointPrompt {
    PointPrompt { at_px: [at[0] + 0.5, at[1] + 0.5], on_object }
}

fn points(points: Vec<PointPrompt>) -> Prompt {
    Prompt { points, ..Prompt::default() }
}

/// Passages A to C of the fixture in whole runs: masks of all frames in the clip's size, every 16th row and column.
fn passages(net: Arc<Sam2>, file: &[u8], options: VideoOptions) -> [Vec<f32>; 3] {
    let frames = frames(file);
    let clip = Clip { frames: 6, width: 320, height: 192 };
    let images = Box::new(move |i: usize| Ok(frames[i].clone()));
    let mut predictor = VideoPredictor::new(net, clip, images, options).unwrap();
    let three = floats(file, "prompt_obj2");
    let (box_px, place) = (floats(file, "prompt_box3"), floats(file, "prompt_obj3_point"));
    let one = points(vec![point(&floats(file, "prompt_obj1"), true)]);
    let two = points((0..3).map(|i| point(&three[2 * i..], i < 2)).collect());
    predictor.show(0, 1, &one).unwrap();
    predictor.show(0, 2, &two).unwrap();
    let mut follow = |frames, direction, shown: Option<Prompt>| {
        if let Some(prompt) = shown {
            predictor.show(3, 3, &prompt).unwrap();
        }
        let mut seen = Vec::new();
        let keep = |_, masks: &BTreeMap<u32, ObjectMask>| {
            for mask in masks.values() {
                let plane = mask.logits_at((320, 192));
                for y in (0..192).step_by(16) {
                    seen.extend(plane.row(y).iter().step_by(16));
                }
            }
        };
        predictor.follow(frames, direction, &Silent, keep).unwrap();
        seen
    };
    let a = follow(0..=5, Direction::Forward, None);
    let third = Prompt {
        points: vec![point(&place, true)],
        box_px: Some([0, 1, 2, 3].map(|i| box_px[i] + 0.5)),
        mask_logits: None,
    };
    let b = follow(3..=5, Direction::Forward, Some(third));
    let c = follow(0..=3, Direction::Backward, None);
    [a, b, c]
}

#[test]
fn a_clip_meets_its_fixture_on_any_number_of_threads() {
    let net = network(256);
    let file = fs::read(fixtures().join("sam2/video_256.safetensors")).unwrap();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| passages(Arc::clone(&net), &file, VideoOptions::default()))
    };
    let got = with(1);
    for (got, name) in got.iter().zip(["A", "B", "C"]) {
        let want = floats(&file, &format!("{name}_video_masks_strided"));
        assert_eq!(got.len(), want.len());
        let largest = want.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
        let off = got.iter().zip(&want).map(|(a, b)| (a - b).abs());
        let error = off.fold(0.0_f32, |m, x| if x.is_nan() { f32::INFINITY } else { m.max(x) }) / largest;
        println!("{name}: {error:.1e} of {largest}");
        assert!(largest > 0.0 && error < 1e-4, "{name}: {error:e}");
    }
    assert_eq!(got, with(3));
    // nothing else is left out where more is remembered
    let more = VideoOptions { history_frames: 100, together: 1, ..VideoOptions::default() };
    for (a, b) in passages(net, &file, more).iter().flatten().zip(got.iter().flatten()) {
        assert!((a - b).abs() < 1e-4 * (1.0 + b.abs()), "{a} {b}");
    }
}

/// A disc that moves over waves.
fn moving(w: usize, h: usize, frame: usize) -> RgbImage {
    Plane::from_fn(w, h, |x, y| {
        let (dx, dy) = (x as f32 - 12.0 - frame as f32, y as f32 - h as f32 / 2.0);
        if dx.hypot(dy) < h as f32 / 4.0 {
            return [220, 60, 40];
        }
        [0.31, 0.17, 0.07].map(|f: f32| (127.0 + 90.0 * (x as f32 * f).sin() * (y as f32 * f * 0.7).cos()) as u8)
    })
}

const CLIP: Clip = Clip { frames: 60, width: 90, height: 50 };

fn clip(options: VideoOptions) -> VideoPredictor<'static> {
    let images = Box::new(|frame: usize| Ok(moving(90, 50, frame)));
    VideoPredictor::new(smallest(), CLIP, images, options).unwrap()
}

fn here() -> Prompt {
    points(vec![point(&[12.0, 25.0], true), point(&[80.0, 5.0], false)])
}

#[test]
fn memories_older_than_the_history_are_dropped() {
    for (history_frames, kept) in [(0, 15), (20, 20)] {
        let mut predictor = clip(VideoOptions { history_frames, ..VideoOptions::default() });
        predictor.show(0, 7, &here()).unwrap();
        let mut seen = Vec::new();
        let keep = |frame, masks: &BTreeMap<u32, ObjectMask>| {
            assert_eq!(masks.keys().collect::<Vec<_>>(), [&7]);
            assert!(masks[&7].logits.data().iter().all(|x| x.is_finite()));
            seen.push(frame);
        };
        predictor.follow(0..=59, Direction::Forward, &Silent, keep).unwrap();
        assert_eq!(seen, (0..60).collect::<Vec<_>>());
        for frame in 0..60 {
            let known = predictor.mask(frame, 7).unwrap().is_some();
            assert_eq!(known, frame <= kept || 59 - frame <= kept, "frame {frame}, {kept}");
        }
        // what is forgotten can be corrected anyway
        predictor.show(30, 7, &here()).unwrap();
        predictor.follow(25..=30, Direction::Backward, &Silent, |_, _| ()).unwrap();
    }
}

#[test]
fn frames_are_read_once_for_any_number_of_objects() {
    let asked = AtomicUsize::new(0);
    let images = Box::new(|frame: usize| {
        asked.fetch_add(1, Ordering::Relaxed);
        Ok(moving(33, 20, frame))
    });
    let mut predictor = VideoPredictor::new(smallest(), CLIP, images, VideoOptions::default()).unwrap();
    for object in [3, 1, 2, 9, 8] {
        let prompt = points(vec![point(&[8.0 * object as f32, 25.0], true)]);
        predictor.show(0, object, &prompt).unwrap();
    }
    predictor.show(2, 4, &here()).unwrap();
    let mut all = Vec::new();
    let keep = |_, masks: &BTreeMap<u32, ObjectMask>| all.push(masks.keys().copied().collect::<Vec<u32>>());
    predictor.follow(0..=3, Direction::Forward, &Silent, keep).unwrap();
    assert_eq!(all, vec![vec![1, 2, 3, 4, 8, 9]; 4]);
    assert_eq!(predictor.objects().collect::<Vec<_>>(), [1, 2, 3, 4, 8, 9]);
    predictor.remove(3).unwrap();
    assert_eq!(predictor.objects().count(), 5);
    drop(predictor);
    assert_eq!(asked.load(Ordering::Relaxed), 4);
}

#[test]
fn a_mask_is_taken_as_it_is() {
    let mut predictor = clip(VideoOptions::default());
    let disc = moving(180, 100, 20).map(|&pixel| pixel == [220, 60, 40]);
    let found = predictor.show_mask(0, 1, &disc).unwrap();
    assert!(found.is_there() && (found.iou, found.score) == (1.0, 10.0));
    let back = found.mask_at((180, 100));
    let differ = back.data().iter().zip(disc.data()).filter(|(a, b)| a != b).count();
    let area = disc.data().iter().filter(|&&on| on).count();
    assert!(area > 1000 && differ * 4 < area, "{differ} of {area}");
    // nothing is an object that is missing
    let none = predictor.show_mask(0, 2, &Plane::filled(5, 5, false)).unwrap();
    assert!(!none.is_there() && none.mask_at((90, 50)).data().iter().all(|&on| !on));
    let mut last = BTreeMap::new();
    let keep = |_, masks: &BTreeMap<u32, ObjectMask>| last.clone_from(masks);
    predictor.follow(0..=2, Direction::Forward, &Silent, keep).unwrap();
    assert_ne!(last[&1], last[&2]);
}

#[test]
fn several_shown_frames_all_count() {
    let run = |shown: &[usize], most_conditioning| {
        let mut predictor = clip(VideoOptions { most_conditioning, ..VideoOptions::default() });
        for &frame in shown {
            predictor.show(frame, 1, &here()).unwrap();
        }
        let mut last = None;
        let keep = |_, masks: &BTreeMap<u32, ObjectMask>| last = masks.get(&1).cloned();
        predictor.follow(31..=32, Direction::Forward, &Silent, keep).unwrap();
        last.unwrap().logits
    };
    let all = run(&[0, 5, 20, 40, 59], None);
    assert_ne!(all, run(&[0, 5, 20, 40], None));
    // the nearest before and after, as if there were no others
    assert_eq!(run(&[0, 5, 20, 40, 59], Some(2)), run(&[20, 40], None));
    assert_eq!(run(&[0, 5, 20, 40, 59], Some(5)), all);
}

#[test]
fn corrections_may_count_as_shown_first() {
    for corrections_condition in [false, true] {
        let mut predictor = clip(VideoOptions { corrections_condition, ..VideoOptions::default() });
        predictor.show(0, 1, &here()).unwrap();
        predictor.follow(0..=3, Direction::Forward, &Silent, |_, _| ()).unwrap();
        let before = predictor.mask(2, 1).unwrap().unwrap();
        let corrected = predictor.show(2, 1, &points(vec![point(&[13.0, 25.0], false)])).unwrap();
        assert_ne!(before.logits, corrected.logits);
        let mut seen = Vec::new();
        let keep = |_, masks: &BTreeMap<u32, ObjectMask>| seen.push(masks[&1].clone());
        predictor.follow(2..=30, Direction::Forward, &Silent, keep).unwrap();
        assert_eq!(seen[0], corrected);
    }
}

#[test]
fn holes_are_filled_where_asked() {
    let run = |fill_holes_px| {
        let mut predictor = clip(VideoOptions { fill_holes_px, ..VideoOptions::default() });
        predictor.show(0, 1, &here()).unwrap().logits
    };
    let (open, filled) = (run(0), run(256));
    assert!(open.data().iter().any(|&x| x <= 0.0) && open.data().iter().any(|&x| x > 0.0));
    assert!(filled.data().iter().all(|&x| x > 0.0));
}

/// Stops after some steps.
struct Stops(AtomicUsize);

impl Progress for Stops {
    fn update(&self, _: &str, _: usize, total: usize, _: &str) {
        assert_eq!(total, 60);
        self.0.fetch_sub(1, Ordering::Relaxed);
    }

    fn warn(&self, _: &str) {}

    fn cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed) == 0
    }
}

#[test]
fn the_user_can_stop() {
    let mut predictor = clip(VideoOptions::default());
    predictor.show(0, 1, &here()).unwrap();
    let mut seen = 0;
    let stopped = predictor.follow(0..=59, Direction::Forward, &Stops(AtomicUsize::new(3)), |_, _| seen += 1);
    assert!(matches!(stopped, Err(Sam2Error::Cancelled)));
    assert_eq!(seen, 3);
}

#[test]
fn invalid_clips_and_prompts_are_refused() {
    let images = |size: (usize, usize)| Box::new(move |_: usize| Ok(moving(size.0, size.1, 0)));
    let clip_of = |frames, width, height| Clip { frames, width, height };
    let options = VideoOptions::default;
    let no = |clip| VideoPredictor::new(smallest(), clip, images((9, 9)), options()).map(drop).unwrap_err();
    assert!(matches!(no(clip_of(0, 9, 9)), Sam2Error::NoFrames));
    assert!(matches!(no(clip_of(4, 0, 9)), Sam2Error::NoPixels { .. }));

    let mut empty = VideoPredictor::new(smallest(), CLIP, images((0, 9)), options()).unwrap();
    assert!(matches!(empty.show(0, 1, &here()), Err(Sam2Error::NoPixels { .. })));
    let broken = Box::new(|_: usize| Err("no such file".into()));
    let mut broken = VideoPredictor::new(smallest(), CLIP, broken, options()).unwrap();
    let error = broken.show(3, 1, &here()).unwrap_err();
    assert!(error.to_string().contains("frame 3") && error.to_string().contains("no such file"), "{error}");

    let mut predictor = clip(options());
    let follow =
        |predictor: &mut VideoPredictor<'_>, frames| predictor.follow(frames, Direction::Forward, &Silent, |_, _| ());
    assert!(matches!(follow(&mut predictor, 0..=3), Err(Sam2Error::NoObjects)));
    assert!(matches!(predictor.mask(0, 5), Err(Sam2Error::UnknownObject(5))));
    assert!(matches!(predictor.remove(5), Err(Sam2Error::UnknownObject(5))));
    for (at, expected) in [
        ([-1.0, 3.0], true),
        ([3.0, 90.5], true),
        ([90.5, 3.0], true),
        ([f32::NAN, 3.0], true),
        ([3.0, f32::INFINITY], true),
        ([90.0, 50.0], false),
        ([0.0, 0.0], false),
    ] {
        let prompt = points(vec![PointPrompt { at_px: at, on_object: true }]);
        let said = predictor.show(0, 1, &prompt);
        assert_eq!(matches!(said, Err(Sam2Error::Outside { .. })), expected, "{at:?}");
        assert_eq!(said.is_err(), expected, "{at:?}");
    }
    let with_box = |corners| Prompt { box_px: Some(corners), ..Prompt::default() };
    let refused = |predictor: &mut VideoPredictor<'_>, prompt: &Prompt| predictor.show(0, 1, prompt).unwrap_err();
    let reversed = refused(&mut predictor, &with_box([9.0, 9.0, 3.0, 12.0]));
    assert!(matches!(reversed, Sam2Error::Reversed(_)), "{reversed}");
    let outside = refused(&mut predictor, &with_box([9.0, 9.0, 30.0, f32::NAN]));
    assert!(matches!(outside, Sam2Error::Outside { .. }), "{outside}");
    let nothing = refused(&mut predictor, &Prompt::default());
    assert!(matches!(nothing, Sam2Error::NothingAsked), "{nothing}");
    let with_mask = |mask| Prompt { mask_logits: Some(mask), ..here() };
    let size = refused(&mut predictor, &with_mask(Plane::filled(16, 9, 0.0)));
    assert!(matches!(size, Sam2Error::MaskSize { expected: 16, .. }), "{size}");
    let wild = refused(&mut predictor, &with_mask(Plane::filled(16, 16, f32::NAN)));
    assert!(matches!(wild, Sam2Error::NotFinite), "{wild}");
    predictor.show(0, 1, &with_mask(Plane::filled(16, 16, 1e30))).unwrap();
    let mask = Plane::filled(0, 9, true);
    assert!(matches!(predictor.show_mask(0, 1, &mask), Err(Sam2Error::NoPixels { .. })));

    let far = predictor.show(60, 1, &here());
    assert!(matches!(far, Err(Sam2Error::NoSuchFrame { frame: 60, frames: 60 })));
    assert!(matches!(follow(&mut predictor, 50..=60), Err(Sam2Error::NoSuchFrame { .. })));
    assert!(matches!(predictor.mask(usize::MAX, 1), Err(Sam2Error::NoSuchFrame { .. })));
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
    let clip = Clip { frames: 1, width: 64, height: 64 };
    let mut predictor = VideoPredictor::new(smallest(), clip, images, VideoOptions::default()).unwrap();
    predictor.show(0, 1, &points(vec![point(&[12.0, 30.0], true)])).unwrap();
    predictor.follow(0..=0, Direction::Forward, &Silent, |_, _| ()).unwrap();
    let corrected = predictor.show(0, 1, &points(vec![point(&[40.0, 30.0], false)])).unwrap();
    assert!(corrected.logits.data().iter().all(|x| x.is_finite()));
    predictor.follow(0..=0, Direction::Backward, &Silent, |_, masks| assert_eq!(masks[&1], corrected)).unwrap();
}

#[test]
fn an_image_has_three_masks_or_one() {
    let net = smallest();
    assert!(matches!(net.encode(&moving(0, 0, 0)), Err(Sam2Error::NoPixels { .. })));
    let features = net.encode(&moving(300, 7, 0)).unwrap();
    let at = |x: f32| point(&[x, 3.0], true);
    let three = net.masks(&features, &points(vec![at(10.0)])).unwrap();
    let one = net.masks(&features, &points(vec![at(10.0), at(30.0)])).unwrap();
    assert_eq!((three.len(), one.len()), (3, 1));
    assert_eq!(three[0].logits.size(), (16, 16));
    assert_eq!(three[0].logits_at((300, 7)).size(), (300, 7));
    assert_eq!(three[0].logits_at((0, 7)).size(), (0, 7));
    for mask in three.iter().chain(&one) {
        assert!((0.0..=1.0).contains(&mask.iou) && mask.score.is_finite());
    }
    let again = Prompt { mask_logits: Some(three[1].logits.clone()), ..points(vec![at(10.0)]) };
    assert_ne!(net.masks(&features, &again).unwrap(), three);
    let outside = net.masks(&features, &points(vec![at(301.0)]));
    assert!(matches!(outside, Err(Sam2Error::Outside { .. })));
}
