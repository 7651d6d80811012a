//! Cameras and points that grow from a pair of frames, and which tracks move, judged by how badly a
//! static point explains them.

use super::INLIER_PX;
use super::bundle::{Bundle, BundleOptions, BundleReport, Observation};
use super::lens::Bend;
use super::rotation::{Limits, ray, spread};
use super::tracking::RawTrack;
use super::triangulate::{Ray, Sighting, descend, error_px, resect, triangulate};
use crate::classical::Motion;
use m4_core::nalgebra::Vector3;
use m4_core::{Progress, Se3, exp_so3, log_so3, median};
use rayon::prelude::*;

#[derive(Debug, Clone)]
pub(crate) struct Map {
    /// Focal length, working pixels.
    pub focal: f64,
    /// What the lens bends beyond what was taken out of the tracks.
    pub bend: Bend,
    /// World to camera, per frame.
    pub poses: Vec<Option<Se3<f64>>>,
    /// World position, per track.
    pub points: Vec<Option<Vector3<f64>>>,
    /// Whether sightings after the end of a track count: once they are verified.
    pub loops_closed: bool,
    /// What the squared residuals of a track count in the adjustment; 1 until [`Map::weigh`].
    weights: Vec<f64>,
}

impl Map {
    /// Without points.
    pub fn new(focal: f64, poses: Vec<Option<Se3<f64>>>, tracks: &[RawTrack]) -> Self {
        Self {
            focal,
            bend: Bend::NONE,
            poses,
            points: vec![None; tracks.len()],
            loops_closed: false,
            weights: vec![1.0; tracks.len()],
        }
    }

    /// Sightings of known points in `frame`.
    pub fn sightings(&self, tracks: &[RawTrack], frame: usize) -> Vec<Sighting> {
        let pairs = tracks.iter().zip(&self.points);
        pairs
            .filter_map(|(t, x)| Some(((*x)?, t.at(frame)?)))
            .collect()
    }

    /// The rays of a track from cameras with a pose.
    pub fn views(&self, track: &RawTrack) -> Vec<Ray> {
        (track.first..track.end())
            .filter_map(|frame| Some((self.poses[frame]?, track.at(frame)?)))
            .collect()
    }

    /// Sightings after the end of a track, where these count.
    fn again(&self, track: &RawTrack) -> impl Iterator<Item = (usize, [f64; 2])> {
        let again = if self.loops_closed {
            &*track.again
        } else {
            &[]
        };
        again.iter().copied()
    }

    pub fn registered(&self) -> usize {
        self.poses.iter().flatten().count()
    }

    /// Triangulates every track that is not dynamic (`motions`, empty while none is judged),
    /// forgets the points of all others and of those whose rays are too parallel or disagree.
    pub fn triangulate(&mut self, tracks: &[RawTrack], motions: &[Motion], limits: &Limits) {
        let point = |(i, track)| {
            let usable = motions.get(i) != Some(&Motion::Dynamic);
            let triangulation =
                usable.then(|| triangulate(&self.views(track), self.focal, limits.cauchy_px))??;
            let good = triangulation.angle_rad >= limits.min_angle_deg.to_radians()
                && triangulation.median_px <= INLIER_PX;
            good.then_some(triangulation.point)
        };
        self.points = tracks.par_iter().enumerate().map(point).collect();
    }

    /// Gives `frame` a pose, starting from that of the nearest frames that have one; false when too
    /// few points agree.
    pub fn register(&mut self, tracks: &[RawTrack], frame: usize) -> bool {
        let sightings = self.sightings(tracks, frame);
        let candidates = self
            .starts(frame)
            .into_iter()
            .map(|start| resect(&sightings, self.focal, &start));
        // The first of those with most inliers.
        let best = candidates.reduce(|best, other| if other.1 > best.1 { other } else { best });
        let pose = best
            .filter(|&(_, n)| n >= MIN_SIGHTINGS && 3 * n >= sightings.len())
            .map(|(pose, _)| pose);
        self.poses[frame] = pose.or(self.poses[frame]);
        pose.is_some()
    }

