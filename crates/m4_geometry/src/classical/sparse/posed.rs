//! Cameras that are known: tracks, points and motion alone.

use super::adjustment::MIN_POINTS;
use super::bundle::BundleReport;
use super::limits::Limits;
use super::luma::{LONGEST_SIDE_PX, WorkingSize};
use super::map::Map;
use super::motion::{ROUNDS, classify, median_far_error};
use super::priors::{FocalSource, Lenses, Recovered, part};
use super::reconstruct::{Clip, MIN_TRACKS, check};
use super::rotation::sway;
use super::tracking::{RawTrack, track};
use super::{INLIER_PX, SparseConfig, SparseError, stopped};
use crate::classical::reconstruction::{CameraMotion, Motion};
use m4_core::{Camera, Mask, Progress, RgbImage};

/// Share of the tracks that must agree with given poses; below, they are doubted.
const DOUBTFUL_SHARE: f64 = 0.5;
/// Cameras that turn less than this, radians, and do not move are static.
const STILL_RAD: f64 = 1e-4;

/// Tracks and points of a clip whose cameras are known, each with its own lens. Cameras, their world and their unit are
/// handed out as they were given; `masks` as in [`super::FeatureTracks::recover`].
///
/// # Errors
///
/// [`SparseError`] as for [`super::FeatureTracks::recover`], and where cameras and frames do not fit or the poses contradict the images.
pub fn with_cameras(
    frames: &[&RgbImage],
    cameras: &[Camera],
    masks: Option<&[Mask]>,
    config: &SparseConfig,
    progress: &dyn Progress,
) -> Result<Recovered, SparseError> {
    let (width, height) = check(frames, masks, config)?;
    if cameras.len() != frames.len() {
        return Err(SparseError::CameraCount {
            cameras: cameras.len(),
            frames: frames.len(),
        });
    }
    for (frame, camera) in cameras.iter().enumerate() {
        check_camera(frame, camera, (width, height))?;
    }
    let size = WorkingSize::new(width, height, LONGEST_SIDE_PX);
    let tracks = track(frames, size, progress)?;
    posed_tracks(tracks, cameras, [width, height], size, masks, config, progress)
}

/// The same from tracks.
pub(super) fn posed_tracks(
    tracks: Vec<RawTrack>,
    cameras: &[Camera],
    [width, height]: [usize; 2],
    size: WorkingSize,
    masks: Option<&[Mask]>,
    config: &SparseConfig,
    progress: &dyn Progress,
) -> Result<Recovered, SparseError> {
    let (tracks, masked) = part(masks, tracks, size);
    let mut clip = Clip {
        tracks,
        masked,
        lenses: Lenses::PerFrame(cameras),
        frames: cameras.len(),
        size,
        width,
        height,
        config,
        limits: Limits::default(),
        progress,
        warnings: Vec::new(),
        quiet: false,
    };
    clip.posed(cameras)
}

fn check_camera(frame: usize, camera: &Camera, (width, height): (usize, usize)) -> Result<(), SparseError> {
    let k = &camera.intrinsics;
    let bad = |what: String| Err(SparseError::Camera { frame, what });
    if (k.width, k.height) != (width, height) {
        return bad(format!(
            "for {}x{} pixels where the frame has {width}x{height}",
            k.width, k.height
        ));
    }
    if ![k.fx, k.fy].iter().all(|f| f.is_finite() && *f > 0.0) || ![k.cx, k.cy].iter().all(|c| c.is_finite()) {
        return bad(format!(
            "without valid intrinsics (fx {}, fy {}, cx {}, cy {})",
            k.fx, k.fy, k.cx, k.cy
        ));
    }
    if !camera
        .c2w
        .rotation
        .iter()
        .chain(&camera.c2w.translation)
        .all(|v| v.is_finite())
    {
        return bad("with a pose that is not finite".to_owned());
    }
    Ok(())
}

impl Clip<'_> {
    fn posed(&mut self, cameras: &[Camera]) -> Result<Recovered, SparseError> {
        let focal = cameras
            .iter()
            .map(|c| (c.intrinsics.fx * c.intrinsics.fy).sqrt())
            .sum::<f64>()
            / cameras.len().max(1) as f64
            * self.size.scale;
        for tracks in [&mut self.tracks, &mut self.masked] {
            self.lenses.undo(tracks, self.size, focal);
        }
        if let Some(sway) = sway(&self.tracks, self.frames, &[focal], MIN_TRACKS) {
            self.limits.adapt(&sway, self.size.width);
        }
        let mut map = Map {
            focal,
            poses: cameras.iter().map(|c| Some(c.w2c())).collect(),
            points: vec![None; self.tracks.len()],
        };
        let mut usable = vec![true; self.tracks.len()];
        let mut motions = Vec::new();
        for _ in 0..ROUNDS {
            stopped(self.progress)?;
            map.triangulate(&self.tracks, &usable, &self.limits);
            motions = classify(&map, &self.tracks);
            for (usable, motion) in usable.iter_mut().zip(&motions) {
                *usable = *motion != Motion::Dynamic;
            }
        }
        map.triangulate(&self.tracks, &usable, &self.limits);
        let points = map.points.iter().flatten().count();
        let judged = motions.iter().filter(|m| **m != Motion::Unknown).count();
        let needed = MIN_POINTS.max(judged / 20);
        let camera_motion = if points >= needed {
            let report = BundleReport {
                cost: 0.0,
                log_focal_sigma: f64::INFINITY,
            };
            self.judge(&map, &motions, &report, false);
            if (points as f64) < DOUBTFUL_SHARE * judged as f64 {
                self.refute(cameras, focal, points, judged)?;
                self.warn(format!(
                    "only {points} of {judged} tracks agree with the given poses: if the scene is mostly static, check the order of \
                     the frames, the direction (camera to world) and the axes of the poses, and the focal length"
                ));
            }
            CameraMotion::Parallax
        } else {
            // Without points, the poses must at least explain the images as turns.
            let far = median_far_error(&map, &self.tracks).unwrap_or(f64::INFINITY);
            if far > INLIER_PX {
                return Err(SparseError::PosesDoNotFit {
                    points,
                    tracks: judged,
                    needed,
                });
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
            sparse: crate::classical::reconstruction::SparseReconstruction {
                cameras: cameras.to_vec(),
                tracks,
                camera_motion,
                residual_px,
                warnings: std::mem::take(&mut self.warnings),
            },
            focal: FocalSource::Given,
        })
    }
}

/// Whether cameras without parallax turn or are static.
fn motionless(cameras: &[Camera]) -> CameraMotion {
    let turns = |c: &Camera| {
        let turn = cameras[0].c2w.rotation.tr_mul(&c.c2w.rotation);
        m4_core::log_so3(&turn).norm() > STILL_RAD
    };
    if cameras.iter().any(turns) {
        CameraMotion::RotationOnly
    } else {
        CameraMotion::Static
    }
}
