//! Scores a scene on held-out views by the rules of a protocol.

use super::choices::{
    Choices, FrameChoice, Headline, MaskChoice, PoseChoice, PoseTreatment, ResolutionChoice, poses,
};
use super::covisible::{MaskSource, Masks};
use super::perceptual::Perceptual;
use super::poses::{Moved, Refiner};
use super::protocol::{FrameRule, Protocol, Rules, StartPose};
use super::split::SplitRecord;
use crate::error::Error;
use crate::held_out::{EvalOptions, HeldOut};
use m4_core::{Camera, CompactMask};
use m4_eval::image::{ImageReport, MeanScore, Metric, PlanarImage, PsnrKind};
use m4_kernels::{Frame, SimdLevel};
use minute4d::observer::check_stop;
use minute4d::render::SceneRenderer;
use minute4d::{Observer, Refusal};
use std::path::Path;
use std::time::Instant;

/// Cameras closer than this (share of the path's length, entries of the rotation) took one image.
const SAME_POSE: f64 = 1e-4;
/// Moments closer than this are one, frames.
const SAME_MOMENT: f64 = 1e-3;
const RENDER: &str = "32-bit colours of the renderer without exposure, not rounded to 8 bits; clamped to 0..1 unless a metric says otherwise";
const UNCLAMPED: &str = "psnr_per_channel_unclamped";

/// Scores of a scene by a protocol.
pub(super) struct Scored {
    pub images: ImageReport,
    pub choices: Choices,
    pub drawing_s: f64,
}

/// Whether a capture can be judged by a protocol, and how it was split.
pub(super) fn check(
    data: &Path,
    protocol: Protocol,
    options: &EvalOptions,
) -> Result<Option<SplitRecord>, Error> {
    let rules = protocol.rules();
    if options.refine_poses && rules.refine.is_none() {
        let message = format!(
            "the protocol {protocol} does not refine the poses of test images; omit --refine-poses"
        );
        return Err(Refusal::usage(message).into());
    }
    let folder = if data.is_dir() {
        data
    } else {
        data.parent().unwrap_or(data)
    };
    let split = SplitRecord::read(folder)?;
    let not_split = |reason: String| Err(not_split(data, protocol, &reason).into());
    match (rules.frames, split) {
        (FrameRule::TestSplit, None) => Ok(None),
        (FrameRule::TestSplit, Some(split)) => {
            let held = split.protocol;
            not_split(format!(
                "its held-out views are frames of the training video, by the protocol {held}"
            ))
        }
        (_, None) => not_split("it has no split.json".to_owned()),
        (rule, Some(split)) => {
            if split.protocol != protocol {
                return not_split(format!(
                    "its split.json names the protocol {}",
                    split.protocol
                ));
            }
            if split.frame_rule != rule
                || rule.held_out(split.frames).as_ref() != Some(&split.held_out)
            {
                return not_split("its split.json lists other frames".to_owned());
            }
            Ok(Some(split))
        }
    }
}

/// The refusal of a capture whose held-out frames are not those of the protocol, with the reason.
fn not_split(data: &Path, asked: Protocol, reason: &str) -> Refusal {
    Refusal::bad_input(format!(
        "{} was not split by the protocol {asked} ({reason}); `minute4d split CAPTURE --protocol {asked} -o NEW` writes such a capture \
         for training and evaluation",
        data.display()
    ))
}