    /// Poses to start from: interpolated or carried on, and that of the nearest frame.
    pub fn starts(&self, frame: usize) -> Vec<Se3<f64>> {
        let before = (0..frame).rev().find_map(|i| Some((i, self.poses[i]?)));
        let after = (frame + 1..self.poses.len()).find_map(|i| Some((i, self.poses[i]?)));
        match (before, after) {
            (Some((i, a)), Some((j, b))) => {
                let near = if frame - i <= j - frame { a } else { b };
                vec![
                    interpolate(&a, &b, (frame - i) as f64 / (j - i) as f64),
                    near,
                ]
            }
            (Some((_, a)), None) | (None, Some((_, a))) => vec![a],
            (None, None) => Vec::new(),
        }
    }

    /// Adjusts all poses and points, and the focal length if `free_focal`.
    ///
    /// Of a long clip every n-th frame is adjusted with the points, and the frames that show
    /// earlier points again; the frames between follow the points, and points that hardly any of
    /// the adjusted frames sees are triangulated anew. All frames at once would take work that
    /// grows with the square of the length of tracks.
    ///
    /// It ends early when the user asks to stop; what is found then is not to be used.
    pub fn adjust(
        &mut self,
        tracks: &[RawTrack],
        options: &BundleOptions,
        progress: &dyn Progress,
    ) -> BundleReport {
        let all: Vec<usize> = (0..self.poses.len())
            .filter(|&i| self.poses[i].is_some())
            .collect();
        if all.len() <= MOST_FRAMES {
            return self.adjust_frames(tracks, &all, options, progress);
        }
        let mut some: Vec<usize> = spread(all.len(), MOST_FRAMES)
            .iter()
            .map(|&k| all[k])
            .collect();
        let again = tracks.iter().flat_map(|t| self.again(t));
        some.extend(again.map(|(i, _)| i).filter(|&i| self.poses[i].is_some()));
        some.sort_unstable();
        some.dedup();
        let mut adjusted = self.clone();
        let inside = |t: &RawTrack| {
            let from = some.partition_point(|&i| i < t.first);
            some[from..].iter().take_while(|&&i| i < t.end()).count() >= LEAST_VIEWS
        };
        let held: Vec<bool> = tracks.iter().map(inside).collect();
        for (point, held) in adjusted.points.iter_mut().zip(&held) {
            *point = point.filter(|_| *held);
        }
        let report = adjusted.adjust_frames(tracks, &some, options, progress);
        adjusted.follow_points(tracks, &all, &some, options.cauchy_px);
        let views = |i: usize| adjusted.views(&tracks[i]);
        let anew: Vec<Option<Vector3<f64>>> = (0..tracks.len())
            .into_par_iter()
            .map(|i| match self.points[i] {
                Some(_) if !held[i] => {
                    triangulate(&views(i), adjusted.focal, options.cauchy_px).map(|t| t.point)
                }
                _ => adjusted.points[i],
            })
            .collect();
        adjusted.points = anew;
        *self = adjusted;
        report
    }

