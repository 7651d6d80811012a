//! The front end without weights (Minute4D Eq. 3): cameras from tracked corners, depth and masks
//! along the flow, and both once more without the tracks of dynamic regions.

use super::Context;
use super::GeometrySummary;
use super::clip::{Clip, FrameGeometry};
use super::lens;
use crate::Error;
use crate::cache::Steps;
use crate::observer::Recording;
use m4_core::advice::DEPTH_WEIGHTS;
use m4_core::{Camera, Capture, Mask, RgbImage, Tracks};
use m4_geometry::classical::again::Second;
use m4_geometry::classical::confidence::{Circumstances, Confidence, Grade};
use m4_geometry::classical::dense::{Dense, MeasureFlow, Segmenter, Sources, estimate};
use m4_geometry::classical::sparse::{
    self, FeatureTracks, RadialDistortion, Recovered, SparseConfig,
};
use m4_geometry::classical::{CameraMotion, SparseReconstruction};
use m4_geometry::clip_depth::{ClipDepth, unit};

/// Reconstructs `clip`.
pub(super) fn compute(
    mut clip: Clip,
    context: &Context<'_>,
) -> Result<(Capture, GeometrySummary), Error> {
    let (mut context, mut distortion) = (*context, None);
    let (reconstruction, followed, recovered) = loop {
        match attempt(&clip, context)? {
            Ok(cameras) => break cameras,
            Err(lens) => {
                context.observer().warn(&lens::note(&lens));
                clip.straighten(&clip.lens(&lens))?;
                clip.sparse.pinhole = true;
                context.steps = context.steps.named("straight-");
                distortion = Some(lens);
            }
        }
    };
    let chosen = clip.keep_for_depth();
    let (pass, mut summary) = reconstruction.run(&clip, &chosen, &followed, recovered)?;
    summary.distortion = distortion;
    let (cameras, dense) = (pass.recovered.sparse.cameras, pass.dense);
    let frames = cameras
        .into_iter()
        .zip(dense.frames)
        .map(|(camera, dense)| FrameGeometry {
            camera,
            depth: dense.depth.into(),
            mask: dense.mask.into(),
            motion: None,
        });
    Ok((clip.capture(frames, pass.metric, dense.tracks), summary))
}

/// What goes on to depth: the sources, and tracks and cameras of all frames.
type Tracked<'a> = (Reconstruction<'a>, FeatureTracks, Recovered);

/// Cameras of all frames of `clip` as of a pinhole; the inner error is the lens that it turns out
/// to have.
fn attempt<'a>(
    clip: &Clip,
    context: Context<'a>,
) -> Result<Result<Tracked<'a>, RadialDistortion>, Error> {
    let mut reconstruction = Reconstruction::new(clip, context)?;
    let (followed, recovered) = reconstruction.first_cameras(clip)?;
    if let Some(lens) = recovered.distortion {
        return Ok(Err(lens));
    }
    reconstruction.config.pinhole = true;
    Ok(Ok((reconstruction, followed, recovered)))
}

/// The sources of flow, masks and depth of a clip.
struct Reconstruction<'a> {
    context: Context<'a>,
    config: SparseConfig,
    flow: Box<MeasureFlow<'a>>,
    segmenter: Option<Box<Segmenter<'static>>>,
    /// What networks know of the frames with depth, unless the user gave depth.
    mono: Option<ClipDepth>,
}

/// Cameras, and what was found with them.
struct Pass {
    /// Of the frames with depth.
    recovered: Recovered,
    /// Of all frames, where these are more.
    all: Option<SparseReconstruction>,
    dense: Dense,
    /// Whether lengths are metres.
    metric: bool,
}

impl<'a> Reconstruction<'a> {
    fn new(clip: &Clip, context: Context<'a>) -> Result<Self, Error> {
        let plan = context.plan;
        let flow = plan.frontend.flow(
            context.settings().megasam.flow_iterations,
            &plan.device,
            context.steps,
        )?;
        let segmenter = plan.segmenter.load()?;
        let mono = match clip.given.depth {
            Some(_) => None,
            None => {
                let all = clip.images();
                let images: Vec<&RgbImage> = clip.for_depth().into_iter().map(|i| all[i]).collect();
                plan.frontend
                    .depth(&images, clip.focal_px, &plan.device, context.steps)?
            }
        };
        let mut config = clip.sparse.clone();
        if let Some(fov_rad) = mono.as_ref().and_then(|mono| mono.fov_rad) {
            config.default_fov_deg = fov_rad.to_degrees();
        }
        Ok(Self {
            context,
            config,
            flow,
            segmenter,
            mono,
        })
    }

