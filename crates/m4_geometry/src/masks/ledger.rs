//! Things and where they were seen.

use super::outline::Outline;
use super::report::{Ending, InstanceRecord};
use super::source::{ObjectId, ObjectMask, Visibility};
use std::collections::BTreeMap;

/// A mask that grows by more than this from one frame to the next and covers too much has become background.
const LEAP: usize = 2;

/// One object.
pub(super) struct TrackedObject {
    pub object: ObjectId,
    pub prompted: usize,
    pub overlap: f32,
    pub quality: Option<f32>,
    pub coarse_outline: bool,
    /// The coarse part that it was asked for.
    pub part_area: usize,
    pub part_centre_px: [f32; 2],
    /// By frame.
    pub masks: BTreeMap<usize, Outline>,
    pub overgrown: usize,
    /// Whether it is lost for good towards the end, towards the beginning.
    pub lost: [bool; 2],
    pub found_again: Vec<usize>,
}

impl TrackedObject {
    /// Notes how it is seen in a frame, going on in a direction; `most_px` is the area beyond which a sudden growth is background.
    pub fn note(&mut self, frame: usize, found: &ObjectMask, later: bool, most_px: usize) {
        if found.visibility == Visibility::Lost {
            self.lost[usize::from(!later)] = true;
        }
        let Some(outline) = Outline::of(&found.mask) else {
            return;
        };
        let near = if later {
            self.masks.range(..frame).next_back()
        } else {
            self.masks.range(frame + 1..).next()
        };
        let before = near.map_or(usize::MAX, |(_, mask)| mask.area());
        if outline.area() > most_px && outline.area() / LEAP > before {
            self.overgrown += 1;
            return;
        }
        self.masks.insert(frame, outline);
    }

    /// Half of the frames that both are seen in, they overlap by more than `least`.
    pub fn is_also(&self, other: &Self, least: f32) -> bool {
        let common = self
            .masks
            .iter()
            .filter_map(|(frame, a)| Some((a, other.masks.get(frame)?)));
        let (mut same, mut all) = (0usize, 0usize);
        for (a, b) in common {
            all += 1;
            same += usize::from(a.overlap(b) > least);
        }
        all > 0 && 2 * same > all
    }

    /// Takes over what another is, which turned out to be the same.
    pub fn absorb(&mut self, other: Self, size: (usize, usize)) {
        let last = |masks: &BTreeMap<usize, Outline>| masks.keys().next_back().copied();
        if last(&other.masks) > last(&self.masks) {
            self.lost[0] = other.lost[0];
        }
        for (frame, mask) in other.masks {
            let mask = match self.masks.get(&frame) {
                Some(own) => own.with(&mask, size),
                None => mask,
            };
            self.masks.insert(frame, mask);
        }
        self.found_again.push(other.prompted);
        self.found_again.extend(other.found_again);
        self.found_again.sort_unstable();
        self.overgrown += other.overgrown;
    }

    /// What the report says of it; `None` if no frame shows it.
    pub fn record(&self, id: u16, supported_share: f64, pixels: usize, frames: usize) -> Option<InstanceRecord> {
        let (&first_frame, _) = self.masks.first_key_value()?;
        let (&last_frame, _) = self.masks.last_key_value()?;
        let share = |area: usize| area as f64 / pixels.max(1) as f64;
        let areas = self.masks.values().map(Outline::area);
        let ending = match (last_frame + 1 == frames, self.lost[0]) {
            (true, _) => Ending::ClipEnd,
            (false, true) => Ending::Lost { frame: last_frame + 1 },
            (false, false) => Ending::Unseen { frame: last_frame + 1 },
        };
        Some(InstanceRecord {
            id,
            first_frame,
            last_frame,
            frames: self.masks.len(),
            mean_area_share: share(areas.clone().sum()) / self.masks.len() as f64,
            max_area_share: share(areas.max().unwrap_or(0)),
            prompted_frame: self.prompted,
            prompt_overlap: self.overlap,
            prompt_quality: self.quality,
            coarse_outline: self.coarse_outline,
            supported_share,
            overgrown_frames: self.overgrown,
            ending,
            found_again: self.found_again.clone(),
        })
    }
}