    /// Weighs the tracks by their own noise: the variance of a track's residuals, held to the
    /// median of all by [`PRIOR`]. What makes one track worse than others (two surfaces in a patch,
    /// reflections) is alike in all its frames, which no loss of single residuals sees.
    pub fn weigh(&mut self, tracks: &[RawTrack]) {
        // Sum of squared residuals and degrees of freedom: two numbers per view, less the three of
        // the point.
        let spread = |(track, point): (&RawTrack, &Option<Vector3<f64>>)| {
            let errors = self.errors(track, point.as_ref()?);
            let freedom = (2 * errors.len()).checked_sub(3).filter(|n| *n > 0)? as f64;
            Some((
                errors.iter().map(|e| e.min(INLIER_PX).powi(2)).sum::<f64>(),
                freedom,
            ))
        };
        let spreads: Vec<Option<(f64, f64)>> =
            tracks.iter().zip(&self.points).map(spread).collect();
        let mut variances: Vec<f64> = spreads
            .iter()
            .flatten()
            .map(|(sum, freedom)| sum / freedom)
            .collect();
        let Some(typical) = median(&mut variances).filter(|v| *v > 0.0) else {
            return;
        };
        let weight = |(sum, freedom)| typical * (PRIOR + freedom) / (PRIOR * typical + sum);
        self.weights = spreads.into_iter().map(|s| s.map_or(1.0, weight)).collect();
    }

    /// Gives the frames of `all` that are not among `adjusted` the poses that the points ask for.
    fn follow_points(
        &mut self,
        tracks: &[RawTrack],
        all: &[usize],
        adjusted: &[usize],
        cauchy_px: f64,
    ) {
        let map = &*self;
        let poses: Vec<(usize, Se3<f64>)> = all
            .par_iter()
            .filter(|i| adjusted.binary_search(i).is_err())
            .filter_map(|&i| {
                let sightings = map.sightings(tracks, i);
                let start = map.poses[i].filter(|_| sightings.len() >= MIN_SIGHTINGS)?;
                Some((i, descend(&sightings, map.focal, &start, cauchy_px)))
            })
            .collect();
        for (i, pose) in poses {
            self.poses[i] = Some(pose);
        }
    }

    /// Adjusts `frames`, which have poses, and the points that they see.
    fn adjust_frames(
        &mut self,
        tracks: &[RawTrack],
        frames: &[usize],
        options: &BundleOptions,
        progress: &dyn Progress,
    ) -> BundleReport {
        let mut index = vec![usize::MAX; self.poses.len()];
        for (k, &i) in frames.iter().enumerate() {
            index[i] = k;
        }
        let used: Vec<usize> = (0..tracks.len())
            .filter(|&i| self.points[i].is_some())
            .collect();
        let mut observations = Vec::new();
        for (point, &i) in used.iter().enumerate() {
            let t = &tracks[i];
            let views = (t.first..t.end()).zip(t.seen.iter().copied());
            for (frame, at) in views.chain(self.again(t)) {
                if index[frame] != usize::MAX {
                    observations.push(Observation {
                        pose: index[frame],
                        point,
                        at,
                    });
                }
            }
        }
        let mut bundle = Bundle {
            poses: frames.iter().filter_map(|&i| self.poses[i]).collect(),
            points: used.iter().filter_map(|&i| self.points[i]).collect(),
            weights: used.iter().map(|&i| self.weights[i]).collect(),
            log_focal: self.focal.ln(),
            bend: self.bend,
            observations,
        };
        let report = bundle.adjust(options, progress);
        self.focal = bundle.focal();
        self.bend = bundle.bend;
        for (&i, pose) in frames.iter().zip(&bundle.poses) {
            self.poses[i] = Some(*pose);
        }
        for (&i, point) in used.iter().zip(&bundle.points) {
            self.points[i] = Some(*point);
        }
        report
    }

    /// Reprojection errors of a point over the track's views; points behind a camera count as
    /// infinite.
    pub fn errors(&self, track: &RawTrack, point: &Vector3<f64>) -> Vec<f64> {
        let views = self.views(track);
        let error =
            |(pose, at): &Ray| error_px(pose, point, self.focal, *at).unwrap_or(f64::INFINITY);
        views.iter().map(error).collect()
    }

    fn all_errors(&self, tracks: &[RawTrack]) -> impl Iterator<Item = f64> {
        let pairs = tracks.iter().zip(&self.points);
        pairs
            .filter_map(|(t, x)| Some(self.errors(t, x.as_ref()?)))
            .flatten()
    }

