//! Computes a capture with MegaSaM's networks (Minute4D sec. 3.1).

use super::compute::{Clip, instants, moments};
use super::frontend::{MonoClip, NetworkCorrespondence, Plan};
use super::given::{Given, GivenError};
use super::kept::KeptFlow;
use crate::device::NetworkDevice;
use crate::record::GeometrySummary;
use crate::steps::Steps;
use crate::{Error, Observer, Settings};
use m4_core::{Camera, Capture, CaptureFrame, CompactMask, DepthMap, Intrinsics, Plane, RgbImage, Video};
use m4_geometry::megasam::{
    DepthPrior, MegasamGeometry, MegasamInput, PairFlow, SourceFlow, TAU_MOTION, TrackingSize, reconstruct,
    resize_bilinear,
};

/// Share of moving pixels beyond which it is likelier that the network is misread than that so much moves (docs/spec/front-end.md 1.9).
const TOO_MUCH_MOTION: f64 = 0.6;

/// Finds geometry of `clip`.
pub(super) fn compute(
    clip: Clip,
    settings: &Settings,
    plan: &Plan,
    device: &NetworkDevice,
    steps: &Steps<'_>,
    observer: &dyn Observer,
) -> Result<(Capture, GeometrySummary), Error> {
    let Clip { video, given, focal_px } = clip;
    if given.cameras.is_some() {
        return Err(GivenError::CamerasTwice.into());
    }
    let images: Vec<&RgbImage> = video.frames.iter().map(|f| &f.rgb).collect();
    let full = images.first().map_or((0, 0), |p| p.size());
    let size = TrackingSize::new(full, settings.megasam.tracking_pixels)?;
    let known_focal_px = given.lens.map(|lens| lens.fx).or(focal_px);
    let mono = match &given.depth {
        Some(_) => None,
        None => plan.depth(&images, known_focal_px, device, steps, observer)?,
    };
    let prior = match (&given.depth, &mono) {
        (Some(maps), _) => Some(DepthPrior::metric(maps, &size)?),
        (None, Some(mono)) => Some(mono.prior(&size)?),
        (None, None) => None,
    };
    let fov_rad = mono.as_ref().and_then(|m: &MonoClip| m.fov_rad);
    drop(mono);
    let lens = given.lens.unwrap_or_else(|| {
        let fov_rad = fov_rad.unwrap_or(settings.megasam.default_fov_deg.to_radians());
        let of_fov = 0.5 * full.0 as f64 / (0.5 * fov_rad).tan();
        Intrinsics::centred(full.0, full.1, known_focal_px.unwrap_or(of_fov))
    });
    let times_s: Vec<f64> = instants(&video);
    let masks = given.masks.as_deref();
    let budget_mb = settings.megasam.memory_budget_mb;
    let input = MegasamInput {
        images: &images,
        times_s: &times_s,
        lens,
        focal_is_free: known_focal_px.is_none(),
        prior: prior.as_ref(),
    };
    let geometry = steps.keep("megasam", |observer| -> Result<_, Error> {
        let mut network = NetworkCorrespondence::load(plan, &images, masks, size, budget_mb, &device.device)?;
        let iterations = settings.megasam.flow_iterations;
        let (source, kept);
        let mut flow: Box<dyn PairFlow + '_> = match plan.raft_pairs(iterations, device)? {
            Some(raft) => raft,
            None => {
                source = plan.flow(iterations, device)?;
                kept = KeptFlow {
                    source: source.as_ref(),
                    cache: steps,
                };
                Box::new(SourceFlow(&kept))
            }
        };
        Ok(reconstruct(
            &input,
            &mut network,
            flow.as_mut(),
            &settings.megasam,
            observer,
            &steps.part("megasam"),
        )?)
    })?;
    drop(prior);
    warn(&geometry, known_focal_px.is_some() || fov_rad.is_some(), observer);
    drop(images);
    let capture = assemble(video, &geometry, &given);
    let found = summary(&capture, &geometry, plan, &given);
    if found.moving_share > TOO_MUCH_MOTION {
        observer.warn(&format!(
            "{:.0} % of all pixels count as moving; if that is wrong, give masks of your own with --masks",
            100.0 * found.moving_share
        ));
    }
    Ok((capture, found))
}

fn warn(geometry: &MegasamGeometry, focal_is_known: bool, observer: &dyn Observer) {
    if !geometry.observability.has_parallax() {
        observer.warn("the camera hardly moves sideways: depth is monocular, and views from the side will be wrong");
    }
    if !geometry.focal_adjusted && !focal_is_known {
        observer.warn("the clip does not tell its focal length; a usual one was taken: --fov or --intrinsics sets it");
    }
}

fn assemble(video: Video, geometry: &MegasamGeometry, given: &Given) -> Capture {
    let n = video.frames.len();
    let (moments, duration_s) = moments(&video);
    let frames = video.frames.into_iter().enumerate().map(|(i, frame)| {
        let (w, h) = geometry.size.scaled;
        let motion = geometry.static_at(i, w, h).map(|&m| 1.0 - m.clamp(0.0, 1.0));
        let mask = match &given.masks {
            Some(masks) => masks[i].clone().into(),
            None => mask(&motion, frame.rgb.size()),
        };
        CaptureFrame {
            name: format!("{i:05}"),
            camera: Camera {
                intrinsics: geometry.lens,
                c2w: geometry.c2w[i],
            },
            t: moments[i],
            rgb: frame.rgb,
            depth: Some(DepthMap::clone(&geometry.depth[i]).into()),
            mask: Some(mask),
            motion: Some(motion.map(|p| (255.0 * p).round() as u8)),
            instances: None,
            camera_index: None,
        }
    });
    Capture {
        frames: frames.collect(),
        time_frames: n,
        duration_s,
        metric: geometry.metric,
        tracks: None,
    }
}

/// The dynamic part, at the size of the image.
fn mask(motion: &Plane<f32>, (width, height): (usize, usize)) -> CompactMask {
    let full = resize_bilinear(motion, width, height);
    CompactMask::from_fn(width, height, |x, y| f64::from(full.row(y)[x]) > TAU_MOTION)
}

fn summary(capture: &Capture, geometry: &MegasamGeometry, plan: &Plan, given: &Given) -> GeometrySummary {
    let lens = geometry.lens;
    let pixels = lens.width * lens.height * capture.frames.len();
    let masks = capture.frames.iter().filter_map(|f| f.mask.as_ref());
    let moving: usize = masks.map(CompactMask::count).sum();
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
        tracks: 0,
        points: 0,
        moving_tracks: 0,
        moving_share: moving as f64 / pixels.max(1) as f64,
        frontend: plan.frontend.to_string(),
        networks: plan.used.clone(),
        keyframes: Some(geometry.keyframes.clone()),
        megasam_units_a_metre: geometry.metric.then_some(geometry.norm),
        segmenter: "none".to_owned(),
        given: given.names(),
        rounds: 1,
        confidence: None,
    }
}
