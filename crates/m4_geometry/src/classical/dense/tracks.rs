//! Points of dynamic parts followed along the flow and lifted with their depth.
//!
//! ```text
//! grid of dynamic pixels without a track -> chain forward and backward -> depth of each place -> world
//!                                    cut at jumps, smoothed -> carried on where hidden (`fill`) -> Tracks
//! ```
//!
//! docs/spec/front-end.md 7.1, item 8 ("3D tracks by flow chaining + lifting"), which is the
//! substitute of its section 3 for a network that tracks: [`crate::tracks`] with the flow and the
//! depth that this stage has anyway. A chain ends where the flow does not lead back, where it
//! leaves the image and where it leaves the masks; from there the point goes on with its
//! neighbours.
//!
//! Pixels here are those of the working size, with the centre of the first one at 0, 0, as
//! [`m4_core::Camera::unproject`] has them.

use super::sources::DenseError;
use super::working::WorkingClip;
use crate::flow::FlowPair;
use crate::tracks::{
    QueryGrid, Sparse, Strip, TrackError, TrackInputs, board_of, fill, followed, on_grid,
    sparse_flow,
};
use m4_core::{Plane, Progress, Tracks};

/// Tracks of everything that moves; `None` if nothing could be followed.
pub(super) fn tracks(
    clip: &WorkingClip<'_>,
    grid: &QueryGrid,
    progress: &dyn Progress,
) -> Result<Option<Tracks>, DenseError> {
    let strip = strip(clip);
    let pieces = on_grid(&strip, grid);
    if pieces.is_empty() {
        return Ok(None);
    }
    let mut board = board_of(clip.dynamic.len(), &pieces);
    let surface = |i: usize| {
        let depth = |x: usize, y: usize| 1.0 / clip.disparity[i][y * clip.width + x];
        Ok(Plane::from_fn(clip.width, clip.height, depth))
    };
    fill(
        &TrackInputs {
            strip: &strip,
            surface: &surface,
        },
        &mut board,
        progress,
    )
    .map_err(|e| match e {
        TrackError::Cancelled { phase } => DenseError::Cancelled { phase },
        other => DenseError::Tracks(other),
    })?;
    Ok(Some(followed(board)?))
}

/// What is kept of the clip.
fn strip(clip: &WorkingClip<'_>) -> Strip {
    let (w, h) = (clip.width, clip.height);
    let moves = |frame: usize, i: usize| clip.dynamic[frame][i] > 0;
    let dynamic =
        |frame: usize| Sparse::new(w, h, |i| moves(frame, i).then(|| clip.disparity[frame][i]));
    let forward = |(t, pair): (usize, &FlowPair)| sparse_flow(pair.there(), |i| moves(t, i));
    let backward = |(t, pair): (usize, &FlowPair)| sparse_flow(pair.back(), |i| moves(t + 1, i));
    Strip {
        width: w,
        height: h,
        cameras: clip.cameras.to_vec(),
        dynamic: (0..clip.dynamic.len()).map(dynamic).collect(),
        forward: clip.flows.iter().enumerate().map(forward).collect(),
        backward: clip.flows.iter().enumerate().map(backward).collect(),
    }
}

#[cfg(test)]
mod tests {
    //! A square that flies past a moving camera, with the flow that it makes.

    use super::{FlowPair, WorkingClip, board_of, followed, on_grid, strip};
    use crate::classical::dense::working::ClipData;
    use crate::tracks::QueryGrid;
    use m4_core::{Camera, CounterRng, Flow, Intrinsics, Se3, Silent, Tracks};
    use nalgebra::Vector3;

    const W: usize = 96;
    const H: usize = 64;
    const FRAMES: usize = 16;
    /// World units per frame.
    const VELOCITY: [f64; 3] = [0.03, -0.012, 0.025];

    /// Chains alone.
    fn chains(clip: &ClipData) -> Tracks {
        let pieces = on_grid(&strip(&clip.clip()), &QueryGrid::chains());
        followed(board_of(FRAMES, &pieces)).unwrap()
    }

    fn depth(t: usize) -> f64 {
        2.0 + VELOCITY[2] * t as f64
    }

    /// A square of side 0.7, its disparity off by `noise` of itself, a factor per frame.
    fn clip_data(noise: f64) -> ClipData {
        let mut rng = CounterRng::new(7, 1, 0);
        let mut cameras = Vec::new();
        let (mut dynamic, mut disparity) = (Vec::new(), Vec::new());
        for t in 0..FRAMES {
            let mut c2w = Se3::identity();
            c2w.translation = Vector3::new(0.02 * t as f64, 0.01 * t as f64, 0.0);
            let camera = Camera {
                intrinsics: Intrinsics::centred(W, H, 90.0),
                c2w,
            };
            let factor = 1.0 + noise * (2.0 * rng.uniform() - 1.0);
            let on = |i: usize| {
                let p = camera.unproject((i % W) as f64, (i / W) as f64, depth(t));
                let (x, y) = (p.x - VELOCITY[0] * t as f64, p.y - VELOCITY[1] * t as f64);
                (x + 0.1).abs() < 0.35 && y.abs() < 0.35
            };
            dynamic.push((0..W * H).map(|i| if on(i) { 255 } else { 0 }).collect());
            let d = |i: usize| {
                if on(i) {
                    (factor / depth(t)) as f32
                } else {
                    0.1
                }
            };
            disparity.push((0..W * H).map(d).collect());
            cameras.push(camera);
        }
        let flow = |from: usize, to: usize| {
            let mut flow = Flow::zero(W, H);
            let step = to as f64 - from as f64;
            for i in 0..W * H {
                let p = cameras[from].unproject((i % W) as f64, (i / W) as f64, depth(from));
                let ([u, v], _) = cameras[to].project(&(p + step * Vector3::from(VELOCITY)));
                flow.u[i] = (u - (i % W) as f64) as f32;
                flow.v[i] = (v - (i / W) as f64) as f32;
            }
            flow
        };
        let flows = (0..FRAMES - 1)
            .map(|t| FlowPair {
                forward: flow(t, t + 1),
                backward: flow(t + 1, t),
            })
            .collect();
        ClipData {
            size: (W, H),
            cameras,
            dynamic,
            disparity,
            flows,
        }
    }

