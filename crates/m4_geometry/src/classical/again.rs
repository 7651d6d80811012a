//! Estimates the cameras a second time, without the tracks in dynamic regions.
//!
//! The first cameras come from tracks of the whole image. Where masks then hold a share of the
//! static tracks, these are excluded and the cameras are estimated again; if their projections
//! change, depth and masks are computed again, too. Otherwise the first result is kept.

use super::dense::DenseFrame;
use super::sparse::{FeatureTracks, Recovered, SparseConfig, SparseError};
use super::{CameraMotion, Motion, SparseReconstruction, Track};
use m4_core::{Mask, Progress, Sim3, median, nalgebra::Vector3};
use std::borrow::Borrow;
use std::collections::HashMap;

/// Changes of what cameras see above this many pixels matter.
const SHIFT_PX: f64 = 0.25;
/// Share of tracks outside the masks whose verdict changes that matters.
const VERDICTS: f64 = 0.03;
/// Share of the static observations of a frame within masks that matters. In four clips whose
/// second cameras projected within 0.002 px of the first, it was 0.004 at most.
const MASKED: f64 = 0.02;
/// Fewest points that both have, in total and per frame.
const POINTS: usize = 30;
const POINTS_A_FRAME: usize = 10;
/// At least this share of the tracks outside masks that were static before must be static by the
/// new cameras.
const STATIC_SHARE: f64 = 0.9;

/// A second estimate of the cameras, and what it is compared with.
pub struct Second<'a> {
    first: &'a SparseReconstruction,
    masks: Vec<&'a Mask>,
}

impl<'a> Second<'a> {
    /// Decides whether other cameras than the `first` are to be expected without the tracks in the
    /// masks of `frames`; `None` if not. `frames` are those with the indices `chosen` (ascending)
    /// of all frames; the mask of the nearest of them holds for the others.
    pub fn of(
        first: &'a SparseReconstruction,
        frames: &'a [DenseFrame],
        chosen: &[usize],
    ) -> Option<Self> {
        let masks: Vec<&Mask> = (0..first.cameras.len())
            .map(|i| &frames[nearest(chosen, i)].mask)
            .collect();
        worth(first, &masks).then_some(Self { first, masks })
    }

    /// Estimates the cameras from the tracks outside the masks; `None` where that fails, or the
    /// camera has no parallax then.
    ///
    /// # Errors
    ///
    /// [`SparseError::Cancelled`] once a stop was requested.
    pub fn estimate(
        &self,
        tracks: &FeatureTracks,
        config: &SparseConfig,
        progress: &dyn Progress,
    ) -> Result<Option<Recovered>, SparseError> {
        match tracks.recover(Some(&self.masks), config, progress) {
            Err(stop @ SparseError::Cancelled) => Err(stop),
            other => Ok(other
                .ok()
                .filter(|r| r.sparse.camera_motion == CameraMotion::Parallax)),
        }
    }

    /// Returns whether depth and masks are to be estimated again with these cameras, and how they
    /// differ from the first.
    pub fn is_better(&self, second: &SparseReconstruction) -> (bool, String) {
        let change = Change::between(self.first, second, |track| within(&self.masks, track));
        let (shift_px, percent) = (change.shift_px, 100.0 * change.verdicts);
        let note = format!(
            "projections differ by {shift_px:.2} px, {percent:.1} % of tracks are classified differently"
        );
        (change.matters(), note)
    }
}

/// Which of `chosen`, rising, is nearest to `frame`.
fn nearest(chosen: &[usize], frame: usize) -> usize {
    let after = chosen
        .partition_point(|&i| i < frame)
        .min(chosen.len().saturating_sub(1));
    let before = after.saturating_sub(1);
    let nearer = chosen[before].abs_diff(frame) <= chosen[after].abs_diff(frame);
    if nearer { before } else { after }
}

