//! From coarse masks to things over time.

use super::coarse::{Around, PERSISTENT_IN, Proposal, prompt, proposals};
use super::coarse::{Coarse, CoarseMasks};
use super::finish::finish;
use super::ledger::{Outline, TrackedObject};
use super::source::{ObjectId, ObjectMask, VideoSession};
use super::{InstanceError, RefineSettings};
use super::{InstanceReport, Rejected, Rejection};
use crate::classical::dense;
use crate::resample::working_size;
use m4_core::{CompactIds, CompactMask, Progress, RgbImage};
use std::collections::BTreeMap;

/// A mask that covers a larger share of the image is of the background. Specification: 0.3 to 0.35.
const MOST_SHARE: f32 = 0.35;
/// Least intersection over union of a mask with the part that it was asked for. Specification: 0.2.
const LEAST_OVERLAP: f32 = 0.2;
/// Things that overlap by more (intersection over union) are one. Specification: 0.7.
pub(super) const MERGE_OVERLAP: f32 = 0.7;
/// How far from coarse pixels the masks may reach of a segmenter that carries them from frame to
/// frame, share of the longest side: such masks spread over what they pass and stick to it. 6 px of
/// 480. Where less than a quarter of a mask is left, it is kept whole within five frames of one
/// where more is, and dropped elsewhere.
const CARRIED_BOUND: f32 = 6.0 / 480.0;
/// Sides below this show too little to work on.
const LEAST_SIDE: usize = 16;
/// What is done, for messages.
const PHASE: &str = "tracking objects";

/// One frame of the result, at the size at which things were followed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RefinedFrame {
    /// Dynamic pixels: every instance, and unexplained coarse parts where these are kept.
    pub mask: CompactMask,
    /// Which thing each pixel shows, 0 for none.
    pub ids: CompactIds,
}

/// Masks over time.
#[derive(Debug, Clone)]
pub struct Refined {
    /// One per frame.
    pub frames: Vec<RefinedFrame>,
    /// What was found.
    pub report: InstanceReport,
}

/// Finds things in coarse masks, follows them through the clip and says where each is; see [the
/// module](super). `open` starts to follow things in `images` with masks of the size that it is
/// given.
///
/// # Errors
///
/// [`InstanceError`].
pub fn refine<'a>(
    images: &[&RgbImage],
    coarse: &Coarse<'_>,
    settings: &RefineSettings,
    open: impl FnOnce((usize, usize)) -> Result<Box<dyn VideoSession + 'a>, InstanceError>,
    progress: &dyn Progress,
) -> Result<Refined, InstanceError> {
    settings.check()?;
    let (frames, full) = (
        images.len(),
        images.first().map_or((0, 0), |image| image.size()),
    );
    if frames == 0 || full.0.min(full.1) < LEAST_SIDE {
        return Err(InstanceError::Input(format!(
            "the clip has {frames} frames of {}x{} pixels; at least one frame of {LEAST_SIDE} px per side is needed",
            full.0, full.1
        )));
    }
    if let Some((frame, image)) = images
        .iter()
        .enumerate()
        .find(|(_, image)| image.size() != full)
    {
        return Err(InstanceError::Input(format!(
            "frame {frame} is {}x{} where {}x{} was expected; all frames must have one size",
            image.width(),
            image.height(),
            full.0,
            full.1
        )));
    }
    coarse.check(frames)?;
    let size = working_size(full.0, full.1, settings.side_px);
    let mut search = Search {
        rough: CoarseMasks {
            coarse,
            size,
            settings,
        },
        frames,
        session: open(size)?,
        things: BTreeMap::new(),
        rejected: Vec::new(),
        next: 0,
        progress,
    };
    search.forwards()?;
    search.backwards()?;
    let Search {
        rough,
        things,
        rejected,
        session,
        ..
    } = search;
    let bound = (!session.remembers()).then_some(CARRIED_BOUND);
    finish(
        &rough,
        frames,
        (session.name(), bound),
        things,
        rejected,
        progress,
    )
}

struct Search<'a, 's> {
    rough: CoarseMasks<'a>,
    frames: usize,
    session: Box<dyn VideoSession + 's>,
    things: BTreeMap<ObjectId, TrackedObject>,
    rejected: Vec<Rejected>,
    next: u32,
    progress: &'a dyn Progress,
}

impl Search<'_, '_> {
    /// Frames at which new things are looked for.
    fn stops(&self) -> Vec<usize> {
        (0..self.frames)
            .step_by(self.rough.settings.every_frames)
            .collect()
    }

    fn forwards(&mut self) -> Result<(), InstanceError> {
        let mut at = 0;
        for stop in self.stops() {
            self.follow(at, stop)?;
            at = stop;
            self.look_for_new(stop)?;
        }
        self.follow(at, self.frames - 1)
    }

    /// One sweep to the beginning; things join it where they were found.
    fn backwards(&mut self) -> Result<(), InstanceError> {
        let mut stops = self.stops();
        while let Some(stop) = stops.pop() {
            if let Some(&before) = stops.last() {
                self.follow(stop, before)?;
            }
        }
        Ok(())
    }