    /// Median reprojection error over all points and views, pixels.
    pub fn median_error(&self, tracks: &[RawTrack]) -> Option<f64> {
        median(&mut self.all_errors(tracks).collect::<Vec<f64>>())
    }

    /// Sum over all sightings by cameras with a pose of `1 - min(error / inlier_px, 1)^2`: how much
    /// of what was seen is explained.
    pub fn explained(&self, tracks: &[RawTrack], inlier_px: f64) -> f64 {
        self.all_errors(tracks)
            .map(|e| (1.0 - (e / inlier_px).powi(2)).max(0.0))
            .sum()
    }
}

/// Degrees of freedom that the noise of all tracks counts in that of one.
const PRIOR: f64 = 10.0;

/// Most frames that are adjusted at once, and how many of them must see a point.
pub(super) const MOST_FRAMES: usize = 300;
const LEAST_VIEWS: usize = 3;

/// Fewest agreeing points that fix a pose.
pub(crate) const MIN_SIGHTINGS: usize = 12;

/// The pose at share `s` of the way from `a` to `b`: camera centres on a line, rotations on the
/// shortest arc. Both world to camera.
fn interpolate(a: &Se3<f64>, b: &Se3<f64>, s: f64) -> Se3<f64> {
    let (ca, cb) = (a.inverse(), b.inverse());
    let turn = log_so3(&(cb.rotation * ca.rotation.transpose()));
    Se3 {
        rotation: exp_so3(&(turn * s)) * ca.rotation,
        translation: ca.translation * (1.0 - s) + cb.translation * s,
    }
    .inverse()
}

/// Median of the length of a residual whose two components have standard deviation 1 (Rayleigh).
pub(super) const RAYLEIGH_MEDIAN: f64 = 1.177_41;
/// Residuals above this many robust standard deviations disagree. 3: docs/spec/front-end.md 7.1.
const DEVIATIONS: f64 = 3.0;
/// ... if they are also above this, working pixels. 1: docs/spec/front-end.md 7.1.
const MIN_RESIDUAL_PX: f64 = 1.0;
/// A track is dynamic when at least this share of its observations disagrees. 0.3:
/// docs/spec/front-end.md 7.1.
const SHARE: f64 = 0.3;
/// Tracks with fewer observations are not judged. 3: the first number with more than one equation
/// to spare.
const MIN_OBSERVATIONS: usize = 3;
/// How often classification and bundle adjustment alternate. 2: docs/spec/front-end.md 7.1.
pub(super) const ROUNDS: usize = 2;

/// Judges every track: the best resting point is fitted to all its observations, also to those of
/// tracks that the map gave up on; where rays do not meet, a point at infinity stands in.
///
/// What counts as disagreement follows the errors of the map's points, or, in a map without points,
/// those of all tracks.
pub(crate) fn classify(map: &Map, tracks: &[RawTrack]) -> Vec<Motion> {
    let limit_for = |typical: f64| (DEVIATIONS * typical / RAYLEIGH_MEDIAN).max(MIN_RESIDUAL_PX);
    let limit = match map.median_error(tracks) {
        Some(typical) => limit_for(typical),
        None => limit_for(median_far_error(map, tracks).unwrap_or(0.0)),
    };
    tracks
        .par_iter()
        .map(|track| {
            let errors = resting_errors(map, track, limit);
            let count = errors.len();
            let disagree = errors.iter().filter(|e| **e > limit).count();
            if count < MIN_OBSERVATIONS {
                Motion::Unknown
            } else if disagree as f64 >= SHARE * count as f64 {
                Motion::Dynamic
            } else {
                Motion::Static
            }
        })
        .collect()
}

/// Median over all tracks of the median error of a point at infinity.
pub(crate) fn median_far_error(map: &Map, tracks: &[RawTrack]) -> Option<f64> {
    let mut all: Vec<f64> = tracks
        .par_iter()
        .filter_map(|track| median(&mut map.errors(track, &far_point(map, track)?)))
        .collect();
    median(&mut all)
}

