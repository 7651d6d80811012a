//! What is handed out: doubts, gaps filled, one scale, input pixels.

use super::bundle::BundleReport;
use super::map::Map;
use super::reconstruct::SparseProblem;
use super::rival::Verdict;
use super::tracking::RawTrack;
use crate::classical::{CameraMotion, Motion, SparseReconstruction, Track};
use m4_core::advice::FIELD_OF_VIEW;
use m4_core::{Camera, Intrinsics, Se3, median};

impl SparseProblem<'_> {
    /// Says what is doubtful, with numbers; the standard deviation of the logarithm of the focal
    /// length.
    pub(super) fn judge(
        &mut self,
        map: &Map,
        (motions, verdict): (&[Motion], Verdict),
        report: &BundleReport,
        free_focal: bool,
    ) -> f64 {
        let typical = map.median_error(&self.tracks).unwrap_or(0.0);
        if typical > 1.0 {
            self.warn(format!(
                "high reprojection error: median {typical:.2} px (at working size; below 1 px is normal); camera poses may be wrong"
            ));
        }
        let fov = self.fov_deg(map.focal);
        if !(20.0..=125.0).contains(&fov) {
            self.warn(format!(
                "the field of view came out as {fov:.0} degrees, which no common camera has; {FIELD_OF_VIEW}"
            ));
        }
        let sigma = report.log_focal_sigma * typical.max(0.1);
        if free_focal && sigma > 0.1 {
            self.warn(format!(
                "the motion of the camera says little about its focal length ({:.0} px, give or take {:.0} %); \
                 {FIELD_OF_VIEW} if it is known",
                map.focal / self.size.scale,
                100.0 * sigma.min(9.99)
            ));
        }
        let [n_static, n_dynamic] =
            [Motion::Static, Motion::Dynamic].map(|m| motions.iter().filter(|x| **x == m).count());
        if n_dynamic > n_static && verdict == Verdict::Alone {
            self.warn(format!(
                "more tracks are dynamic ({n_dynamic}) than static ({n_static}): the poses may follow a moving object"
            ));
        }
        let points = map.points.iter().flatten().count();
        if points < 100 {
            self.warn(format!(
                "only {points} points were triangulated; camera poses may be wrong"
            ));
        }
        sigma
    }

    /// Fills gaps, normalises and converts to input pixels.
    pub(super) fn finish(
        &mut self,
        mut map: Map,
        motions: &[Motion],
        camera_motion: CameraMotion,
    ) -> SparseReconstruction {
        let missing = map.poses.iter().filter(|pose| pose.is_none()).count();
        if missing > 0 {
            self.warn(format!(
                "{missing} of {} frames could not be placed; their poses are interpolated between neighbours",
                self.frames
            ));
            map.poses = (0..self.frames)
                .map(|i| map.poses[i].or_else(|| map.starts(i).first().copied()))
                .collect();
        }
        normalise(&mut map, &self.tracks);
        let (tracks, residual_px) = self.hand_out(&map, motions);
        let intrinsics = Intrinsics::centred(self.width, self.height, map.focal / self.size.scale);
        let camera = |(frame, pose): (usize, &Option<Se3<f64>>)| Camera {
            intrinsics: self.lenses.of(frame).unwrap_or(intrinsics),
            c2w: pose.unwrap_or_else(Se3::identity).inverse(),
        };
        SparseReconstruction {
            cameras: map.poses.iter().enumerate().map(camera).collect(),
            tracks,
            camera_motion,
            residual_px,
            warnings: std::mem::take(&mut self.warnings),
        }
    }

    /// All tracks in input pixels, and the median error of those with a point.
    pub(super) fn hand_out(&self, map: &Map, motions: &[Motion]) -> (Vec<Track>, f64) {
        let scale = self.size.scale;
        let mut residuals = Vec::new();
        let observations = |raw: &RawTrack| {
            let positions = (raw.first..).zip(&raw.seen);
            positions
                .map(|(frame, &p)| self.lenses.input_px(frame, p, self.size, map.focal))
                .collect()
        };
        let judged = self.tracks.iter().zip(&map.points).zip(motions);
        let judged = judged.map(|((raw, point), &motion)| {
            let point = point.filter(|_| motion == Motion::Static);
            let mut errors = point.map(|x| map.errors(raw, &x)).unwrap_or_default();
            residuals.extend(errors.iter().map(|e| e / scale));
            let residual_px = median(&mut errors).unwrap_or(0.0) / scale;
            Track {
                first_frame: raw.first,
                observations: observations(raw),
                motion,
                point,
                residual_px,
            }
        });
        let mut tracks: Vec<Track> = judged.collect();
        tracks.extend(self.masked.iter().map(|raw| Track {
            first_frame: raw.first,
            observations: observations(raw),
            motion: Motion::Dynamic,
            point: None,
            residual_px: 0.0,
        }));
        (tracks, median(&mut residuals).unwrap_or(0.0))
    }
}

/// Moves the world to the camera of frame 0 and scales it so that the median depth of the points is
/// 1.
fn normalise(map: &mut Map, tracks: &[RawTrack]) {
    let Some(first) = map.poses.first().copied().flatten() else {
        return;
    };
    let mut depths = Vec::new();
    for (track, point) in tracks.iter().zip(&map.points) {
        let Some(point) = point else { continue };
        for frame in track.first..track.end() {
            depths.extend(map.poses[frame].map(|pose| pose.transform(point).z));
        }
    }
    let scale = median(&mut depths)
        .filter(|d| *d > 0.0)
        .map_or(1.0, |d| 1.0 / d);
    let world = first.inverse();
    for pose in map.poses.iter_mut().flatten() {
        *pose = pose.compose(&world);
        pose.translation *= scale;
    }
    for point in map.points.iter_mut().flatten() {
        *point = first.transform(point) * scale;
    }
}