    /// Tracks and cameras, with the advice that comes before all warnings.
    fn first_cameras(&self, clip: &Clip) -> Result<(FeatureTracks, Recovered), Error> {
        let held = Recording::holding(self.context.observer());
        let outcome = self.cameras(clip, self.context.steps.observed_by(&held));
        let is_flat = |(_, recovered): &(FeatureTracks, Recovered)| {
            recovered.sparse.camera_motion != CameraMotion::Parallax
        };
        let lacks_depth = self.context.plan.frontend.lacks_depth && clip.given.depth.is_none();
        if lacks_depth && outcome.as_ref().is_ok_and(is_flat) {
            // before all other warnings of such a clip
            let warning = format!("this clip has no parallax to measure depth by: {DEPTH_WEIGHTS}");
            self.context.observer().warn(&warning);
        }
        // Those of a lens that bends are repeated once the frames are straight.
        if !outcome
            .as_ref()
            .is_ok_and(|(_, recovered)| recovered.distortion.is_some())
        {
            held.release();
        }
        outcome
    }

    /// Depth, masks and tracks of `clip`, which holds the frames `chosen` of those with cameras.
    fn run(
        &self,
        clip: &Clip,
        chosen: &[usize],
        followed: &FeatureTracks,
        recovered: Recovered,
    ) -> Result<(Pass, GeometrySummary), Error> {
        let mut pass = self.pass("dense", clip, chosen, recovered)?;
        let mut rounds = 1;
        if clip.given.masks.is_none() && clip.given.cameras.is_none() {
            let better = self.second_cameras(followed, &pass, chosen)?;
            if let Some(better) = better {
                // Memory holds one result at a time.
                drop(pass);
                pass = self.pass("second-dense", clip, chosen, better)?;
                rounds = 2;
            }
        }
        let summary = self.summary(clip, &pass, rounds);
        Ok((pass, summary))
    }

    /// Cameras from the tracks outside the masks of `pass`, if they differ enough from its own for
    /// depth and masks to be estimated again.
    fn second_cameras(
        &self,
        followed: &FeatureTracks,
        pass: &Pass,
        chosen: &[usize],
    ) -> Result<Option<Recovered>, Error> {
        const PHASE: &str = "cameras from static points";
        let first = pass.all.as_ref().unwrap_or(&pass.recovered.sparse);
        let Some(second) = Second::of(first, &pass.dense.frames, chosen) else {
            return Ok(None);
        };
        let observer = self.context.observer();
        observer.update(PHASE, 0, 1, "");
        // The warnings of the second pass repeat those of the first, or are given when its result
        // is used.
        let recovered = self.context.steps.keep("second-cameras", |observer| {
            second.estimate(followed, &self.config, &Recording::holding(observer))
        })?;
        let (better, note) = recovered
            .as_ref()
            .map_or_else(Default::default, |r| second.is_better(&r.sparse));
        observer.update(PHASE, 1, 1, &note);
        Ok(recovered.filter(|_| better))
    }

    /// Tracks and cameras.
    fn cameras(&self, clip: &Clip, steps: Steps<'_>) -> Result<(FeatureTracks, Recovered), Error> {
        let (config, given) = (&self.config, &clip.given);
        let masks: Option<Vec<&Mask>> = given.masks.as_ref().map(|masks| masks.iter().collect());
        let (images, masks) = (&clip.images(), masks.as_deref());
        let result = steps.keep("cameras", |observer| {
            let followed = sparse::track_features(images, config, observer)?;
            let recovered = match &given.cameras {
                Some(cameras) => followed.with_cameras(cameras, masks, config, observer)?,
                None => followed.recover(masks, config, observer)?,
            };
            Ok::<_, sparse::SparseError>((followed, recovered))
        })?;
        Ok(result)
    }