/// How a second reconstruction differs from the first.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Change {
    /// The frame that changed most: how far apart the two see the same points, median over them,
    /// pixels; infinite where too few points are in both.
    pub shift_px: f64,
    /// Share of the tracks classified by both, outside the masks, that are static for one and
    /// dynamic for the other.
    pub verdicts: f64,
    /// Static tracks outside the masks of the second, over those of the first.
    pub still_static: f64,
}

impl Change {
    /// Whether depth and masks are to be computed again with the second.
    pub fn matters(&self) -> bool {
        let differs = self.shift_px > SHIFT_PX || self.verdicts > VERDICTS;
        differs && self.still_static >= STATIC_SHARE
    }

    /// Of two reconstructions of the same tracks, where `masked` says which of the second lie
    /// within masks.
    pub fn between(
        first: &SparseReconstruction,
        second: &SparseReconstruction,
        masked: impl Fn(&Track) -> bool,
    ) -> Self {
        let by_start: HashMap<_, &Track> = first
            .tracks
            .iter()
            .filter_map(|t| Some((key(t)?, t)))
            .collect();
        let pairs: Vec<(&Track, &Track)> = second
            .tracks
            .iter()
            .filter(|t| !masked(t))
            .filter_map(|t| Some((*by_start.get(&key(t)?)?, t)))
            .collect();
        let judged = pairs
            .iter()
            .filter(|(a, b)| a.motion != Motion::Unknown && b.motion != Motion::Unknown);
        let changed = judged.clone().filter(|(a, b)| a.motion != b.motion).count();
        let before = pairs
            .iter()
            .filter(|(a, _)| a.motion == Motion::Static)
            .count();
        let after = pairs
            .iter()
            .filter(|(_, b)| b.motion == Motion::Static)
            .count();
        Self {
            shift_px: shift_px(first, second, &pairs),
            verdicts: changed as f64 / judged.count().max(1) as f64,
            still_static: after as f64 / before.max(1) as f64,
        }
    }
}

/// A track by where it begins, in 64ths of a pixel.
fn key(track: &Track) -> Option<(usize, [i64; 2])> {
    let at = track.observations.first()?;
    Some((
        track.first_frame,
        at.map(|v| (f64::from(v) * 64.0).round() as i64),
    ))
}

/// See [`Change::shift_px`]. The two worlds are laid over each other by their points.
fn shift_px(
    first: &SparseReconstruction,
    second: &SparseReconstruction,
    pairs: &[(&Track, &Track)],
) -> f64 {
    let points: Vec<_> = pairs
        .iter()
        .filter_map(|(a, b)| Some((a.point?, b.point?, *b)))
        .collect();
    let all: Vec<usize> = (0..points.len()).collect();
    let fit = |of: &[usize]| -> Option<Sim3> {
        let (to, from): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) =
            of.iter().map(|&i| (points[i].0, points[i].1)).unzip();
        Sim3::umeyama(&from, &to)
    };
    let Some(mut world) = fit(&all).filter(|_| points.len() >= POINTS) else {
        return f64::INFINITY;
    };
    // Far points are uncertain and would turn the world: the better half decides, twice over.
    for _ in 0..2 {
        let off = |i: &usize| (world.transform(&points[*i].1) - points[*i].0).norm();
        let mut order: Vec<(f64, usize)> = all.iter().map(|i| (off(i), *i)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half: Vec<usize> = order[..(order.len() / 2).max(POINTS / 2)]
            .iter()
            .map(|(_, i)| *i)
            .collect();
        if let Some(better) = fit(&half) {
            world = better;
        }
    }
    let mut shifts: Vec<Vec<f64>> = vec![Vec::new(); first.cameras.len()];
    for (_, point, track) in &points {
        let point_in_first = world.transform(point);
        let cameras = first.cameras.iter().zip(&second.cameras).enumerate();
        for (frame, (a, b)) in cameras
            .skip(track.first_frame)
            .take(track.observations.len())
        {
            let ((p, z), (q, w)) = (a.project(&point_in_first), b.project(point));
            shifts[frame].push(if z > 0.0 && w > 0.0 {
                (p[0] - q[0]).hypot(p[1] - q[1])
            } else {
                f64::INFINITY
            });
        }
    }
    let shift_lists = shifts.iter_mut().filter(|s| s.len() >= POINTS_A_FRAME);
    shift_lists.filter_map(|s| median(s)).fold(0.0, f64::max)
}

