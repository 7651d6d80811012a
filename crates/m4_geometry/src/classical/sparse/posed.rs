//! Cameras that are known: tracks, points and motion alone; and given poses against those that the
//! clip itself suggests.

use super::bundle::BundleReport;
use super::growth::MIN_POINTS;
use super::map::{Map, ROUNDS, classify, median_far_error};
use super::priors::{FocalSource, Lenses, Recovered};
use super::reconstruct::{FeatureTracks, SparseProblem};
use super::rival::Verdict;
use super::rotation::sway;
use super::{INLIER_PX, SparseConfig, SparseError, stopped};
use crate::classical::{CameraMotion, Motion, SparseReconstruction, check_count};
use m4_core::nalgebra::Vector3;
use m4_core::{Camera, Mask, Progress, Sim3, log_so3};

/// Share of the tracks that must agree with given poses; below, they are doubted.
const DOUBTFUL_SHARE: f64 = 0.5;
/// What the user can do about poses that do not fit.
const CHECK_POSES: &str = "check the order of the frames, the direction (camera to world) and the axes of the poses, and the focal length";
/// Cameras that turn less than this, radians, and do not move are static.
const STILL_RAD: f64 = 1e-4;
/// How many times as many tracks must agree with other poses.
const TIMES: usize = 2;
/// Poses as near as this to the given ones, as a share of the way and in radians, are the same.
const SAME_WAY: f64 = 0.05;
const SAME_RAD: f64 = 0.035;

impl FeatureTracks {
    /// Finds points and motion of a clip whose cameras are known, each with its own lens. Cameras,
    /// their world and their unit are handed out as they were given; `masks` as in
    /// [`recover`](Self::recover).
    ///
    /// # Errors
    ///
    /// [`SparseError`] as for [`recover`](Self::recover), and where cameras and frames do not fit
    /// or the poses contradict the images.
    pub fn with_cameras(
        &self,
        cameras: &[Camera],
        masks: Option<&[&Mask]>,
        config: &SparseConfig,
        progress: &dyn Progress,
    ) -> Result<Recovered, SparseError> {
        check_count("cameras", cameras.len(), self.frames).map_err(SparseError::Input)?;
        check_count("masks", masks.map_or(self.frames, <[_]>::len), self.frames)
            .map_err(SparseError::Input)?;
        let usable = |Camera { intrinsics: k, c2w }: &Camera| {
            let numbers = [k.fx, k.fy, k.cx, k.cy]
                .into_iter()
                .chain(c2w.to_translation_quaternion());
            [k.width, k.height] == self.size
                && k.fx > 0.0
                && k.fy > 0.0
                && numbers.into_iter().all(f64::is_finite)
        };
        if let Some(frame) = cameras.iter().position(|camera| !usable(camera)) {
            let what = format!(
                "the camera of frame {frame} is of another image size, or its numbers cannot be used"
            );
            return Err(SparseError::Input(what));
        }
        let lenses = Lenses(cameras.iter().map(|c| c.intrinsics).collect());
        SparseProblem::new(self.clone(), masks, lenses, config, progress).posed(cameras)
    }
}

