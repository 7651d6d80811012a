//! The whole way from frames to a reconstruction.

use super::degenerate::{standing, turning};
use super::luma::{LONGEST_SIDE_PX, WorkingSize};
use super::map::{Map, classify};
use super::priors::{FocalSource, Lenses, Recovered, part};
use super::rotation::{KEYFRAME_PARALLAX, Limits, Sway, focal_candidates, focal_from_fov, matches, sway};
use super::tracking::{RawTrack, track};
use super::{SparseConfig, SparseError, stopped};
use crate::classical::reconstruction::CameraMotion;
use m4_core::{Intrinsics, Mask, Progress, RgbImage};

/// Below this greatest median parallax (share of the width, rotation taken out) nothing can be triangulated and the camera counts as
/// turning only. 0.004: 2 pixels of 480, some twenty times the error of a track.
const MIN_PARALLAX: f64 = 0.004;
/// Below this motion of 60 % of all tracks over the clip the camera counts as static, working pixels.
const STATIC_MOTION_PX: f64 = 1.0;
/// A camera declared static is doubted when the image moves by this many times
/// [`STATIC_MOTION_PX`].
const DOUBTFUL: f64 = 5.0;

/// Fewest tracks from one frame to the next.
pub(super) const MIN_TRACKS: usize = 20;

/// Cameras, tracks and points of a clip from its feature tracks.
pub(super) fn from_tracks(
    features: FeatureTracks,
    masks: Option<&[Mask]>,
    config: &SparseConfig,
    progress: &dyn Progress,
) -> Result<Recovered, SparseError> {
    let ([width, height], size) = (features.size, features.working);
    let lens = config.intrinsics.map(|[fx, fy, cx, cy]| Intrinsics { width, height, fx, fy, cx, cy });
    let lenses = lens.map_or(Lenses::Centred, Lenses::Shared);
    let mut clip = Clip::new(features, masks, lenses, config, progress);
    if let Some(focal) = clip.given_focal() {
        for tracks in [&mut clip.tracks, &mut clip.masked] {
            clip.lenses.undo(tracks, size, focal);
        }
    }
    clip.solve()
}

pub(super) fn check(
    frames: &[&RgbImage],
    masks: Option<&[Mask]>,
    config: &SparseConfig,
) -> Result<(usize, usize), SparseError> {
    let refused = |what: String| Err(SparseError::Input(what));
    let Some(first) = frames.first().filter(|_| frames.len() >= 2) else {
        let found = frames.len();
        return refused(format!("the clip has {found} frame(s); at least 2 are needed to observe motion"));
    };
    let (width, height) = first.size();
    for (frame, image) in frames.iter().enumerate() {
        if image.size() != (width, height) {
            return refused(format!(
                "frame {frame} is {:?} pixels while frame 0 is {:?}; give frames of one size",
                image.size(),
                (width, height)
            ));
        }
    }
    if width.min(height) < 64 {
        return refused(format!(
            "frames of {width}x{height} pixels are too small to track points; at least 64x64 are needed"
        ));
    }
    check_count("masks", masks.map_or(frames.len(), <[_]>::len), frames.len())?;
    let range = |name, value: Option<f64>, low: f64, high: f64, range| match value {
        Some(value) if !(value > low && value < high) => Err(SparseError::Setting { name, value, range }),
        _ => Ok(()),
    };
    range("fov_deg", config.fov_deg, 1.0, 175.0, "1 to 175 degrees")?;
    range("focal_px", config.focal_px, 0.0, f64::INFINITY, "above 0 pixels")?;
    let [fx, fy, cx, cy] = config.intrinsics.map_or([None; 4], |k| k.map(Some));
    let inside = "within the image, from its corner";
    range("intrinsics fx", fx, 0.0, f64::INFINITY, "above 0 pixels")?;
    range("intrinsics fy", fy, 0.0, f64::INFINITY, "above 0 pixels")?;
    range("intrinsics cx", cx, 0.0, width as f64, inside)?;
    range("intrinsics cy", cy, 0.0, height as f64, inside)?;
    Ok((width, height))
}

/// Rejects masks and cameras of another clip.
pub(super) fn check_count(what: &str, found: usize, frames: usize) -> Result<(), SparseError> {
    if found == frames {
        return Ok(());
    }
    Err(SparseError::Input(format!("there are {found} {what} for {frames} frames; give one per frame")))
}

