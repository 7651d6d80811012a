//! From frames to a reconstruction.

use super::degenerate::turning;
use super::distortion::Straight;
use super::luma::{LONGEST_SIDE_PX, WorkingSize};
use super::map::{MOST_FRAMES, Map, classify};
use super::priors::{FocalSource, Lenses, Recovered, part};
use super::rotation::{
    KEYFRAME_PARALLAX, Limits, MIN_TRACKS, Sway, focal_candidates, focal_from_fov, matches, sway,
};
use super::tracking::{RawTrack, track};
use super::{SparseConfig, SparseError, revisits, stopped};
use crate::classical::{CameraMotion, check_count};
use m4_core::advice::{FIELD_OF_VIEW, STATIC_CAMERA};
use m4_core::{Intrinsics, Mask, Progress, RgbImage, Se3};

/// Below this greatest median parallax (share of the width, rotation taken out) nothing can be
/// triangulated and the camera counts as turning only. 0.004: 2 pixels of 480, some twenty times
/// the error of a track.
const MIN_PARALLAX: f64 = 0.004;
/// Below this motion of 60 % of all tracks over the clip the camera counts as static, working
/// pixels.
const STATIC_MOTION_PX: f64 = 1.0;
/// A camera declared static is doubted when the image moves by this many times
/// [`STATIC_MOTION_PX`].
const DOUBTFUL: f64 = 5.0;

/// Cameras, tracks and points of a clip from its feature tracks.
pub(super) fn from_tracks(
    features: FeatureTracks,
    masks: Option<&[&Mask]>,
    config: &SparseConfig,
    progress: &dyn Progress,
) -> Result<Recovered, SparseError> {
    let [width, height] = features.size;
    let lens = config.intrinsics.map(|[fx, fy, cx, cy]| Intrinsics {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    });
    let lenses = Lenses(lens.into_iter().collect());
    let mut clip = SparseProblem::new(features, masks, lenses, config, progress);
    if let Some(focal) = clip.given_focal() {
        clip.undo_lenses(focal);
    }
    clip.solve()
}

fn check(frames: &[&RgbImage], config: &SparseConfig) -> Result<(usize, usize), SparseError> {
    let refused = |what: String| Err(SparseError::Input(what));
    let Some(first) = frames.first().filter(|_| frames.len() >= 2) else {
        let count = frames.len();
        return refused(format!(
            "the clip has {count} frame(s); at least 2 are needed to observe motion"
        ));
    };
    let (width, height) = first.size();
    for (frame, image) in frames.iter().enumerate() {
        if image.size() != (width, height) {
            let (size, expected) = (image.size(), (width, height));
            return refused(format!(
                "frame {frame} is {size:?} pixels while frame 0 is {expected:?}; give frames of one size"
            ));
        }
    }
    if width.min(height) < 64 {
        return refused(format!(
            "frames of {width}x{height} pixels are too small to track points; at least 64x64 are needed"
        ));
    }
    let range = |name, value: Option<f64>, low: f64, high: f64, range| match value {
        Some(value) if !(value > low && value < high) => {
            Err(SparseError::Setting { name, value, range })
        }
        _ => Ok(()),
    };
    range("fov_deg", config.fov_deg, 1.0, 175.0, "1 to 175 degrees")?;
    range(
        "focal_px",
        config.focal_px,
        0.0,
        f64::INFINITY,
        "above 0 pixels",
    )?;
    let [fx, fy, cx, cy] = config.intrinsics.map_or([None; 4], |k| k.map(Some));
    let inside = "within the image, from its corner";
    range("intrinsics fx", fx, 0.0, f64::INFINITY, "above 0 pixels")?;
    range("intrinsics fy", fy, 0.0, f64::INFINITY, "above 0 pixels")?;
    range("intrinsics cx", cx, 0.0, width as f64, inside)?;
    range("intrinsics cy", cy, 0.0, height as f64, inside)?;
    Ok((width, height))
}

/// A tracked clip on its way to a reconstruction.
pub(super) struct SparseProblem<'a> {
    pub(super) tracks: Vec<RawTrack>,
    /// Those that lie in given masks.
    pub(super) masked: Vec<RawTrack>,
    pub(super) lenses: Lenses,
    pub(super) frames: usize,
    pub(super) size: WorkingSize,
    /// Of the input, as `height`.
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) config: &'a SparseConfig,
    pub(super) limits: Limits,
    /// Distortion that was taken out of the tracks, with the tracks before that.
    pub(super) straight: Option<Straight>,
    pub(super) progress: &'a dyn Progress,
    pub(super) warnings: Vec<String>,
    /// Whether warnings are kept back for now.
    pub(super) quiet: bool,
}

