//! Computes a capture with MegaSaM's networks (Minute4D Eq. 3, Minute4D sec. 3.1).

use super::Context;
use super::GeometrySummary;
use super::clip::{Clip, FrameGeometry};
use super::frontend::NetworkCorrespondence;
use crate::{Error, Refusal, enhance};
use m4_core::advice::{FIELD_OF_VIEW, INTRINSICS, MASKS};
use m4_core::{Camera, Capture, CompactMask, Intrinsics, Mask, Plane, Progress};
use m4_geometry::flow::InverseSearch;
use m4_geometry::megasam::{
    MegasamGeometry, MegasamInput, PairFlow, TAU_MOTION, TrackingSize, reconstruct, track,
};
use m4_geometry::resample::resize_bilinear;

/// Share of dynamic pixels beyond which the output of the network is more likely misread than right
/// (docs/spec/front-end.md 1.9).
const TOO_MUCH_MOTION: f64 = 0.6;

/// Reconstructs `clip`; refused where poses were given.
pub(super) fn compute(
    mut clip: Clip,
    context: &Context<'_>,
) -> Result<(Capture, GeometrySummary), Error> {
    let (settings, steps, observer) = (
        &context.settings().megasam,
        context.steps,
        context.observer(),
    );
    let (plan, device) = (&context.plan.frontend, &context.plan.device);
    let given = &clip.given;
    if given.cameras.is_some() {
        let message = "the front end megasam estimates the poses itself: omit given poses, or choose another front end";
        return Err(Refusal::bad_input(message).into());
    }
    let images = clip.images();
    let full = images.first().map_or((0, 0), |p| p.size());
    let size = TrackingSize::new(full, settings.tracking_pixels)?;
    let known_focal_px = given.lens.map(|lens| lens.intrinsics.fx).or(clip.focal_px);
    let mono = match given.depth {
        Some(_) => None,
        None => plan.depth(&images, known_focal_px, device, steps)?,
    };
    let depth = given.depth.as_ref().or(mono.as_ref());
    let prior = depth.map(|depth| depth.prior(&size)).transpose()?;
    let fov_rad = depth.and_then(|mono| mono.fov_rad);
    drop(mono);
    let lens = given.lens.map(|lens| lens.intrinsics).unwrap_or_else(|| {
        let fov_rad = fov_rad.unwrap_or(settings.default_fov_deg.to_radians());
        let of_fov = 0.5 * full.0 as f64 / (0.5 * fov_rad).tan();
        Intrinsics::centred(full.0, full.1, known_focal_px.unwrap_or(of_fov))
    });
    let times_s: Vec<f64> = clip.video.frames.iter().map(|f| f.time_s).collect();
    let input = MegasamInput {
        images: &images,
        times_s: &times_s,
        lens,
        focal_is_free: known_focal_px.is_none(),
        prior: prior.as_ref(),
    };
    let tracked = steps.keep("cameras", |observer| -> Result<_, Error> {
        let (masks, budget_mb) = (given.masks.as_deref(), settings.memory_budget_mb);
        let mut network =
            NetworkCorrespondence::load(plan, &images, masks, size, budget_mb, &device.device)?;
        Ok(track(&input, &mut network, settings, observer)?)
    })?;
    let geometry = steps.keep("dense", |observer| -> Result<_, Error> {
        let raft = plan.raft_pairs(settings.flow_iterations, device)?;
        let mut flow: Box<dyn PairFlow> = raft.unwrap_or_else(|| Box::new(InverseSearch));
        Ok(reconstruct(
            &input,
            tracked,
            flow.as_mut(),
            settings,
            observer,
        )?)
    })?;
    drop(prior);
    warn(
        &geometry,
        known_focal_px.is_some() || fov_rad.is_some(),
        observer,
    );
    let given_names = given.names();
    let frames = frames(&geometry, full, clip.given.masks.take());
    let capture = clip.capture(frames, geometry.metric, None);
    let summary = summary(&capture, &geometry, context, given_names);
    if summary.moving_share > TOO_MUCH_MOTION {
        observer.warn(&format!(
            "{:.0} % of all pixels count as moving; if that is wrong, {MASKS}",
            100.0 * summary.moving_share
        ));
    }
    Ok((capture, summary))
}

fn warn(geometry: &MegasamGeometry, focal_is_known: bool, observer: &dyn Progress) {
    if !geometry.observability.has_parallax() {
        observer.warn("the camera hardly moves sideways: depth is monocular, and views from the side will be wrong");
    }
    if !geometry.focal_adjusted && !focal_is_known {
        observer.warn(&format!(
            "the clip does not tell its focal length; a usual one was taken: {FIELD_OF_VIEW}, or {INTRINSICS}"
        ));
    }
}

/// Cameras, depth and masks of images of the size `full`; masks that the user provides replace
/// those of the network.
fn frames(
    geometry: &MegasamGeometry,
    full: (usize, usize),
    masks: Option<Vec<Mask>>,
) -> impl Iterator<Item = FrameGeometry> {
    (0..geometry.c2w.len()).map(move |i| {
        let (w, h) = geometry.size.scaled;
        let motion = geometry
            .static_at(i, w, h)
            .map(|&m| 1.0 - m.clamp(0.0, 1.0));
        FrameGeometry {
            camera: Camera {
                intrinsics: geometry.lens,
                c2w: geometry.c2w[i],
            },
            depth: geometry.depth[i].clone().into(),
            mask: match &masks {
                Some(masks) => masks[i].clone().into(),
                None => mask(&motion, full),
            },
            motion: Some(motion.map(|p| (255.0 * p).round() as u8)),
        }
    })
}

/// The dynamic part, at the size of the image.
fn mask(motion: &Plane<f32>, (width, height): (usize, usize)) -> CompactMask {
    let full = resize_bilinear(motion, width, height);
    CompactMask::from_fn(width, height, |x, y| f64::from(full.row(y)[x]) > TAU_MOTION)
}

fn summary(
    capture: &Capture,
    geometry: &MegasamGeometry,
    context: &Context<'_>,
    given_names: Vec<String>,
) -> GeometrySummary {
    let plan = &context.plan.frontend;
    let lens = geometry.lens;
    GeometrySummary {
        frames: capture.frames.len(),
        size: [lens.width, lens.height],
        focal_px: lens.fx,
        fov_deg: lens.horizontal_fov_rad().to_degrees(),
        camera_motion: if geometry.observability.has_parallax() {
            "parallax"
        } else {
            "rotation_only"
        }
        .to_owned(),
        residual_px: geometry.residual_px,
        moving_share: enhance::moving_share(capture).unwrap_or(0.0),
        frontend: plan.frontend.to_string(),
        networks: plan.used.clone(),
        keyframes: Some(geometry.keyframes.clone()),
        megasam_units_a_metre: geometry.metric.then_some(geometry.norm),
        segmenter: "none".to_owned(),
        given: given_names,
        rounds: 1,
        ..GeometrySummary::default()
    }
}
