//! What needs no training, scored like a scene: depth warped into the held-out views, billboards,
//! one colour per object. A scene that does not beat them is not worth its training.

use super::regions::regions;
use crate::error::Error;
use crate::held_out::HeldOut;
use m4_core::{Camera, Capture, CaptureFrame, CompactMask, RgbImage, covering, median};
use m4_eval::image::{ImageReport, MeanScore, PlanarImage};
use m4_eval::warp::{Warp, nearest};
use minute4d::Observer;
use minute4d::observer::check_stop;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::HashSet;

/// Static pixels this far below an object, share of the image width, are where it stands.
const CONTACT_SHARE: f64 = 0.01;

/// A baseline over the views of a set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BaselineScore {
    /// What was drawn.
    pub name: &'static str,
    /// The set of views.
    pub set: String,
    /// Whole, dynamic and static.
    pub mean: MeanScore,
}

/// Scores the baselines on sets of held-out views. `input` has the training frames of the data set.
/// `own` is the geometry that the scene was trained on, in the world of the scene, if it differs.
pub(super) fn score(
    input: &Capture,
    own: Option<&Capture>,
    held: &HeldOut,
    sets: &[(&str, &Capture)],
    observer: &dyn Observer,
) -> Result<Vec<BaselineScore>, Error> {
    let (capture, camera): (&Capture, &(dyn Fn(&CaptureFrame) -> Camera + Sync)) = match own {
        Some(own) => (own, &|view| held.camera(view)),
        None => (input, &|view| view.camera),
    };
    let flat = billboards(capture);
    let (warp, flat) = (Warp::new(capture), Warp::new(&flat));
    let upper = own.is_some().then(|| Warp::new(input));
    let mut rows = Vec::new();
    for &(set, views) in sets {
        let share = |view: &CaptureFrame| view.t / (views.time_frames.max(2) - 1) as f64;
        let mut row = |name: &'static str,
                       draw: &(dyn Fn(&CaptureFrame) -> RgbImage + Sync)|
         -> Result<(), Error> {
            check_stop(observer, "eval", false)?;
            let mean = mean_of(&views.frames, draw)?;
            rows.extend(mean.map(|mean| BaselineScore {
                name,
                set: set.to_owned(),
                mean,
            }));
            Ok(())
        };
        let given_warp = upper.as_ref().unwrap_or(&warp);
        row("given depth warped (upper bound of a warp)", &|view| {
            given_warp.view(&view.camera, share(view))
        })?;
        if own.is_some() {
            row("own depth warped", &|view| {
                warp.view(&camera(view), share(view))
            })?;
        }
        row("billboards at the ground contact", &|view| {
            flat.view(&camera(view), share(view))
        })?;
        row("one colour per object", &|view| {
            painted(
                warp.background(&camera(view)),
                view,
                nearest(input, share(view)),
            )
        })?;
    }
    Ok(rows)
}

/// Means over views of what `draw` gives.
pub fn mean_of(
    views: &[CaptureFrame],
    draw: &(dyn Fn(&CaptureFrame) -> RgbImage + Sync),
) -> Result<Option<MeanScore>, Error> {
    let mut report = ImageReport::new("baseline", 0);
    // a few at a time, so that memory does not grow with the number of views
    for part in views.chunks(16) {
        let drawn: Vec<RgbImage> = part.par_iter().map(draw).collect();
        for (view, image) in part.iter().zip(&drawn) {
            let mask = view.mask.as_ref().map(CompactMask::to_mask);
            report.add(
                &view.name,
                view.t,
                None,
                &image.into(),
                &PlanarImage::from(&view.rgb),
                mask.as_ref(),
            )?;
        }
    }
    Ok(report.mean())
}

/// The capture with every dynamic object flat, at the distance of the static pixels right below it;
/// at its own median depth where there are none.
fn billboards(capture: &Capture) -> Capture {
    let mut out = capture.clone();
    for frame in &mut out.frames {
        let Some(mut depth) = frame.depth.as_ref().map(m4_core::CompactDepth::to_map) else {
            continue;
        };
        let (w, h) = frame.rgb.size();
        let to = |p: (usize, usize)| covering(p, (w, h), depth.size());
        let below = (CONTACT_SHARE * w as f64).ceil() as usize;
        let objects = regions(frame);
        let dynamic: HashSet<(usize, usize)> = objects
            .iter()
            .flat_map(|(_, pixels)| pixels)
            .copied()
            .collect();
        let depth_at =
            |&p: &(usize, usize)| Some(depth[to(p)]).filter(|z| z.is_finite() && *z > 0.0);
        let mut flat = Vec::new();
        for (_, pixels) in objects {
            let foot = pixels.iter().map(|p| p.1).max().unwrap_or(0);
            let feet = pixels.iter().filter(|p| p.1 + below > foot);
            let ground =
                feet.flat_map(|&(x, y)| (y + 1..(y + 1 + below).min(h)).map(move |v| (x, v)));
            let mut ground: Vec<f32> = ground
                .filter(|p| !dynamic.contains(p))
                .filter_map(|p| depth_at(&p))
                .collect();
            let z = median(&mut ground)
                .or_else(|| median(&mut pixels.iter().filter_map(depth_at).collect::<Vec<f32>>()));
            flat.extend(z.map(|z| (z, pixels.iter().map(|&p| to(p)).collect::<Vec<_>>())));
        }
        for (z, pixels) in flat {
            pixels.into_iter().for_each(|p| depth[p] = z);
        }
        frame.depth = Some(depth.into());
    }
    out
}

/// A view's objects in one colour each: the mean of the object of the same number in `frame`, else
/// of all dynamic pixels there.
fn painted(mut image: RgbImage, view: &CaptureFrame, frame: Option<&CaptureFrame>) -> RgbImage {
    let areas = frame.map(regions).unwrap_or_default();
    let mean = |counts: &dyn Fn(u16) -> bool| -> Option<[u8; 3]> {
        let pixels = areas
            .iter()
            .filter(|(id, _)| counts(*id))
            .flat_map(|(_, pixels)| pixels);
        let colours: Vec<[u8; 3]> = pixels.filter_map(|&p| Some(frame?.rgb[p])).collect();
        let sum = |c: usize| {
            colours
                .iter()
                .map(|colour| usize::from(colour[c]))
                .sum::<usize>()
        };
        (!colours.is_empty()).then(|| [0, 1, 2].map(|c| (sum(c) / colours.len()) as u8))
    };
    for (object, pixels) in regions(view) {
        if let Some(colour) = mean(&|id| id == object).or_else(|| mean(&|_| true)) {
            pixels.into_iter().for_each(|p| image[p] = colour);
        }
    }
    image
}

/// The rows as a table for people.
pub(super) fn table(rows: &[BaselineScore]) -> String {
    let cell = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.2}"));
    let mut out = format!(
        "{:<42} {:<8} {:>7} {:>8} {:>8}\n",
        "without training, PSNR dB", "set", "whole", "dynamic", "static"
    );
    for r in rows {
        let m = &r.mean;
        let (masked, fixed) = (cell(m.masked_psnr_db), cell(m.static_psnr_db));
        out += &format!(
            "{:<42} {:<8} {:>7.2} {masked:>8} {fixed:>8}\n",
            r.name, r.set, m.psnr_db
        );
    }
    out
}