impl<'a> SparseProblem<'a> {
    pub(super) fn new(
        features: FeatureTracks,
        masks: Option<&[&Mask]>,
        lenses: Lenses,
        config: &'a SparseConfig,
        progress: &'a dyn Progress,
    ) -> Self {
        let (tracks, masked) = part(masks, features.tracks, features.working);
        Self {
            tracks,
            masked,
            lenses,
            frames: features.frames,
            size: features.working,
            width: features.size[0],
            height: features.size[1],
            config,
            limits: Limits::default(),
            straight: None,
            progress,
            warnings: Vec::new(),
            quiet: false,
        }
    }

    /// Moves observations to where one lens of that focal length has them.
    pub(super) fn undo_lenses(&mut self, focal: f64) {
        for tracks in [&mut self.tracks, &mut self.masked] {
            self.lenses.undo(tracks, self.size, focal);
        }
    }

    pub(super) fn warn(&mut self, message: String) {
        if !self.quiet {
            self.progress.warn(&message);
        }
        self.warnings.push(message);
    }

    /// The focal length that the user gave, working pixels.
    pub(super) fn given_focal(&self) -> Option<f64> {
        let from_fov = self
            .config
            .fov_deg
            .map(|fov| focal_from_fov(self.width, fov));
        let from_lens = self.config.intrinsics.map(|[fx, fy, ..]| (fx * fy).sqrt());
        let focal = from_lens.or(self.config.focal_px).or(from_fov);
        focal.map(|f| f * self.size.scale)
    }

    pub(super) fn free_focal(&self) -> bool {
        self.given_focal().is_none()
    }

    pub(super) fn default_focal(&self) -> f64 {
        let assumed = || focal_from_fov(self.width, self.config.default_fov_deg) * self.size.scale;
        self.given_focal().unwrap_or_else(assumed)
    }

    /// Horizontal field of view of a focal length in working pixels, degrees.
    pub(super) fn fov_deg(&self, focal: f64) -> f64 {
        2.0 * (0.5 * self.width as f64 * self.size.scale / focal)
            .atan()
            .to_degrees()
    }

    pub(super) fn solve(&mut self) -> Result<Recovered, SparseError> {
        if self.config.static_camera {
            self.warn_static("it was declared static");
            let sway = sway(&self.tracks, self.frames, &[self.default_focal()]);
            if let Some(sway) = sway.filter(|s| s.motion_px > DOUBTFUL * STATIC_MOTION_PX) {
                self.warn(format!(
                    "the camera was declared static, but most of the image moves, by up to {:.1} px (working \
                     size); undeclared, its motion would be reconstructed",
                    sway.motion_px
                ));
            }
            return Ok(self.one_pose());
        }
        self.check_tracks()?;
        let focals = match self.given_focal() {
            Some(focal) => vec![focal],
            None => focal_candidates(self.size.width),
        };
        let Some(sway) = sway(&self.tracks, self.frames, &focals) else {
            // Frames far apart have nothing in common: the camera moves a lot.
            return self.moving(&focals, self.default_focal());
        };
        if sway.motion_px < STATIC_MOTION_PX {
            self.warn_static(&format!(
                "60 % of all points move by at most {:.2} px over the clip (working size), less than {STATIC_MOTION_PX} px",
                sway.motion_px
            ));
            return Ok(self.one_pose());
        }
        let share = sway.parallax_px / self.size.width as f64;
        if share < MIN_PARALLAX {
            return self.turning(&focals, &sway);
        }
        let zoom = self.zoom(&focals)?;
        // Warnings about a translation that does not exist would mislead.
        self.quiet = zoom.is_some();
        self.limits.adapt(&sway, self.size.width);
        let moving = self.moving(&focals, sway.focal);
        self.quiet = false;
        if matches!(moving, Err(SparseError::Cancelled)) {
            return moving;
        }
        if let Some(zoom) = zoom {
            let walk = moving.as_ref().ok();
            if zoom.explains_as_much_as(walk, self.size.scale) {
                self.warnings.clear();
                return Ok(self.zoomed(zoom));
            }
            for warning in walk.map_or(&self.warnings, |walk| &walk.sparse.warnings) {
                self.progress.warn(warning);
            }
        }
        if moving.is_err() && share < KEYFRAME_PARALLAX {
            self.turning(&focals, &sway)
        } else {
            moving
        }
    }

    fn check_tracks(&self) -> Result<(), SparseError> {
        for frame in 1..self.frames {
            let count = matches(&self.tracks, frame - 1, frame).len();
            if count < MIN_TRACKS {
                return Err(SparseError::NoAgreement(format!(
                    "only {count} points could be tracked from frame {} to the next, {MIN_TRACKS} are needed (flat, dark or \
                     blurred images, or a cut); cut the clip there, or {STATIC_CAMERA} if it is, or \
                     supply a capture with poses",
                    frame - 1
                )));
            }
        }
        Ok(())
    }

