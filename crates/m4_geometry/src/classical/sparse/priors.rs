//! What the caller provides of a clip: masks, lenses and the focal length.

use super::distortion::RadialDistortion;
use super::luma::WorkingSize;
use super::tracking::RawTrack;
use crate::classical::SparseReconstruction;
use m4_core::{Intrinsics, Mask};

/// Where the focal length comes from.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum FocalSource {
    /// The caller gave it.
    Given,
    /// The clip revealed it.
    Estimated {
        /// Standard deviation of its logarithm, from the curvature of bundle adjustment and the
        /// size of the residuals; `None` for a camera that only turns.
        sigma: Option<f64>,
    },
    /// The clip says nothing about it: a usual one was taken.
    Assumed,
}

/// A reconstruction and how far its focal length is known.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Recovered {
    /// Cameras, tracks and points.
    pub sparse: SparseReconstruction,
    /// Where the focal length comes from.
    pub focal: FocalSource,
    /// Distortion of the lens that the clip shows; cameras and tracks are those of images without
    /// it. `None` where a pinhole explains the clip as well.
    pub distortion: Option<RadialDistortion>,
    /// True where two rigid worlds explain the clip about equally well: the cameras may follow a
    /// moving object.
    pub tied: bool,
}

/// Share of its observations within masks from which on a track counts as dynamic.
const MASKED_SHARE: f64 = 0.5;

/// Separates the tracks that count from those in masks.
pub(super) fn part(
    masks: Option<&[&Mask]>,
    tracks: Vec<RawTrack>,
    size: WorkingSize,
) -> (Vec<RawTrack>, Vec<RawTrack>) {
    let Some(masks) = masks else {
        return (tracks, Vec::new());
    };
    let covered = |mask: &Mask, at: [f64; 2]| {
        let [x, y] = size.share(at);
        let cell =
            |share: f64, n: usize| ((share * n as f64).max(0.0) as usize).min(n.saturating_sub(1));
        let (w, h) = mask.size();
        w > 0 && h > 0 && mask[(cell(x, w), cell(y, h))] > 0
    };
    tracks.into_iter().partition(|track| {
        let observations = (track.first..).zip(&track.seen);
        let inside = observations
            .filter(|(frame, at)| masks.get(*frame).is_some_and(|mask| covered(mask, **at)));
        (inside.count() as f64) < MASKED_SHARE * track.seen.len() as f64
    })
}

/// Which lens saw a frame. Tracks are kept as a lens with one focal length, square pixels and its
/// principal point in the centre would have seen them; known lenses are undone on the way in and
/// done again on the way out. Empty where no lens is known; one for all frames, or one per frame.
#[derive(Debug, Clone)]
pub(super) struct Lenses(pub Vec<Intrinsics>);

impl Lenses {
    /// The lens of a frame, where it is known.
    pub fn of(&self, frame: usize) -> Option<Intrinsics> {
        self.0.get(frame).or(self.0.last()).copied()
    }

    /// Moves observations to where the lens of `focal` working pixels has them.
    pub fn undo(&self, tracks: &mut [RawTrack], size: WorkingSize, focal: f64) {
        for track in tracks {
            for (frame, at) in track.positions_mut() {
                if let Some(k) = self.of(frame) {
                    let [u, v] = size.to_corner(*at);
                    *at = [focal * (u - k.cx) / k.fx, focal * (v - k.cy) / k.fy];
                }
            }
        }
    }

    /// Input pixels (centre of the first pixel: 0, 0) of an observation that was moved by
    /// [`Self::undo`].
    pub fn input_px(&self, frame: usize, at: [f64; 2], size: WorkingSize, focal: f64) -> [f32; 2] {
        match self.of(frame) {
            None => size.to_input(at),
            Some(k) => [
                (at[0] / focal * k.fx + k.cx - 0.5) as f32,
                (at[1] / focal * k.fy + k.cy - 0.5) as f32,
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Lenses, part};
    use crate::classical::sparse::luma::WorkingSize;
    use crate::classical::sparse::tracking::RawTrack;
    use m4_core::{Intrinsics, Plane};

    #[test]
    fn tracks_within_masks_are_separated() {
        let size = WorkingSize::new(200, 100, 100);
        let track = |x: f64| RawTrack {
            first: 1,
            seen: vec![[x, 0.0]; 3],
            again: Vec::new(),
        };
        // the right half of frames 1 and 2, nothing in frame 3
        let half = Plane::from_fn(20, 10, |x, _| u8::from(x >= 10));
        let masks = [
            Plane::filled(20, 10, 255),
            half.clone(),
            half,
            Plane::filled(20, 10, 0),
        ];
        let (unmasked, masked) = part(
            Some(&masks.each_ref()),
            vec![track(-20.0), track(20.0)],
            size,
        );
        assert_eq!((unmasked, masked), (vec![track(-20.0)], vec![track(20.0)]));
        let (unmasked, masked) = part(None, vec![track(20.0)], size);
        assert_eq!((unmasked.len(), masked.len()), (1, 0));
    }

    #[test]
    fn a_lens_is_undone_and_done_again() {
        let size = WorkingSize::new(640, 480, 320);
        let lens = Intrinsics {
            width: 640,
            height: 480,
            fx: 500.0,
            fy: 520.0,
            cx: 300.0,
            cy: 250.0,
        };
        let lenses = Lenses(vec![lens]);
        // a ray through input pixel (400, 100)
        let before = size.centred([199.75, 49.75]);
        let mut tracks = [RawTrack {
            first: 0,
            seen: vec![before],
            again: Vec::new(),
        }];
        lenses.undo(&mut tracks, size, 255.0);
        let at = tracks[0].seen[0];
        assert!(
            (at[0] - 255.0 * (400.5 - 300.0) / 500.0).abs() < 1e-9,
            "{at:?}"
        );
        assert!(
            (at[1] - 255.0 * (100.5 - 250.0) / 520.0).abs() < 1e-9,
            "{at:?}"
        );
        let [u, v] = lenses.input_px(0, at, size, 255.0);
        assert!(
            (u - 400.0).abs() < 1e-3 && (v - 100.0).abs() < 1e-3,
            "{u} {v}"
        );
    }
}
