//! The whole way from frames to a reconstruction.

use super::bundle::{BundleOptions, BundleReport};
use super::config::{GeometryConfig, SparseConfig};
use super::degenerate::{standing, turning};
use super::growth::{Start, grow, scan, start_pairs};
use super::luma::WorkingSize;
use super::map::{Map, interpolate};
use super::motion::classify;
use super::rotation::{Sway, focal_candidates, focal_from_fov, keyframes, matches, sway};
use super::tracking::{RawTrack, track};
use super::triangulate::median;
use super::{SparseError, stopped};
use crate::reconstruction::{CameraMotion, Motion, SparseReconstruction, Track};
use m4_math::Se3;
use m4_scene::{Camera, Intrinsics, Progress, RgbImage};

/// Fewest tracks from one frame to the next.
const MIN_TRACKS: usize = 20;

/// Cameras, tracks and points of a clip, from its pictures alone (section 7.1 of the specification of
/// the front end, items 1 to 5).
///
/// The world is the camera of frame 0, scaled so that the median depth of all points is 1. One focal
/// length is shared by all frames; the principal point is the image centre; pixels are square.
///
/// Cameras that stand still or only turn are no error: [`SparseReconstruction::camera_motion`] and the
/// warnings say so.
///
/// # Errors
///
/// [`SparseError`] for frames of different size, settings out of range, clips in which nothing can be
/// followed, clips in which no two frames agree on a rigid scene, and when the user stops the run.
pub fn reconstruct(
    frames: &[&RgbImage],
    config: &SparseConfig,
    progress: &dyn Progress,
) -> Result<SparseReconstruction, SparseError> {
    let (width, height) = check(frames, config)?;
    let size = WorkingSize::new(width, height, config.tracking.longest_side_px);
    let tracks = track(frames, size, &config.tracking, progress)?;
    let mut clip = Clip {
        tracks,
        frames: frames.len(),
        size,
        width,
        height,
        config,
        progress,
        warnings: Vec::new(),
    };
    clip.solve()
}

fn check(frames: &[&RgbImage], config: &SparseConfig) -> Result<(usize, usize), SparseError> {
    let Some(first) = frames.first().filter(|_| frames.len() >= 2) else {
        return Err(SparseError::TooFewFrames { found: frames.len() });
    };
    let (width, height) = first.size();
    for (frame, picture) in frames.iter().enumerate() {
        if picture.size() != (width, height) {
            return Err(SparseError::FrameSize {
                frame,
                found: picture.size(),
                expected: (width, height),
            });
        }
    }
    if width.min(height) < 64 {
        return Err(SparseError::FrameTooSmall { width, height });
    }
    let range = |name, value: Option<f64>, low: f64, high: f64, range| match value {
        Some(value) if !(value > low && value < high) => Err(SparseError::Setting { name, value, range }),
        _ => Ok(()),
    };
    range("fov_deg", config.fov_deg, 1.0, 175.0, "1 to 175 degrees")?;
    range("focal_px", config.focal_px, 0.0, f64::INFINITY, "above 0 pixels")?;
    range(
        "tracking.longest_side_px",
        Some(config.tracking.longest_side_px as f64),
        63.0,
        1e5,
        "64 to 99999 pixels",
    )?;
    Ok((width, height))
}

/// A tracked clip on its way to a reconstruction.
struct Clip<'a> {
    tracks: Vec<RawTrack>,
    frames: usize,
    size: WorkingSize,
    width: usize,
    height: usize,
    config: &'a SparseConfig,
    progress: &'a dyn Progress,
    warnings: Vec<String>,
}