    fn warn_static(&mut self, why: &str) {
        self.warn(format!(
            "the camera appears to be static: {why}; depth cannot be measured, so novel views are a guess{}",
            self.focal_note(false)
        ));
    }

    /// One pose for all frames.
    fn one_pose(&mut self) -> Recovered {
        let map = Map::new(
            self.default_focal(),
            vec![Some(Se3::identity()); self.frames],
            &self.tracks,
        );
        self.without_points(map, CameraMotion::Static, false)
    }

    /// Rotations alone.
    fn turning(&mut self, focals: &[f64], sway: &Sway) -> Result<Recovered, SparseError> {
        stopped(self.progress)?;
        let turning = turning(
            &self.tracks,
            self.frames,
            focals,
            self.default_focal(),
            self.limits.cauchy_px,
        );
        let note = self.focal_note(turning.focal_observed);
        self.warn(format!(
            "the camera rotates (by up to {:.1} degrees) but hardly translates: median parallax is at most {:.1} px where \
             {:.1} px are needed (working size); rotations only, depth cannot be measured{note}",
            sway.turn_rad.to_degrees(),
            sway.parallax_px,
            MIN_PARALLAX * self.size.width as f64
        ));
        if turning.lost > 0 {
            let (lost, frames) = (turning.lost, self.frames);
            self.warn(format!(
                "rotation could not be estimated for {lost} of {frames} frames; the previous frame's rotation was used"
            ));
        }
        Ok(self.without_points(
            turning.map,
            CameraMotion::RotationOnly,
            turning.focal_observed,
        ))
    }

    /// The reconstruction of a camera that does not translate; `focal_observed`: its rotation
    /// reveals the focal length.
    pub(super) fn without_points(
        &mut self,
        map: Map,
        camera_motion: CameraMotion,
        focal_observed: bool,
    ) -> Recovered {
        let focal = match self.given_focal() {
            Some(_) => FocalSource::Given,
            None if focal_observed => FocalSource::Estimated { sigma: None },
            None => FocalSource::Assumed,
        };
        let motions = classify(&map, &self.tracks);
        Recovered {
            sparse: self.finish(map, &motions, camera_motion),
            focal,
            distortion: None,
            tied: false,
        }
    }

    pub(super) fn focal_note(&self, focal_observed: bool) -> String {
        if focal_observed || !self.free_focal() {
            return String::new();
        }
        let fov_deg = self.config.default_fov_deg;
        format!("; a field of view of {fov_deg} degrees is assumed ({FIELD_OF_VIEW})")
    }
}

/// Feature tracks of a clip. Tracking takes most of the time of a reconstruction.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct FeatureTracks {
    pub(super) tracks: Vec<RawTrack>,
    pub(super) frames: usize,
    /// Width and height of the images.
    pub(super) size: [usize; 2],
    pub(super) working: WorkingSize,
}

/// Tracks corners through a clip.
///
/// # Errors
///
/// [`SparseError`] for frames of different size, settings out of range, and when the user stops the
/// run.
pub fn track_features(
    frames: &[&RgbImage],
    config: &SparseConfig,
    progress: &dyn Progress,
) -> Result<FeatureTracks, SparseError> {
    let (width, height) = check(frames, config)?;
    let working = WorkingSize::new(width, height, LONGEST_SIDE_PX);
    let mut tracks = track(frames, working, progress)?;
    if frames.len() > MOST_FRAMES {
        revisits::find(frames, working, &mut tracks, progress)?;
    }
    Ok(FeatureTracks {
        tracks,
        frames: frames.len(),
        size: [width, height],
        working,
    })
}

impl FeatureTracks {
    /// Estimates cameras and points from the tracks (docs/spec/front-end.md 7.1, items 1 to 5).
    ///
    /// The world is the camera of frame 0, scaled so that the median depth of all points is 1. One
    /// focal length is shared by all frames; the principal point is the image centre and pixels are
    /// square, unless [`SparseConfig::intrinsics`] says otherwise.
    ///
    /// `masks` has one mask per frame, of any size, read at the nearest pixel: tracks that mostly
    /// lie where it is above 0 are returned as dynamic and do not affect the camera.
    ///
    /// Cameras that are static or only rotate are no error: `camera_motion` and the warnings of the
    /// result say so.
    ///
    /// # Errors
    ///
    /// [`SparseError`] for clips in which nothing can be tracked or no two frames agree on a rigid
    /// scene, for masks of another number than that of the frames, and when the user stops the run.
    pub fn recover(
        &self,
        masks: Option<&[&Mask]>,
        config: &SparseConfig,
        progress: &dyn Progress,
    ) -> Result<Recovered, SparseError> {
        check_count("masks", masks.map_or(self.frames, <[_]>::len), self.frames)
            .map_err(SparseError::Input)?;
        from_tracks(self.clone(), masks, config, progress)
    }
}