/// Scores the views.
pub(super) fn score(
    held: &HeldOut,
    data: &Path,
    protocol: Protocol,
    split: Option<SplitRecord>,
    options: &EvalOptions,
    (level, renderer): (SimdLevel, &mut SceneRenderer<'_>),
    observer: &dyn Observer,
) -> Result<Scored, Error> {
    let rules = protocol.rules();
    let views = &held.test.frames;
    if let Some(split) = split.as_ref().filter(|s| s.held_out.len() != views.len()) {
        let (here, n_held_out) = (views.len(), split.held_out.len());
        let reason = format!("it lists {here} views where split.json has {n_held_out}");
        return Err(not_split(data, protocol, &reason).into());
    }
    let masks = if rules.covisible {
        Masks::find(data, options.covisible.as_deref(), options.reach, observer)?
    } else {
        Masks::None
    };
    let masked = masks.source() != MaskSource::None;
    let size = views.first().map_or((0, 0), |v| v.rgb.size());
    let scored_px = [size.0, size.1];
    if let Some([w, h]) = rules.size_px.filter(|px| *px != scored_px) {
        observer.warn(&format!(
            "published numbers of the protocol {protocol} are of {w} x {h} pixels, these of {} x {}: they do not compare",
            size.0, size.1
        ));
    }
    let lpips = Perceptual::load(rules.lpips, masked, size.0.min(size.1), options.device)?;
    let mut refiner = options
        .refine_poses
        .then(|| Refiner::new(&held.scene, level));
    let name = format!("{}: {}", rules.name, data.display());
    let mut images = ImageReport::new(name.clone(), options.grow_mask);
    let mut unrefined = ImageReport::new(name.clone(), options.grow_mask);
    let mut without = ImageReport::new(name, options.grow_mask);
    let mut also_training = Vec::new();
    let mut moved: Vec<Moved> = Vec::new();
    let (mut drawing_s, mut share) = (0.0, 0.0);
    for (i, view) in views.iter().enumerate() {
        check_stop(observer, "eval", false)?;
        let (t, reference) = (held.moment(view), PlanarImage::from(&view.rgb));
        let moving = view.mask.as_ref().map(CompactMask::to_mask);
        let view_camera = held.camera(view);
        let mut camera = view_camera;
        if let (Some(refiner), Some(rule)) = (&mut refiner, &rules.refine) {
            let frame = renderer.frame(&view_camera, t)?;
            unrefined.add(
                &view.name,
                t,
                view.camera_index,
                &clamped(&frame)?,
                &reference,
                moving.as_ref(),
            )?;
            let start = match rule.start {
                StartPose::Given => view_camera,
                StartPose::NearestTraining => nearest(held, &view_camera, t),
            };
            let (estimate, went) = refiner.refine(&start, t, &reference, rule, observer)?;
            camera = estimate;
            moved.push(went);
        }
        let begin = Instant::now();
        let frame = renderer.frame(&camera, t)?;
        drawing_s += begin.elapsed().as_secs_f64();
        let image = clamped(&frame)?;
        let score = images.add(
            &view.name,
            t,
            view.camera_index,
            &image,
            &reference,
            moving.as_ref(),
        )?;
        let note = format!("{:.2} dB", score.psnr_db);
        for &metric in rules.whole {
            if metric == Metric::Psnr(PsnrKind::PerChannel) {
                let raw = raw(&frame)?;
                if let Some(score) = metric.score(&raw, &reference, None)? {
                    let title = format!("{}, not clamped", metric.title());
                    images.add_other(UNCLAMPED, &title, score);
                }
            }
            images.add_metric(metric, &image, &reference, None)?;
        }
        let mask = masks.mask(view)?;
        if let Some(mask) = &mask {
            let counted = mask.data().iter().filter(|&&m| m != 0).count();
            share += counted as f64 / mask.data().len().max(1) as f64;
            for &metric in rules.inside {
                images.add_metric(metric, &image, &reference, Some(mask))?;
            }
        }
        lpips.score(&mut images, &view.name, &image, &reference, mask.as_ref())?;
        if took_part(held, &view_camera, t) {
            also_training.push(view.name.clone());
        } else {
            without.add(
                &view.name,
                t,
                view.camera_index,
                &image,
                &reference,
                moving.as_ref(),
            )?;
        }
        observer.update("eval", i + 1, views.len(), &note);
    }
    let (treatment, words, geometry_saw_held_out) = poses(held.alignment.as_ref(), split.as_ref());
    let poses = PoseChoice {
        treatment: if refiner.is_some() {
            PoseTreatment::Refined
        } else {
            treatment
        },
        words: pose_words(rules, words, refiner.is_some()),
        geometry_saw_held_out,
        refinement_of_protocol: rules.refine,
        moved,
        mean_unrefined: unrefined.mean(),
    };
    let frames = FrameChoice {
        rule: rules.frames,
        words: rules.frames.description(),
        scored: views.iter().map(|v| v.name.clone()).collect(),
        of_frames: split.as_ref().map(|s| s.frames),
        indices: split.map(|s| s.held_out),
        mean_without: without
            .mean()
            .filter(|_: &MeanScore| !also_training.is_empty()),
        also_training,
    };
    let choices = Choices {
        protocol,
        title: rules.title,
        task: rules.task,
        frames,
        resolution: ResolutionChoice {
            scored_px,
            protocol_px: rules.size_px,
        },
        mask: MaskChoice {
            source: masks.source(),
            words: masks.description(),
            share: masked.then(|| share / views.len().max(1) as f64),
        },
        render: RENDER.to_owned(),
        metrics: metrics(&images),
        lpips: lpips.choices,
        poses,
        headline: headline(rules, &images),
        note: rules.note,
    };
    Ok(Scored {
        images,
        choices,
        drawing_s,
    })
}

fn planes(frame: &Frame) -> [&[f32]; 3] {
    frame.rgb.each_ref().map(Vec::as_slice)
}

fn clamped(frame: &Frame) -> Result<PlanarImage, Error> {
    Ok(PlanarImage::from_planes(
        frame.width,
        frame.height,
        planes(frame),
    )?)
}

fn raw(frame: &Frame) -> Result<PlanarImage, Error> {
    Ok(PlanarImage::from_planes_unclamped(
        frame.width,
        frame.height,
        planes(frame),
    )?)
}

/// The view's lens at the pose of the training frame that is nearest in time.
fn nearest(held: &HeldOut, view: &Camera, t: f64) -> Camera {
    let apart = |s: &&m4_core::SourceFrame| (s.t - t).abs();
    let closest = held
        .scene
        .source
        .iter()
        .min_by(|a, b| apart(a).total_cmp(&apart(b)));
    closest.map_or(*view, |s| Camera {
        c2w: s.camera.c2w,
        ..*view
    })
}

/// Whether a training frame was taken from the same place at the same moment.
fn took_part(held: &HeldOut, view: &Camera, t: f64) -> bool {
    let source = &held.scene.source;
    let length: f64 = source
        .windows(2)
        .map(|w| (w[1].camera.centre() - w[0].camera.centre()).norm())
        .sum();
    let limit = SAME_POSE * if length > 0.0 { length } else { 1.0 };
    source.iter().any(|s| {
        (s.t - t).abs() <= SAME_MOMENT
            && (s.camera.centre() - view.centre()).norm() <= limit
            && (s.camera.c2w.rotation - view.c2w.rotation).norm() <= SAME_POSE
    })
}

fn pose_words(rules: &Rules, source: String, refined: bool) -> String {
    match (&rules.refine, refined) {
        (Some(rule), true) => {
            let from = match rule.start {
                StartPose::Given => source,
                StartPose::NearestTraining => {
                    "the pose of the training frame nearest in time".to_owned()
                }
            };
            format!(
                "{} steps of Adam on the squared error of the test image itself, rate {} (radians, shares of the median depth in view), from \
                 {from}",
                rule.steps, rule.lr
            )
        }
        (Some(rule), false) => format!(
            "{source}; peers refine them at test time ({} steps at {}), which was not done here (--refine-poses does it)",
            rule.steps, rule.lr
        ),
        (None, _) => source,
    }
}

/// Meaning of each score of the report.
fn metrics(images: &ImageReport) -> std::collections::BTreeMap<String, String> {
    let p = &images.protocol;
    let mut out = p.others.clone();
    out.insert("psnr_db".to_owned(), format!("PSNR {}", p.psnr));
    let ssim = format!(
        "SSIM, Gaussian window of {} px and {} px standard deviation, no padding: region {}",
        p.ssim_window_px, p.ssim_sigma_px, p.ssim_region
    );
    out.insert("ssim".to_owned(), ssim);
    let grown = p.mask_dilation_px;
    let masked = format!(
        "the same inside the capture's masks of dynamic regions, dilated by {grown} px, if it has masks"
    );
    out.insert("masked".to_owned(), masked);
    out
}

fn headline(rules: &Rules, images: &ImageReport) -> Headline {
    match rules.headline {
        None => Headline {
            name: "psnr_db".to_owned(),
            mean: images.mean().map(|m| m.psnr_db),
        },
        Some(name) => Headline {
            name: name.to_owned(),
            mean: images.mean_others().get(name).map(|m| m.0),
        },
    }
}