impl Clip<'_> {
    fn warn(&mut self, message: String) {
        self.progress.warn(&message);
        self.warnings.push(message);
    }

    /// The focal length that the user gave, working pixels.
    fn given_focal(&self) -> Option<f64> {
        let from_fov = self.config.fov_deg.map(|fov| focal_from_fov(self.width, fov));
        self.config.focal_px.or(from_fov).map(|f| f * self.size.scale)
    }

    fn default_focal(&self) -> f64 {
        self.given_focal()
            .unwrap_or_else(|| self.working_focal(self.config.geometry.default_fov_deg))
    }

    fn working_focal(&self, fov_deg: f64) -> f64 {
        focal_from_fov(self.width, fov_deg) * self.size.scale
    }

    fn fov_deg(&self, focal: f64) -> f64 {
        2.0 * (0.5 * self.width as f64 * self.size.scale / focal).atan().to_degrees()
    }

    fn solve(&mut self) -> Result<SparseReconstruction, SparseError> {
        let geometry = &self.config.geometry;
        if self.config.static_camera {
            return Ok(self.still("the camera was declared to stand still".to_owned()));
        }
        self.check_tracks()?;
        let focals = match self.given_focal() {
            Some(focal) => vec![focal],
            None => focal_candidates(self.size.width, geometry),
        };
        let Some(sway) = sway(&self.tracks, self.frames, &focals, MIN_TRACKS) else {
            // Not one pair of spread frames has tracks in common: long or fast; growth will tell.
            return self.moving(&focals, self.default_focal());
        };
        if sway.motion_px < geometry.static_motion_px {
            return Ok(self.still(format!(
                "the picture moves by at most {:.2} px (60 % of all points, working size), less than {} px",
                sway.motion_px, geometry.static_motion_px
            )));
        }
        if sway.parallax_px < geometry.min_parallax * self.size.width as f64 {
            return Ok(self.turning(&sway));
        }
        self.moving(&focals, sway.focal)
    }

    fn check_tracks(&self) -> Result<(), SparseError> {
        for frame in 1..self.frames {
            let found = matches(&self.tracks, frame - 1, frame).len();
            if found < MIN_TRACKS {
                return Err(SparseError::TooFewTracks {
                    frame: frame - 1,
                    found,
                    needed: MIN_TRACKS,
                });
            }
        }
        Ok(())
    }

    /// One pose.
    fn still(&mut self, why: String) -> SparseReconstruction {
        let map = standing(&self.tracks, self.frames, self.default_focal());
        self.warn(format!(
            "camera taken as standing still: {why}; depth cannot be measured and new views will be plausible at best{}",
            self.focal_note()
        ));
        self.finish(map, CameraMotion::Static)
    }

    /// Rotations alone.
    fn turning(&mut self, sway: &Sway) -> SparseReconstruction {
        // Below some 10 degrees of turn the focal length has next to no influence.
        let focal = if sway.turn_rad > 0.17 {
            sway.focal
        } else {
            self.default_focal()
        };
        let (map, lost) = turning(&self.tracks, self.frames, focal, MIN_TRACKS, &self.config.geometry);
        let note = if sway.turn_rad > 0.17 {
            String::new()
        } else {
            self.focal_note()
        };
        self.warn(format!(
            "the camera turns (by up to {:.1} degrees) but hardly moves: median parallax is at most {:.1} px where \
             {:.1} px are needed (working size); rotations only, depth cannot be measured{note}",
            sway.turn_rad.to_degrees(),
            sway.parallax_px,
            self.config.geometry.min_parallax * self.size.width as f64
        ));
        if lost > 0 {
            self.warn(format!(
                "{lost} of {} frames took the rotation of the frame before",
                self.frames
            ));
        }
        self.finish(map, CameraMotion::RotationOnly)
    }

    fn focal_note(&self) -> String {
        match self.given_focal() {
            Some(_) => String::new(),
            None => format!(
                "; a field of view of {} degrees is assumed (give the true one with --fov)",
                self.config.geometry.default_fov_deg
            ),
        }
    }

    /// Poses, focal length and points.
    fn moving(&mut self, focals: &[f64], likely_focal: f64) -> Result<SparseReconstruction, SparseError> {
        let geometry = &self.config.geometry;
        let free_focal = self.given_focal().is_none();
        let keys = keyframes(&self.tracks, self.frames, self.size.width, likely_focal, geometry);
        let pairs = start_pairs(&self.tracks, &keys, likely_focal, self.size.width);
        let starts = scan(&self.tracks, &pairs, focals, geometry, self.progress)?;
        let usable = vec![true; self.tracks.len()];
        let mut best: Option<(f64, Map)> = None;
        for start in picked_starts(&starts) {
            let grown = grow(
                &self.tracks,
                &usable,
                &keys,
                start,
                self.frames,
                free_focal,
                geometry,
                self.progress,
            )?;
            let Some(map) = grown else { continue };
            let explained = map.explained(&self.tracks, geometry.inlier_px);
            if best.as_ref().is_none_or(|(e, _)| explained > *e) {
                best = Some((explained, map));
            }
        }
        let Some((_, mut map)) = best.filter(|(_, map)| map.registered() >= 3.min(self.frames)) else {
            let first = starts.first();
            return Err(SparseError::NoStart {
                inliers: first.map_or(0, |s| s.view.inliers.len()),
                matches: first.map_or(0, |s| s.pair.matches),
                needed: super::growth::MIN_MATCHES,
            });
        };
        let (motions, report) = self.refine(&mut map, free_focal)?;
        self.judge(&map, &motions, &report, free_focal);
        Ok(self.finish_with(map, motions, CameraMotion::Parallax))
    }

    /// All frames, bundle adjustment and classification in turn.
    fn refine(&mut self, map: &mut Map, free_focal: bool) -> Result<(Vec<Motion>, BundleReport), SparseError> {
        let GeometryConfig {
            cauchy_px,
            bundle_iterations,
            ..
        } = self.config.geometry;
        let mut usable = vec![true; self.tracks.len()];
        self.register_all(map)?;
        map.triangulate(&self.tracks, &usable, &self.config.geometry);
        let options = BundleOptions {
            cauchy_px,
            iterations: bundle_iterations,
            free_focal,
            free_poses: true,
        };
        let rounds = self.config.motion.rounds.max(1);
        let mut motions = Vec::new();
        let mut report = map.adjust(&self.tracks, &options);
        for round in 0..rounds {
            stopped(self.progress)?;
            self.progress.update(
                "bundle adjustment",
                round,
                rounds,
                &format!("focal {:.1} px", map.focal / self.size.scale),
            );
            motions = classify(map, &self.tracks, &self.config.motion);
            for (u, m) in usable.iter_mut().zip(&motions) {
                *u = *m != Motion::Dynamic;
            }
            map.triangulate(&self.tracks, &usable, &self.config.geometry);
            self.register_all(map)?;
            report = map.adjust(&self.tracks, &options);
        }
        map.triangulate(&self.tracks, &usable, &self.config.geometry);
        self.progress.update("bundle adjustment", rounds, rounds, "");
        Ok((motions, report))
    }

    /// Places the frames that have no pose yet, nearest to placed ones first.
    fn register_all(&mut self, map: &mut Map) -> Result<(), SparseError> {
        loop {
            stopped(self.progress)?;
            let open: Vec<usize> = (0..self.frames).filter(|&i| map.poses[i].is_none()).collect();
            let mut placed = 0;
            for frame in open {
                let beside = frame.checked_sub(1).is_some_and(|i| map.poses[i].is_some())
                    || map.poses.get(frame + 1).is_some_and(Option::is_some);
                placed += usize::from(beside && map.register(&self.tracks, frame, &self.config.geometry));
            }
            self.progress.update("frames", map.registered(), self.frames, "");
            if placed == 0 {
                return Ok(());
            }
        }
    }

    /// Says what is doubtful, with numbers.
    fn judge(&mut self, map: &Map, motions: &[Motion], report: &BundleReport, free_focal: bool) {
        let typical = map.median_error(&self.tracks).unwrap_or(0.0);
        if typical > 1.0 {
            self.warn(format!(
                "points are explained to {typical:.2} px only (working size; below 1 px is usual): poses are doubtful"
            ));
        }
        let fov = self.fov_deg(map.focal);
        if !(20.0..=125.0).contains(&fov) {
            self.warn(format!(
                "the field of view came out as {fov:.0} degrees, which no common camera has; pass --fov with the true one"
            ));
        }
        let sigma = report.log_focal_sigma * typical.max(0.1);
        if free_focal && sigma > 0.1 {
            self.warn(format!(
                "the motion of the camera says little about its focal length ({:.0} px, give or take {:.0} %); pass \
                 --fov if the field of view is known",
                map.focal / self.size.scale,
                100.0 * sigma.min(9.99)
            ));
        }
        let count = |m: Motion| motions.iter().filter(|x| **x == m).count();
        let (rest, moving) = (count(Motion::Static), count(Motion::Dynamic));
        if moving > rest {
            self.warn(format!(
                "more tracks move ({moving}) than rest ({rest}): the poses may follow something that moves"
            ));
        }
        let points = map.points.iter().flatten().count();
        if points < 100 {
            self.warn(format!("only {points} points were triangulated: poses are doubtful"));
        }
    }

    fn finish(&mut self, map: Map, camera_motion: CameraMotion) -> SparseReconstruction {
        let motions = classify(&map, &self.tracks, &self.config.motion);
        self.finish_with(map, motions, camera_motion)
    }

    /// Fills gaps, normalises and converts to input pixels.
    fn finish_with(&mut self, mut map: Map, motions: Vec<Motion>, camera_motion: CameraMotion) -> SparseReconstruction {
        let missing = self.fill_gaps(&mut map);
        if missing > 0 {
            self.warn(format!(
                "{missing} of {} frames could not be placed; their poses are interpolated between neighbours",
                self.frames
            ));
        }
        normalise(&mut map, &self.tracks);
        let scale = self.size.scale;
        let mut residuals = Vec::new();
        let tracks: Vec<Track> = self
            .tracks
            .iter()
            .zip(&map.points)
            .zip(motions)
            .map(|((raw, point), motion)| {
                let point = point.filter(|_| motion == Motion::Static);
                let mut errors = point.map(|x| map.errors(raw, &x)).unwrap_or_default();
                residuals.extend(errors.iter().map(|e| e / scale));
                Track {
                    first_frame: raw.first,
                    observations: raw.seen.iter().map(|&p| self.size.to_input(p)).collect(),
                    motion,
                    point,
                    residual_px: median(&mut errors).unwrap_or(0.0) / scale,
                }
            })
            .collect();
        let intrinsics = Intrinsics::centred(self.width, self.height, map.focal / scale);
        let camera = |pose: &Option<Se3<f64>>| Camera {
            intrinsics,
            c2w: pose.unwrap_or_else(Se3::identity).inverse(),
        };
        SparseReconstruction {
            cameras: map.poses.iter().map(camera).collect(),
            tracks,
            camera_motion,
            residual_px: median(&mut residuals).unwrap_or(0.0),
            warnings: std::mem::take(&mut self.warnings),
        }
    }

    /// Interpolates missing poses; their number.
    fn fill_gaps(&self, map: &mut Map) -> usize {
        let known: Vec<(usize, Se3<f64>)> = (0..self.frames).filter_map(|i| Some((i, map.poses[i]?))).collect();
        let missing = self.frames - known.len();
        for frame in 0..self.frames {
            if map.poses[frame].is_none() {
                let after = known.iter().find(|(i, _)| *i > frame);
                let before = known.iter().rev().find(|(i, _)| *i < frame);
                map.poses[frame] = match (before, after) {
                    (Some((i, a)), Some((j, b))) => Some(interpolate(a, b, (frame - i) as f64 / (j - i) as f64)),
                    (Some((_, a)), None) | (None, Some((_, a))) => Some(*a),
                    (None, None) => None,
                };
            }
        }
        missing
    }
}

/// The best start and up to two others whose focal lengths differ from those taken by a third.
fn picked_starts(starts: &[Start]) -> Vec<&Start> {
    let mut picked: Vec<&Start> = Vec::new();
    for start in starts {
        let apart = picked.iter().all(|p| (p.focal / start.focal).ln().abs() > 0.28);
        if picked.len() < 3 && apart {
            picked.push(start);
        }
    }
    picked
}

/// Moves the world to the camera of frame 0 and scales it so that the median depth of the points is 1.
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
    let scale = median(&mut depths).filter(|d| *d > 0.0).map_or(1.0, |d| 1.0 / d);
    let world = first.inverse();
    for pose in map.poses.iter_mut().flatten() {
        *pose = pose.compose(&world);
        pose.translation *= scale;
    }
    for point in map.points.iter_mut().flatten() {
        *point = first.transform(point) * scale;
    }
}