fn resting_errors(map: &Map, track: &RawTrack, limit: f64) -> Vec<f64> {
    let views = map.views(track);
    let above = |errors: &[f64]| errors.iter().filter(|e| **e > limit).count();
    let near = triangulate(&views, map.focal, limit).map(|t| map.errors(track, &t.point));
    let far = far_point(map, track)
        .map(|x| map.errors(track, &x))
        .unwrap_or_default();
    match near {
        Some(near) if above(&near) <= above(&far) || far.is_empty() => near,
        _ => far,
    }
}

/// A point far away in the mean direction of the track's rays.
fn far_point(map: &Map, track: &RawTrack) -> Option<Vector3<f64>> {
    let views = map.views(track);
    let sum: Vector3<f64> = views
        .iter()
        .map(|(pose, at)| pose.rotation.tr_mul(&ray(*at, map.focal)))
        .sum();
    let extent = map
        .poses
        .iter()
        .flatten()
        .map(|p| p.translation.norm())
        .fold(1.0, f64::max);
    (sum.norm() > 0.0).then(|| sum.normalize() * 1e5 * extent)
}

#[cfg(test)]
mod tests {
    use super::{Map, interpolate};
    use crate::classical::sparse::tracking::RawTrack;
    use m4_core::nalgebra::Vector3;
    use m4_core::{CounterRng, Se3, exp_so3};

    #[test]
    fn tracks_count_by_their_own_noise() {
        let (focal, mut rng) = (400.0, CounterRng::new(5, 0, 0));
        let poses: Vec<_> = (0..30)
            .map(|i| Se3 {
                translation: Vector3::new(0.05 * f64::from(i), 0.0, 4.0),
                ..Se3::identity()
            })
            .collect();
        let points: Vec<Vector3<f64>> = (0..60)
            .map(|_| Vector3::from_fn(|_, _| rng.normal()))
            .collect();
        // the first is as bad as ten others, the last two are seen once and twice
        let views = |i: usize| if i < 58 { 30 } else { i - 57 };
        let track = |(i, x): (usize, &Vector3<f64>)| {
            let noise_px = if i == 0 { 1.0 } else { 0.1 };
            let at = |pose: &Se3<f64>| {
                let p = pose.transform(x);
                [p.x, p.y].map(|v| focal * v / p.z + noise_px * rng.normal())
            };
            RawTrack {
                first: 0,
                seen: poses[..views(i)].iter().map(at).collect(),
                again: Vec::new(),
            }
        };
        let tracks: Vec<RawTrack> = points.iter().enumerate().map(track).collect();
        let mut map = Map::new(focal, poses.iter().copied().map(Some).collect(), &tracks);
        map.points = points.iter().copied().map(Some).collect();
        map.weigh(&tracks);
        assert!(map.weights[0] < 0.1, "{}", map.weights[0]);
        assert!(
            map.weights[1..58].iter().all(|w| (0.5..2.0).contains(w)),
            "{:?}",
            map.weights
        );
        assert_eq!(map.weights[58], 1.0, "one view says nothing of noise");
        assert!((0.4..2.5).contains(&map.weights[59]), "{}", map.weights[59]);
    }

    #[test]
    fn interpolation_meets_both_ends_and_the_middle() {
        let pose = |w: f64, x: f64| {
            Se3 {
                rotation: exp_so3(&Vector3::new(0.0, w, 0.0)),
                translation: Vector3::new(x, 0.0, 1.0),
            }
            .inverse()
        };
        let (a, b) = (pose(0.2, 1.0), pose(0.6, 3.0));
        for (s, want) in [(0.0, a), (1.0, b), (0.5, pose(0.4, 2.0))] {
            assert!((interpolate(&a, &b, s).matrix() - want.matrix()).norm() < 1e-12);
        }
    }
}