/// A tracked clip on its way to a reconstruction.
pub(super) struct Clip<'a> {
    pub(super) tracks: Vec<RawTrack>,
    /// Those that lie in given masks.
    pub(super) masked: Vec<RawTrack>,
    /// What was known of lenses.
    pub(super) lenses: Lenses<'a>,
    pub(super) frames: usize,
    pub(super) size: WorkingSize,
    /// Columns of the input.
    pub(super) width: usize,
    /// Rows of the input.
    pub(super) height: usize,
    pub(super) config: &'a SparseConfig,
    pub(super) limits: Limits,
    pub(super) progress: &'a dyn Progress,
    pub(super) warnings: Vec<String>,
    /// Whether warnings are kept back for now.
    pub(super) quiet: bool,
}

impl<'a> Clip<'a> {
    pub(super) fn new(
        features: FeatureTracks,
        masks: Option<&[Mask]>,
        lenses: Lenses<'a>,
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
            progress,
            warnings: Vec::new(),
            quiet: false,
        }
    }
}

impl Clip<'_> {
    pub(super) fn warn(&mut self, message: String) {
        if !self.quiet {
            self.progress.warn(&message);
        }
        self.warnings.push(message);
    }

    /// The focal length that the user gave, working pixels.
    pub(super) fn given_focal(&self) -> Option<f64> {
        let from_fov = self.config.fov_deg.map(|fov| focal_from_fov(self.width, fov));
        let from_lens = self.config.intrinsics.map(|[fx, fy, ..]| (fx * fy).sqrt());
        let focal = from_lens.or(self.config.focal_px).or(from_fov);
        focal.map(|f| f * self.size.scale)
    }

    pub(super) fn default_focal(&self) -> f64 {
        self.given_focal().unwrap_or_else(|| self.working_focal(self.config.default_fov_deg))
    }

    fn working_focal(&self, fov_deg: f64) -> f64 {
        focal_from_fov(self.width, fov_deg) * self.size.scale
    }

    /// Horizontal field of view of a focal length in working pixels, degrees.
    pub(super) fn fov_deg(&self, focal: f64) -> f64 {
        2.0 * (0.5 * self.width as f64 * self.size.scale / focal).atan().to_degrees()
    }

    pub(super) fn solve(&mut self) -> Result<Recovered, SparseError> {
        if self.config.static_camera {
            let seen = sway(&self.tracks, self.frames, &[self.default_focal()], MIN_TRACKS);
            let map = self.still("it was declared static");
            if let Some(seen) = seen.filter(|s| s.motion_px > DOUBTFUL * STATIC_MOTION_PX) {
                self.warn(format!(
                    "the camera was declared static, but most of the image moves, by up to {:.1} px (working \
                     size); without --static-camera its motion would be reconstructed",
                    seen.motion_px
                ));
            }
            return Ok(self.without_points(map, CameraMotion::Static, self.untold_focal()));
        }
        self.check_tracks()?;
        let focals = match self.given_focal() {
            Some(focal) => vec![focal],
            None => focal_candidates(self.size.width),
        };
        let Some(sway) = sway(&self.tracks, self.frames, &focals, MIN_TRACKS) else {
            // Frames far apart have nothing in common: the camera moves a lot.
            return self.moving(&focals, self.default_focal())?;
        };
        if sway.motion_px < STATIC_MOTION_PX {
            let why = format!(
                "60 % of all points move by at most {:.2} px over the clip (working size), less than {} px",
                sway.motion_px, STATIC_MOTION_PX
            );
            let map = self.still(&why);
            return Ok(self.without_points(map, CameraMotion::Static, self.untold_focal()));
        }
        let share = sway.parallax_px / self.size.width as f64;
        if share < MIN_PARALLAX {
            return self.turning(&focals, &sway);
        }
        let zoom = self.zoom(&focals)?;
        // Warnings about a translation that does not exist would mislead.
        self.quiet = zoom.is_some();
        self.limits.adapt(&sway, self.size.width);
        let moving = self.moving(&focals, sway.focal)?;
        self.quiet = false;
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
        match moving {
            Ok(found) => Ok(found),
            Err(_) if share < KEYFRAME_PARALLAX => self.turning(&focals, &sway),
            Err(no_start) => Err(no_start),
        }
    }

    fn check_tracks(&self) -> Result<(), SparseError> {
        for frame in 1..self.frames {
            let found = matches(&self.tracks, frame - 1, frame).len();
            if found < MIN_TRACKS {
                return Err(SparseError::TooFewTracks { frame: frame - 1, found, needed: MIN_TRACKS });
            }
        }
        Ok(())
    }

    /// One pose for all frames, and a warning that says why.
    fn still(&mut self, why: &str) -> Map {
        let map = standing(&self.tracks, self.frames, self.default_focal());
        self.warn(format!(
            "the camera appears to be static: {why}; depth cannot be measured, so novel views are a guess{}",
            self.focal_note()
        ));
        map
    }

    /// Rotations alone.
    fn turning(&mut self, focals: &[f64], sway: &Sway) -> Result<Recovered, SparseError> {
        stopped(self.progress)?;
        let assumed = self.default_focal();
        let found = turning(&self.tracks, self.frames, focals, assumed, MIN_TRACKS, self.limits.cauchy_px);
        let note = if found.focal_observed { String::new() } else { self.focal_note() };
        self.warn(format!(
            "the camera rotates (by up to {:.1} degrees) but hardly translates: median parallax is at most {:.1} px where \
             {:.1} px are needed (working size); rotations only, depth cannot be measured{note}",
            sway.turn_rad.to_degrees(),
            sway.parallax_px,
            MIN_PARALLAX * self.size.width as f64
        ));
        if found.lost > 0 {
            let (lost, frames) = (found.lost, self.frames);
            self.warn(format!(
                "rotation could not be estimated for {lost} of {frames} frames; the previous frame's rotation was used"
            ));
        }
        let focal = match self.untold_focal() {
            FocalSource::Assumed if found.focal_observed => FocalSource::Estimated { sigma: None },
            other => other,
        };
        Ok(self.without_points(found.map, CameraMotion::RotationOnly, focal))
    }

    pub(super) fn without_points(&mut self, map: Map, camera_motion: CameraMotion, focal: FocalSource) -> Recovered {
        let motions = classify(&map, &self.tracks);
        let sparse = self.finish(map, &motions, camera_motion);
        Recovered { sparse, focal }
    }

    /// Where the focal length comes from if not from the clip.
    pub(super) fn untold_focal(&self) -> FocalSource {
        match self.given_focal() {
            Some(_) => FocalSource::Given,
            None => FocalSource::Assumed,
        }
    }

    pub(super) fn focal_note(&self) -> String {
        match self.given_focal() {
            Some(_) => String::new(),
            None => format!(
                "; a field of view of {} degrees is assumed (give the true one with --fov)",
                self.config.default_fov_deg
            ),
        }
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
/// [`SparseError`] for frames of different size, settings out of range, and when the user stops the run.
pub fn track_features(
    frames: &[&RgbImage],
    config: &SparseConfig,
    progress: &dyn Progress,
) -> Result<FeatureTracks, SparseError> {
    track_checked(frames, check(frames, None, config)?, progress)
}

/// The same of frames that [`check`] found to have that size.
pub(super) fn track_checked(
    frames: &[&RgbImage],
    (width, height): (usize, usize),
    progress: &dyn Progress,
) -> Result<FeatureTracks, SparseError> {
    let working = WorkingSize::new(width, height, LONGEST_SIDE_PX);
    Ok(FeatureTracks {
        tracks: track(frames, working, progress)?,
        frames: frames.len(),
        size: [width, height],
        working,
    })
}

impl FeatureTracks {
    /// Estimates cameras and points from the tracks (docs/spec/front-end.md 7.1, items 1 to 5).
    ///
    /// The world is the camera of frame 0, scaled so that the median depth of all points is 1. One focal
    /// length is shared by all frames; the principal point is the image centre and pixels are square, unless
    /// [`SparseConfig::intrinsics`] says otherwise.
    ///
    /// `masks` has one mask per frame, of any size, read at the nearest pixel: tracks that mostly lie where it is above 0 are returned
    /// as dynamic and do not affect the camera.
    ///
    /// Cameras that are static or only rotate are no error: `camera_motion` and the warnings of the result say so.
    ///
    /// # Errors
    ///
    /// [`SparseError`] for clips in which nothing can be tracked or no two frames agree on a rigid scene, for masks of
    /// another number than that of the frames, and when the user stops the run.
    pub fn recover(
        &self,
        masks: Option<&[Mask]>,
        config: &SparseConfig,
        progress: &dyn Progress,
    ) -> Result<Recovered, SparseError> {
        check_count("masks", masks.map_or(self.frames, <[_]>::len), self.frames)?;
        from_tracks(self.clone(), masks, config, progress)
    }
}