/// Whether most of a track lies within masks (above 0) of the size of the frames.
fn within(masks: &[impl Borrow<Mask>], track: &Track) -> bool {
    let observations = masks
        .iter()
        .skip(track.first_frame)
        .zip(&track.observations);
    let inside = observations.filter(|(mask, at)| {
        let mask: &Mask = (**mask).borrow();
        let cell = |v: f32, n: usize| ((v + 0.5).max(0.0) as usize).min(n.saturating_sub(1));
        mask[(cell(at[0], mask.width()), cell(at[1], mask.height()))] > 0
    });
    2 * inside.count() >= track.observations.len()
}

/// Whether other cameras are to be expected: there is parallax, masks do not cover everything, and
/// in some frame they hold a share of what the cameras were estimated from.
fn worth(sparse: &SparseReconstruction, masks: &[impl Borrow<Mask>]) -> bool {
    if sparse.camera_motion != CameraMotion::Parallax
        || masks.iter().flat_map(|m| m.borrow().data()).all(|m| *m > 0)
    {
        return false;
    }
    let mut observations = vec![(0usize, 0usize); masks.len()];
    for track in sparse.tracks.iter().filter(|t| t.motion == Motion::Static) {
        let masked = usize::from(within(masks, track));
        for (all, inside) in observations
            .iter_mut()
            .skip(track.first_frame)
            .take(track.observations.len())
        {
            *all += 1;
            *inside += masked;
        }
    }
    observations
        .iter()
        .any(|&(all, inside)| inside as f64 > MASKED * all as f64)
}

#[cfg(test)]
mod tests {
    use super::{Change, within, worth};
    use crate::classical::{CameraMotion, Motion, SparseReconstruction, Track};
    use m4_core::{Camera, CounterRng, Intrinsics, Plane, Se3, exp_so3, nalgebra::Vector3};

    /// A walk past points between 3 and 6 away, every tenth of which moves.
    fn clip() -> SparseReconstruction {
        let mut rng = CounterRng::new(8, 0, 0);
        let camera = |i: usize| Camera {
            intrinsics: Intrinsics::centred(320, 240, 300.0),
            c2w: Se3 {
                rotation: exp_so3(&Vector3::new(0.0, 0.01 * i as f64, 0.0)),
                translation: Vector3::new(0.1 * i as f64, 0.0, 0.0),
            },
        };
        let cameras: Vec<Camera> = (0..12).map(camera).collect();
        let track = |i: usize| {
            let point = Vector3::new(rng.normal(), 0.7 * rng.normal(), 3.0 + 3.0 * rng.uniform());
            let pixels = cameras
                .iter()
                .map(|c| c.project(&point).0.map(|v| v as f32));
            Track {
                first_frame: 0,
                observations: pixels.collect(),
                motion: if i.is_multiple_of(10) {
                    Motion::Dynamic
                } else {
                    Motion::Static
                },
                point: (!i.is_multiple_of(10)).then_some(point),
                residual_px: 0.1,
            }
        };
        SparseReconstruction {
            tracks: (0..200).map(track).collect(),
            cameras,
            camera_motion: CameraMotion::Parallax,
            residual_px: 0.1,
            warnings: Vec::new(),
        }
    }

    fn none(_: &Track) -> bool {
        false
    }

