//! How far a descent is, and what is kept of it: every few seconds and when the user asks to stop.
//!
//! ```text
//! descent-begun-FRAME     disparity at the beginning of the second stage
//! descent-SLOT-FRAME      variables and moments, in two slots in turn
//! descent                 which slot, stage and step: written last, so it never names a slot that is half written
//! ```

use super::fast::{Descent, FrameState, Moves};
use m4_core::{Cache, load, store};
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

/// Time between two saves: one writes 24 bytes a pixel of every frame.
const EVERY: Duration = Duration::from_secs(15);
const COURSE: &str = "descent";

/// How far a descent is.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Course {
    /// Which of the two stages: 0 or 1.
    pub stage: usize,
    /// Steps of it that are done.
    pub step: usize,
    /// Scale and shift of each frame, once the first stage is done.
    pub affine: Vec<(f64, f64)>,
    /// Loss before each step, of both stages.
    pub losses: [Vec<f64>; 2],
    slot: usize,
}

/// Where a descent is kept.
pub(super) struct RecordingObserver<'a> {
    cache: &'a dyn Cache,
    saved: Instant,
}

fn begun(frame: usize) -> String {
    format!("{COURSE}-begun-{frame:05}")
}

fn state(slot: usize, frame: usize) -> String {
    format!("{COURSE}-{slot}-{frame:05}")
}

impl<'a> RecordingObserver<'a> {
    pub fn new(cache: &'a dyn Cache) -> Self {
        Self {
            cache,
            saved: Instant::now(),
        }
    }

    /// How far the kept descent was, with `descent` brought there; `None` where none was kept whole.
    pub fn resume(&self, descent: &mut Descent<'_>, stages: &[Moves]) -> Option<Course> {
        let course: Course = load(self.cache, COURSE)?;
        let moves = *stages.get(course.stage)?;
        let frames = 0..descent.frames();
        let begun: Option<Vec<Vec<f32>>> = frames.clone().map(|i| load(self.cache, &begun(i))).collect();
        let states: Option<Vec<FrameState>> = frames.map(|i| load(self.cache, &state(course.slot, i))).collect();
        let begun = match moves {
            Moves::Affine => None,
            Moves::Pixels => Some(begun?),
        };
        descent.restore(begun, states?, moves).then_some(course)
    }

    /// Keeps where the second stage begins.
    pub fn second_stage(&self, descent: &Descent<'_>) {
        for (i, disparity) in descent.raw_disparity().enumerate() {
            store(self.cache, &begun(i), disparity);
        }
    }

    /// Whether it is time to save again.
    pub fn due(&self) -> bool {
        self.saved.elapsed() >= EVERY
    }

    /// Keeps where the descent is.
    pub fn save(&mut self, course: &mut Course, descent: &Descent<'_>) {
        course.slot = 1 - course.slot.min(1);
        for (i, frame) in descent.states().enumerate() {
            store(self.cache, &state(course.slot, i), &frame);
        }
        store(self.cache, COURSE, course);
        self.saved = Instant::now();
    }
}