    /// Differences to the true velocity over its length, of all steps.
    fn errors(tracks: &Tracks) -> Vec<f64> {
        let truth = Vector3::from(VELOCITY);
        let mut out = Vec::new();
        for k in 0..tracks.count() {
            for t in 1..tracks.frames() - 1 {
                if let (Some(a), Some(b)) = (tracks.place(t - 1, k), tracks.place(t + 1, k)) {
                    let v =
                        (Vector3::from(b.map(f64::from)) - Vector3::from(a.map(f64::from))) / 2.0;
                    out.push((v - truth).norm() / truth.norm());
                }
            }
        }
        out.sort_by(f64::total_cmp);
        out
    }

    #[test]
    fn a_square_that_flies_is_followed_with_its_velocity() {
        let tracks = chains(&clip_data(0.0));
        assert!(tracks.count() > 40, "{}", tracks.count());
        let errors = errors(&tracks);
        assert!(errors.len() > 400, "{}", errors.len());
        assert!(errors[errors.len() - 1] < 0.01, "{:?}", errors.last());
        // on the surface, in the world
        for (t, k) in (0..FRAMES).flat_map(|t| (0..tracks.count()).map(move |k| (t, k))) {
            assert!(
                tracks
                    .place(t, k)
                    .is_none_or(|p| (f64::from(p[2]) - depth(t)).abs() < 1e-3)
            );
        }
        assert_eq!(tracks.frames(), FRAMES);
    }

    #[test]
    fn depth_that_trembles_is_smoothed_along_the_track() {
        // The depth of one frame is off by up to half of what the square moves; without smoothing,
        // so are its steps by more than 0.1.
        let errors = errors(&chains(&clip_data(0.01)));
        let smooth = errors[errors.len() / 2];
        assert!(smooth < 0.08, "{smooth}");
    }

    /// The number of tracks that have a place in all of `frames`.
    fn count_complete(tracks: &Tracks, frames: &[usize]) -> usize {
        let is_complete = |k: &usize| frames.iter().all(|&t| tracks.place(t, *k).is_some());
        (0..tracks.count()).filter(is_complete).count()
    }

    #[test]
    fn chains_end_where_flow_does_not_lead_back_at_a_jump_of_depth_and_outside_the_mask() {
        let mut cut = clip_data(0.0);
        cut.flows[7].forward.u.fill(f32::INFINITY);
        cut.flows[7].backward.u.fill(f32::INFINITY);
        let mut jumping = clip_data(0.0);
        jumping.disparity[8..]
            .iter_mut()
            .flatten()
            .for_each(|d| *d *= 0.7);
        for (what, clip) in [("flow", cut), ("depth", jumping)] {
            let tracks = chains(&clip);
            assert_eq!(count_complete(&tracks, &[7, 8]), 0, "{what}");
            assert!(
                count_complete(&tracks, &[7]) > 0 && count_complete(&tracks, &[8]) > 0,
                "{what}"
            );
            let errors = errors(&tracks);
            assert!(
                errors[errors.len() / 2] < 0.5,
                "{what}: the parts before and after move on as before"
            );
        }
        let mut masked = clip_data(0.0);
        masked.dynamic[5..9]
            .iter_mut()
            .flatten()
            .for_each(|m| *m = 0);
        let tracks = chains(&masked);
        assert!(
            (5..9).all(|t| count_complete(&tracks, &[t]) == 0) && count_complete(&tracks, &[9]) > 0
        );
    }

    #[test]
    fn empty_masks_have_no_tracks_and_dense_ones_are_thinned() {
        let mut still = clip_data(0.0);
        still.dynamic.iter_mut().for_each(|m| m.fill(0));
        let grid = QueryGrid {
            most: 10,
            ..QueryGrid::chains()
        };
        let few = |clip: &WorkingClip<'_>| super::tracks(clip, &grid, &Silent).unwrap();
        assert_eq!(few(&still.clip()), None);
        let mut clip = clip_data(0.0);
        assert_eq!(few(&clip.clip()).unwrap().count(), 10);
        clip.flows.clear();
        assert_eq!(few(&clip.clip()), None, "no flow, nothing to follow");
    }
}