    #[test]
    fn another_world_of_the_same_cameras_is_no_change() {
        let first = clip();
        let mut second = first.clone();
        // Turned, moved and twice as large; tracks in another order.
        let (turn, shift) = (
            exp_so3(&Vector3::new(0.2, -0.4, 0.1)),
            Vector3::new(3.0, 1.0, -2.0),
        );
        for c in &mut second.cameras {
            c.c2w.rotation = turn * c.c2w.rotation;
            c.c2w.translation = turn * c.c2w.translation * 2.0 + shift;
        }
        for x in second.tracks.iter_mut().filter_map(|t| t.point.as_mut()) {
            *x = turn * *x * 2.0 + shift;
        }
        second.tracks.reverse();
        let change = Change::between(&first, &second, none);
        assert!(
            change.shift_px < 1e-6 && change.verdicts == 0.0,
            "{change:?}"
        );
        assert!(!change.matters());
    }

    #[test]
    fn cameras_that_see_otherwise_and_verdicts_that_turn_matter() {
        let first = clip();
        let turned = |rad: f64| {
            let mut second = first.clone();
            second.cameras[6].c2w.rotation *= exp_so3(&Vector3::new(0.0, rad, 0.0));
            Change::between(&first, &second, none)
        };
        // 300 pixels of focal length: 0.15 and 0.6 pixels.
        assert!(!turned(0.0005).matters(), "{:?}", turned(0.0005));
        let change = turned(0.002);
        assert!(
            change.matters() && (change.shift_px - 0.62).abs() < 0.1,
            "{change:?}"
        );

        let verdicts = |n: usize, motion: Motion| {
            let mut second = first.clone();
            let some = second
                .tracks
                .iter_mut()
                .filter(|t| t.motion != motion && t.motion != Motion::Unknown);
            for t in some.take(n) {
                t.motion = motion;
            }
            second
        };
        assert!(!Change::between(&first, &verdicts(4, Motion::Dynamic), none).matters());
        let change = Change::between(&first, &verdicts(10, Motion::Dynamic), none);
        assert!(
            change.matters() && (change.verdicts - 0.05).abs() < 1e-9,
            "{change:?}"
        );
        // What lies within masks does not count ...
        let second = verdicts(10, Motion::Dynamic);
        let masked = |t: &Track| t.motion == Motion::Dynamic;
        assert!(!Change::between(&first, &second, masked).matters());
        // ... and cameras by which far less rests are not taken.
        assert!(!Change::between(&first, &verdicts(40, Motion::Dynamic), none).matters());
        // Nothing in common: another solution altogether.
        let mut other = first.clone();
        for t in &mut other.tracks {
            t.point = None;
        }
        assert!(Change::between(&first, &other, none).matters());
    }

    #[test]
    fn cameras_are_estimated_again_only_where_masks_hold_their_tracks() {
        let clip = clip();
        let half = vec![Plane::from_fn(320, 240, |x, _| if x < 160 { 255 } else { 0 }); 12];
        let inside = clip.tracks.iter().filter(|t| within(&half, t)).count();
        assert!((20..180).contains(&inside), "{inside}");
        assert!(worth(&clip, &half));
        assert!(!worth(&clip, &vec![Plane::filled(320, 240, 0); 12]));
        assert!(!worth(&clip, &vec![Plane::filled(320, 240, 255); 12]));
        // a mask around dynamic tracks alone
        let dynamic = clip
            .tracks
            .iter()
            .find(|t| t.motion == Motion::Dynamic)
            .unwrap();
        let around = |i: usize| {
            let [u, v] = dynamic.observations[i].map(|v| v.round() as usize);
            Plane::from_fn(320, 240, |x, y| if (x, y) == (u, v) { 255 } else { 0 })
        };
        let masks: Vec<_> = (0..12).map(around).collect();
        assert!(within(&masks, dynamic) && !worth(&clip, &masks));
        let turning = SparseReconstruction {
            camera_motion: CameraMotion::RotationOnly,
            ..clip
        };
        assert!(!worth(&turning, &half));
    }
}