    /// Follows what is known at `from` and not lost.
    fn follow(&mut self, from: usize, to: usize) -> Result<(), InstanceError> {
        if from == to {
            return Ok(());
        }
        if self.progress.cancelled() {
            return Err(InstanceError::Cancelled { phase: PHASE });
        }
        let later = to > from;
        let is_known = |thing: &&TrackedObject| {
            let in_range = if later {
                thing.prompted <= from
            } else {
                thing.prompted >= from
            };
            in_range && !thing.lost[usize::from(!later)]
        };
        let objects: Vec<ObjectId> = self
            .things
            .values()
            .filter(is_known)
            .map(|t| t.object)
            .collect();
        if objects.is_empty() {
            return Ok(());
        }
        let (w, h) = self.rough.size;
        let most_px = (MOST_SHARE * (w * h) as f32) as usize;
        let (things, frames, progress) = (&mut self.things, self.frames, self.progress);
        let way = if later {
            "tracking objects"
        } else {
            "tracking objects backwards"
        };
        let mut sink = |frame: usize, answers: Vec<ObjectMask>| {
            for answer in &answers {
                if let Some(thing) = things.get_mut(&answer.object) {
                    thing.note(frame, answer, later, most_px);
                }
            }
            let done = if later { frame + 1 } else { frames - frame };
            progress.update(way, done, frames, &format!("{} objects", answers.len()));
        };
        self.session.follow(&objects, from, to, progress, &mut sink)
    }

    /// Makes things of the coarse parts of a frame that no thing covers.
    fn look_for_new(&mut self, frame: usize) -> Result<(), InstanceError> {
        let (w, h) = self.rough.size;
        let around = Around::of(&self.rough, frame, self.frames);
        let mut covered = vec![0u8; w * h];
        for mask in self
            .things
            .values()
            .filter_map(|thing| thing.masks.get(&frame))
        {
            for (x, y) in mask.pixels() {
                covered[y * w + x] = 255;
            }
        }
        let mut asked = Vec::new();
        for proposal in proposals(&self.rough, &around, &covered) {
            if proposal.seen_in < PERSISTENT_IN {
                let seen_in = proposal.seen_in;
                self.refuse(frame, &proposal, Rejection::Flicker { seen_in });
            } else if self.things.len() + asked.len() >= usize::from(u16::MAX) {
                self.refuse(frame, &proposal, Rejection::TooMany);
            } else {
                asked.push((ObjectId(self.next), proposal));
                self.next += 1;
            }
        }
        if asked.is_empty() {
            return Ok(());
        }
        let prompts: Vec<_> = asked
            .iter()
            .map(|(object, part)| prompt(*object, &part.outline, &around.here, (w, h)))
            .collect();
        let answers = self.session.prompt(frame, &prompts)?;
        for ((object, part), answer) in asked.into_iter().zip(&answers) {
            self.judge(frame, object, &part, answer)?;
        }
        Ok(())
    }

    /// Takes the mask of a part for a thing, or refuses it.
    fn judge(
        &mut self,
        frame: usize,
        object: ObjectId,
        part: &Proposal,
        answer: &ObjectMask,
    ) -> Result<(), InstanceError> {
        let (w, h) = self.rough.size;
        let Some(outline) = Outline::of(&answer.mask) else {
            self.drop(frame, object, part, Rejection::Nothing);
            return Ok(());
        };
        let share = outline.area() as f32 / (w * h) as f32;
        let overlap = outline.overlap(&part.outline);
        if share > MOST_SHARE {
            self.drop(frame, object, part, Rejection::TooLarge { share });
            return Ok(());
        }
        if overlap < LEAST_OVERLAP {
            self.drop(frame, object, part, Rejection::Elsewhere { overlap });
            return Ok(());
        }
        // Below this overlap the thing starts with the outline of the coarse part; maps of motion
        // are too coarse to have one.
        let least = match self.rough.coarse {
            Coarse::Motion(_) => 0.0,
            Coarse::Masks(_) => dense::LEAST_OVERLAP,
        };
        let coarse_outline = overlap < least;
        let outline = if coarse_outline {
            part.outline.clone()
        } else {
            outline
        };
        let mut masks = self
            .things
            .values()
            .filter_map(|thing| thing.masks.get(&frame));
        if masks.any(|mask| mask.overlap(&outline) > MERGE_OVERLAP) {
            self.drop(frame, object, part, Rejection::Duplicate);
            return Ok(());
        }
        if coarse_outline {
            let mask = CompactMask::from_fn(w, h, |x, y| outline.at(x, y));
            self.session.set_mask(frame, object, &mask)?;
        }
        let thing = TrackedObject {
            object,
            prompted: frame,
            part_area: part.outline.area(),
            part_centre_px: part.outline.centre_px(),
            masks: BTreeMap::from([(frame, outline)]),
            lost: [false; 2],
        };
        self.things.insert(object, thing);
        Ok(())
    }

    fn drop(&mut self, frame: usize, object: ObjectId, part: &Proposal, reason: Rejection) {
        self.session.forget(object);
        self.refuse(frame, part, reason);
    }

    fn refuse(&mut self, frame: usize, part: &Proposal, reason: Rejection) {
        let (w, h) = self.rough.size;
        self.rejected.push(Rejected {
            frame,
            area_share: part.outline.area() as f64 / (w * h).max(1) as f64,
            centre_px: part.outline.centre_px(),
            reason,
        });
    }
}