impl SparseProblem<'_> {
    fn posed(&mut self, cameras: &[Camera]) -> Result<Recovered, SparseError> {
        let focal = cameras
            .iter()
            .map(|c| (c.intrinsics.fx * c.intrinsics.fy).sqrt())
            .sum::<f64>()
            / cameras.len().max(1) as f64
            * self.size.scale;
        self.undo_lenses(focal);
        if let Some(sway) = sway(&self.tracks, self.frames, &[focal]) {
            self.limits.adapt(&sway, self.size.width);
        }
        let mut map = Map::new(
            focal,
            cameras.iter().map(|c| Some(c.w2c())).collect(),
            &self.tracks,
        );
        let mut motions = Vec::new();
        for _ in 0..ROUNDS {
            stopped(self.progress)?;
            map.triangulate(&self.tracks, &motions, &self.limits);
            motions = classify(&map, &self.tracks);
        }
        map.triangulate(&self.tracks, &motions, &self.limits);
        let points = map.points.iter().flatten().count();
        let judged = motions.iter().filter(|m| **m != Motion::Unknown).count();
        let needed = MIN_POINTS.max(judged / 20);
        let camera_motion = if points >= needed {
            let report = BundleReport {
                cost: 0.0,
                log_focal_sigma: f64::INFINITY,
                bend_sigma: f64::INFINITY,
            };
            self.judge(&map, (&motions, Verdict::Alone), &report, false);
            if (points as f64) < DOUBTFUL_SHARE * judged as f64 {
                self.refute(cameras, focal, points, judged)?;
                self.warn(format!(
                    "only {points} of {judged} tracks agree with the given poses: if the scene is mostly static, {CHECK_POSES}"
                ));
            }
            CameraMotion::Parallax
        } else {
            // Without points, the poses must at least explain the images as turns.
            let far = median_far_error(&map, &self.tracks).unwrap_or(f64::INFINITY);
            if far > INLIER_PX {
                return Err(SparseError::NoAgreement(format!(
                    "the given poses do not fit the images: only {points} of {judged} tracks agree with them on a static scene, \
                     {needed} are needed; {CHECK_POSES}"
                )));
            }
            map.points.fill(None);
            self.warn(format!(
                "with the given poses only {points} points have enough parallax, {needed} are needed: depth cannot be \
                 measured"
            ));
            motionless(cameras)
        };
        let (tracks, residual_px) = self.hand_out(&map, &motions);
        Ok(Recovered {
            sparse: SparseReconstruction {
                cameras: cameras.to_vec(),
                tracks,
                camera_motion,
                residual_px,
                warnings: std::mem::take(&mut self.warnings),
            },
            focal: FocalSource::Given,
            distortion: None,
            tied: false,
        })
    }

    /// Fails where poses found from the clip alone, with the given focal length (working pixels),
    /// explain far more tracks than the `points` that the given ones do, and are others.
    fn refute(
        &self,
        cameras: &[Camera],
        focal: f64,
        points: usize,
        judged: usize,
    ) -> Result<(), SparseError> {
        let config = SparseConfig {
            fov_deg: None,
            focal_px: Some(focal / self.size.scale),
            intrinsics: None,
            static_camera: false,
            ..self.config.clone()
        };
        let features = FeatureTracks {
            // They were moved already to where a lens of that focal length has them.
            tracks: self.tracks.clone(),
            frames: self.frames,
            size: [self.width, self.height],
            working: self.size,
        };
        let mut free =
            SparseProblem::new(features, None, Lenses(Vec::new()), &config, self.progress);
        free.quiet = true;
        let suggestion = match free.solve() {
            Ok(result) if result.sparse.camera_motion == CameraMotion::Parallax => result.sparse,
            Err(SparseError::Cancelled) => return Err(SparseError::Cancelled),
            // The clip suggests nothing.
            _ => return Ok(()),
        };
        let better = suggestion
            .tracks
            .iter()
            .filter(|t| t.point.is_some())
            .count();
        let (way, turn_rad) = apart(&suggestion.cameras, cameras);
        if better >= TIMES * points && (way > SAME_WAY || turn_rad > SAME_RAD) {
            return Err(SparseError::NoAgreement(format!(
                "the given poses contradict the images: {points} of {judged} tracks agree with them on a static scene, {better} \
                 with poses estimated from the images alone, whose rotations differ by up to {:.1} degrees; {CHECK_POSES}, or \
                 leave the poses out",
                turn_rad.to_degrees()
            )));
        }
        Ok(())
    }
}

/// Whether cameras without parallax turn or are static.
fn motionless(cameras: &[Camera]) -> CameraMotion {
    let turns = |c: &Camera| {
        let turn = cameras[0].c2w.rotation.tr_mul(&c.c2w.rotation);
        log_so3(&turn).norm() > STILL_RAD
    };
    if cameras.iter().any(turns) {
        CameraMotion::RotationOnly
    } else {
        CameraMotion::Static
    }
}

/// How far `a` is from `b` once its world is laid over that of `b`: root mean square distance over
/// the length of the way, and the greatest turn between two cameras of a frame, radians.
fn apart(a: &[Camera], b: &[Camera]) -> (f64, f64) {
    let centres = |cameras: &[Camera]| {
        cameras
            .iter()
            .map(Camera::centre)
            .collect::<Vec<Vector3<f64>>>()
    };
    let (from, to) = (centres(a), centres(b));
    // Turns are compared with those since the first frame: a straight way leaves the turn about it
    // open.
    let turn = |(x, y): (&Camera, &Camera)| {
        let since = |c: &Camera, first: &Camera| first.c2w.rotation.tr_mul(&c.c2w.rotation);
        log_so3(&since(x, &a[0]).tr_mul(&since(y, &b[0]))).norm()
    };
    let turn_rad = a.iter().zip(b).map(turn).fold(0.0, f64::max);
    let way: f64 = to.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    let Some(fit) = Sim3::umeyama(&from, &to).filter(|_| way > 0.0) else {
        return (f64::INFINITY, turn_rad);
    };
    let squared: f64 = from
        .iter()
        .zip(&to)
        .map(|(p, q)| (fit.transform(p) - q).norm_squared())
        .sum();
    ((squared / to.len() as f64).sqrt() / way, turn_rad)
}
