//! Networks for monocular depth.

use super::source::unusable;
use super::{MonoClip, Part, Plan};
use crate::Error;
use crate::error::NetworkError;
use crate::steps::Steps;
use m4_core::{Plane, ResizeFilter, RgbImage, resize_rgb};
use m4_geometry::megasam::MegasamError;
use m4_nets::{Compute, DepthAnything, LoadError, MoGe, MoGeMap, MoGeOptions, NetError, UniDepth, cpu};
use std::path::Path;

/// Longer side of the maps that are kept, pixels: those of MegaSaM's metric depth.
const KEPT_SIDE: usize = 640;
/// Patches that MoGe-2 cuts an image into on the processor: the fewest that it was trained with. On a GPU it is the most.
const PROCESSOR_TOKENS: usize = 1200;
const PHASE: &str = "depth from one image";

enum Metric {
    MoGe(Box<MoGe>),
    UniDepth(Box<UniDepth>),
}

struct Networks {
    metric: Option<Metric>,
    relative: Option<DepthAnything>,
}

/// The map with its longer side at most [`KEPT_SIDE`].
fn limited(plane: Plane<f32>) -> Plane<f32> {
    let (w, h) = plane.size();
    let long = w.max(h);
    if long <= KEPT_SIDE {
        return plane;
    }
    let side = |n: usize| (n * KEPT_SIDE / long).max(1);
    m4_geometry::resample::resize_nearest(&plane, side(w), side(h))
}

/// The image with its longer side at most `long`.
fn at_most(image: &RgbImage, long: usize) -> Result<RgbImage, Box<dyn std::error::Error + Send + Sync>> {
    let (w, h) = image.size();
    let side = |n: usize| (n * long.min(w.max(h)) / w.max(h).max(1)).max(1);
    resize_rgb(image, side(w), side(h), ResizeFilter::Triangle).ok_or_else(|| "the image is empty".into())
}

fn load<T>(
    part: Part,
    plan: &Plan,
    device: &Compute,
    load: impl Fn(&Path, &Compute) -> Result<T, LoadError>,
) -> Result<Option<T>, Error> {
    let Some(path) = plan.file(part) else { return Ok(None) };
    load(path, device).map(Some).map_err(unusable(part))
}

/// What MoGe-2 says: z-depth in metres, 0 where unknown, and the field of view. All sky, or no points of a camera: nothing is known.
fn of_moge(
    found: Result<MoGeMap, NetError>,
    image: &RgbImage,
) -> Result<(Plane<f32>, Option<f64>), Box<dyn std::error::Error + Send + Sync>> {
    match found {
        Ok(map) => Ok((map.depth_m, Some(map.fov_x_rad))),
        Err(NetError::NoDepth(_)) => Ok((Plane::filled(image.width(), image.height(), 0.0), None)),
        Err(error) => Err(error.into()),
    }
}

impl MonoClip {
    /// What the networks of `plan` say of the images; `None` where it has none. A focal length that is known (pixels of the
    /// images) is given to networks that take one.
    ///
    /// # Errors
    ///
    /// [`Error`] where a network cannot be loaded or fails, or the user stops.
    pub fn measure(
        plan: &Plan,
        images: &[&RgbImage],
        focal_px: Option<f64>,
        device: &Compute,
        steps: &Steps<'_>,
    ) -> Result<Option<Self>, Error> {
        let progress = steps.observer();
        let moge = load(Part::Moge, plan, device, |path, on| MoGe::load(path, on))?;
        let moge = moge.map(|net| Metric::MoGe(Box::new(net)));
        let unidepth = load(Part::Unidepth, plan, device, |path, on| UniDepth::load(path, on))?;
        let unidepth = unidepth.map(|net| Metric::UniDepth(Box::new(net)));
        let networks = Networks {
            metric: moge.or(unidepth),
            relative: load(Part::DepthAnything, plan, device, |path, on| DepthAnything::load(path, on))?,
        };
        if networks.metric.is_none() && networks.relative.is_none() {
            return Ok(None);
        }
        let name = [Part::Moge, Part::Unidepth, Part::DepthAnything];
        let name: Vec<&str> = name.into_iter().filter(|&p| plan.frontend.has(p)).map(Part::name).collect();
        let name = name.join("+");
        let (mut metric_m, mut relative, mut fovs) = (Vec::new(), Vec::new(), Vec::new());
        for (frame, image) in images.iter().enumerate() {
            if progress.cancelled() {
                return Err(MegasamError::Cancelled.into());
            }
            let failed = |reason: Box<dyn std::error::Error + Send + Sync>| NetworkError::Depth {
                networks: name.clone(),
                frame,
                reason,
            };
            let step = format!("depth-{frame:05}");
            let (measured, disparity) = match steps.load(&step) {
                Some(made) => made,
                None => {
                    let measured = networks.metric.as_ref().map(|n| n.depth(image, focal_px, device));
                    let measured = measured.transpose().map_err(failed)?;
                    let disparity = networks.relative.as_ref().map(|n| n.disparity(image));
                    let disparity = disparity.transpose().map_err(|e| failed(Box::new(e)))?;
                    let made = (measured.map(|(depth_m, fov_rad)| (limited(depth_m), fov_rad)), disparity.map(limited));
                    steps.store(&step, &made);
                    made
                }
            };
            if let Some((depth_m, fov_rad)) = measured {
                metric_m.push(depth_m);
                fovs.extend::<Option<f64>>(fov_rad);
            }
            relative.extend(disparity);
            progress.update(PHASE, frame + 1, images.len(), &name);
        }
        let blind = metric_m.len() - fovs.len();
        if blind > 0 {
            progress.warn(&format!(
                "{name} sees no depth in {blind} of {} frames (sky alone, or nothing that a camera explains)",
                images.len()
            ));
        }
        fovs.sort_unstable_by(f64::total_cmp);
        Ok(Some(Self {
            name,
            fov_rad: (!fovs.is_empty()).then(|| 0.5 * (fovs[fovs.len() / 2] + fovs[(fovs.len() - 1) / 2])),
            metric_m: networks.metric.is_some().then_some(metric_m),
            relative: networks.relative.is_some().then_some(relative),
        }))
    }
}

impl Metric {
    /// z-depth in metres, 0 where unknown, and the horizontal field of view, radians.
    fn depth(
        &self,
        image: &RgbImage,
        focal_px: Option<f64>,
        device: &Compute,
    ) -> Result<(Plane<f32>, Option<f64>), Box<dyn std::error::Error + Send + Sync>> {
        let moge =
            MoGeOptions { tokens: (device.device == cpu()).then_some(PROCESSOR_TOKENS), known_focal_px: focal_px };
        match self {
            Self::MoGe(net) => of_moge(net.infer(image, &moge), image),
            Self::UniDepth(net) => {
                // MegaSaM hands it images of this size.
                let small = at_most(image, KEPT_SIDE)?;
                let map = net.depth(&small)?;
                Ok((map.depth_m, Some(map.camera.horizontal_fov_rad())))
            }
        }
    }
}
