//! What a session promises to any caller.

use super::film::{FRAMES, SIZE, image, thing_at};
use crate::classical::dense::InverseSearch;
use crate::masks::{FlowFollower, FrameSource, ImageError, ObjectId, ObjectMask, ObjectPrompt, Visibility};
use crate::masks::{VideoError, VideoSegmenter, VideoSession};
use m4_core::{CompactMask, RgbImage, Silent};
use std::borrow::Cow;
use std::ops::ControlFlow;
use std::sync::Mutex;

/// Makes its images when asked, and remembers which were.
#[derive(Default)]
struct Lazy(Mutex<Vec<usize>>);

impl FrameSource for Lazy {
    fn frames(&self) -> usize {
        FRAMES
    }

    fn size(&self) -> (usize, usize) {
        SIZE
    }

    fn image(&self, frame: usize) -> Result<Cow<'_, RgbImage>, ImageError> {
        self.0.lock().unwrap().push(frame);
        Ok(Cow::Owned(image(frame)))
    }
}

fn exactly(thing: u8, frame: usize) -> CompactMask {
    CompactMask::from_fn(SIZE.0, SIZE.1, |x, y| thing_at(x, y, frame) == thing)
}

fn overlap(a: &CompactMask, b: &CompactMask) -> f64 {
    let both = a.set_pixels().filter(|&(x, y)| b.at(x, y)).count();
    both as f64 / (a.count() + b.count() - both) as f64
}

fn followed(
    session: &mut dyn VideoSession,
    objects: &[ObjectId],
    from: usize,
    to: usize,
) -> Result<Vec<(usize, Vec<ObjectMask>)>, VideoError> {
    let mut all = Vec::new();
    session.follow(objects, from, to, &Silent, &mut |frame, masks| {
        all.push((frame, masks));
        ControlFlow::Continue(())
    })?;
    Ok(all)
}

const WALKER: ObjectId = ObjectId(4);
const LATE: ObjectId = ObjectId(2);

#[test]
fn objects_are_tracked_in_one_pass_per_direction() {
    let (flow, clip) = (InverseSearch, Lazy::default());
    let follower = FlowFollower::new(&flow, None);
    let mut session = follower.open(&clip, SIZE).unwrap();
    session.set_mask(15, WALKER, &exactly(1, 15)).unwrap();
    session.set_mask(15, LATE, &exactly(2, 15)).unwrap();
    assert!(clip.0.lock().unwrap().is_empty());
    let objects = [LATE, WALKER];
    for (to, way) in [(20, (16..=20).collect::<Vec<_>>()), (10, (10..15).rev().collect())] {
        let found = followed(session.as_mut(), &objects, 15, to).unwrap();
        assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), way);
        for (frame, masks) in found {
            assert_eq!(masks.iter().map(|m| m.object).collect::<Vec<_>>(), objects);
            for (mask, thing) in masks.iter().zip([2, 1]) {
                let score = overlap(&mask.mask, &exactly(thing, frame));
                assert!(
                    mask.visibility == Visibility::Visible && score > 0.85,
                    "thing {thing}, frame {frame}: {score}"
                );
            }
        }
    }
    assert!(clip.0.lock().unwrap().iter().all(|frame| (10..=20).contains(frame)));
    // On from where it was, as if it had gone there at once.
    let further = followed(session.as_mut(), &objects, 20, 24).unwrap();
    let mut other = follower.open(&clip, SIZE).unwrap();
    other.set_mask(15, WALKER, &exactly(1, 15)).unwrap();
    other.set_mask(15, LATE, &exactly(2, 15)).unwrap();
    let at_once = followed(other.as_mut(), &objects, 15, 24).unwrap();
    assert_eq!(further, at_once[5..]);
    assert!(followed(session.as_mut(), &objects, 24, 24).unwrap().is_empty());
}

#[test]
fn prompts_are_kept_at_their_frame() {
    let (flow, clip) = (InverseSearch, Lazy::default());
    let follower = FlowFollower::new(&flow, None);
    let mut session = follower.open(&clip, SIZE).unwrap();
    session.set_mask(0, WALKER, &exactly(1, 0)).unwrap();
    let other = exactly(2, 12);
    session.set_mask(12, WALKER, &other).unwrap();
    let found = followed(session.as_mut(), &[WALKER], 0, 13).unwrap();
    assert_eq!(found[11].1[0].mask, other);
    assert!(overlap(&found[12].1[0].mask, &exactly(2, 13)) > 0.85);
    let (w, h) = SIZE;
    let prompt = |belief: Option<Vec<f32>>, box_px| ObjectPrompt {
        object: LATE,
        on_px: vec![[3.5, 4.5]],
        off_px: Vec::new(),
        box_px,
        belief,
    };
    let of =
        |session: &mut dyn VideoSession, prompt: ObjectPrompt| session.prompt(3, &[prompt]).unwrap().remove(0).mask;
    let belief: Vec<f32> = (0..w * h).map(|p| p as f32 - 100.0).collect();
    assert!(of(session.as_mut(), prompt(Some(belief), None)).count() > w * h - 400);
    assert_eq!(of(session.as_mut(), prompt(None, Some([2.5, 2.5, 5.5, 4.5]))).count(), 12);
    assert_eq!(of(session.as_mut(), prompt(None, None)).count(), 1);
}

#[test]
fn impossible_requests_are_errors() {
    let (flow, clip) = (InverseSearch, Lazy::default());
    let follower = FlowFollower::new(&flow, None);
    let mut session = follower.open(&clip, SIZE).unwrap();
    session.set_mask(4, WALKER, &exactly(1, 4)).unwrap();
    let unknown = |e: VideoError| matches!(e, VideoError::Unknown { .. });
    assert!(unknown(followed(session.as_mut(), &[WALKER], 5, 7).unwrap_err()));
    assert!(unknown(followed(session.as_mut(), &[LATE], 4, 7).unwrap_err()));
    let error = followed(session.as_mut(), &[WALKER], 4, FRAMES).unwrap_err();
    assert!(matches!(error, VideoError::Frame { frame: 30, frames: 30 }));
    let small = CompactMask::from_fn(SIZE.1, SIZE.0, |_, _| true);
    assert!(matches!(session.set_mask(4, WALKER, &small), Err(VideoError::MaskSize { .. })));
    let short =
        ObjectPrompt { object: LATE, on_px: Vec::new(), off_px: Vec::new(), box_px: None, belief: Some(vec![1.0; 7]) };
    assert!(matches!(session.prompt(4, &[short]), Err(VideoError::Size { found: 7, .. })));
    session.forget(WALKER);
    assert!(unknown(followed(session.as_mut(), &[WALKER], 4, 7).unwrap_err()));
}