    /// Sets the unit of length, and estimates depth, masks and tracks as the step `name`.
    fn pass(
        &self,
        name: &str,
        clip: &Clip,
        chosen: &[usize],
        mut recovered: Recovered,
    ) -> Result<Pass, Error> {
        let given = &clip.given;
        let (settings, observer) = (self.context.settings(), self.context.observer());
        for warning in &recovered.sparse.warnings {
            observer.warn(warning);
        }
        let thinned = (chosen.len() < recovered.sparse.cameras.len())
            .then(|| recovered.sparse.at_frames(chosen));
        let all = thinned.map(|thinned| std::mem::replace(&mut recovered.sparse, thinned));
        let mono = given.depth.as_ref().or(self.mono.as_ref());
        let posed = given.cameras.is_some();
        let metric = match mono {
            Some(mono) => mono.set_unit(&mut recovered.sparse, posed, observer)?,
            None => false,
        };
        // In a unit in which the scene is about 1 away, as the settings expect.
        let unit = unit(mono, &recovered.sparse, posed);
        let scaled = (unit != 1.0).then(|| recovered.sparse.scaled(1.0 / unit));
        let sparse = scaled.as_ref().unwrap_or(&recovered.sparse);
        let mono = mono.and_then(|mono| mono.maps(unit));
        let sources = Sources {
            flow: &*self.flow,
            segmenter: self.segmenter.as_deref(),
            mono,
        };
        let (images, masks) = (clip.images(), given.masks.as_deref());
        let estimated = self.context.steps.keep(name, |observer| {
            estimate(
                &images,
                clip.rate(),
                sparse,
                &sources,
                masks,
                &settings.dense,
                observer,
            )
        })?;
        let mut dense = estimated.enlarge(&images, observer)?;
        if unit != 1.0 {
            for z in dense.frames.iter_mut().flat_map(|f| f.depth.data_mut()) {
                *z *= unit as f32;
            }
            dense.tracks = dense.tracks.map(|tracks| tracks.scaled(unit as f32));
        }
        Ok(Pass {
            recovered,
            all,
            dense,
            metric,
        })
    }

    /// Grades the result, warns of a doubtful one, and describes it.
    fn summary(&self, clip: &Clip, pass: &Pass, rounds: usize) -> GeometrySummary {
        let (dense, plan, given) = (&pass.dense, self.context.plan, &clip.given);
        let sparse = pass.all.as_ref().unwrap_or(&pass.recovered.sparse);
        let known_depth = given.depth.as_ref().and_then(ClipDepth::known_share);
        let around = Circumstances {
            camera_motion: sparse.camera_motion,
            masks_given: given.masks.is_some(),
            tied: pass.recovered.tied,
            depth_given: known_depth.is_some(),
            depth_predicted: self.mono.is_some(),
        };
        let confidence = Confidence::of(
            sparse,
            pass.recovered.focal,
            &dense.frames,
            known_depth,
            around,
        );
        if let (true, Some(advice)) = (confidence.grade != Grade::Good, &confidence.advice) {
            let warning = format!("geometry is {}: {advice}", confidence.grade.name());
            self.context.observer().warn(&warning);
        }
        let lens = sparse.cameras.first().map(|c: &Camera| c.intrinsics);
        let pixels: usize = dense.frames.iter().map(|d| d.mask.data().len()).sum();
        let dynamic = dense
            .frames
            .iter()
            .flat_map(|d| d.mask.data())
            .filter(|&&m| m != 0);
        GeometrySummary {
            frames: sparse.cameras.len(),
            size: lens.map_or([0, 0], |k| [k.width, k.height]),
            focal_px: lens.map_or(0.0, |k| k.fx),
            fov_deg: lens.map_or(0.0, |k| k.horizontal_fov_rad().to_degrees()),
            camera_motion: match sparse.camera_motion {
                CameraMotion::Parallax => "parallax",
                CameraMotion::RotationOnly => "rotation_only",
                CameraMotion::Static => "static",
            }
            .to_owned(),
            residual_px: sparse.residual_px,
            tracks: sparse.tracks.len(),
            points: sparse.tracks.iter().filter(|t| t.point.is_some()).count(),
            moving_tracks: dense.tracks.as_ref().map_or(0, Tracks::count),
            objects: dense.objects.clone(),
            moving_share: dynamic.count() as f64 / pixels.max(1) as f64,
            frontend: plan.frontend.frontend.to_string(),
            networks: plan.frontend.used.clone(),
            segmenter: plan.segmenter.name().to_owned(),
            given: given.names(),
            rounds,
            confidence: Some(confidence),
            ..GeometrySummary::default()
        }
    }
}
