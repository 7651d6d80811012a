//! Networks of depth from one picture.

use super::source::unusable;
use super::{MonoClip, Part, Plan};
use crate::Error;
use m4_nets::{DepthAnything, Device, LoadError, MoGe, MoGeOptions};
use m4_scene::{Plane, Progress, RgbImage};
use m4_slam::megasam::MegasamError;
use std::path::Path;

/// Longer side of the maps that are kept, pixels: those of MegaSaM's metric depth.
const KEPT_SIDE: usize = 640;
const PHASE: &str = "depth from one picture";

enum Metric {
    MoGe(MoGe),
}

struct Networks {
    metric: Option<Metric>,
    relative: Option<DepthAnything>,
}

fn kept(plane: Plane<f32>) -> Plane<f32> {
    let (w, h) = plane.size();
    let long = w.max(h);
    if long <= KEPT_SIDE {
        return plane;
    }
    let side = |n: usize| (n * KEPT_SIDE / long).max(1);
    m4_slam::megasam::resize_nearest(&plane, side(w), side(h))
}

fn load<T>(
    part: Part,
    plan: &Plan,
    device: &Device,
    load: impl Fn(&Path, &Device) -> Result<T, LoadError>,
) -> Result<Option<T>, Error> {
    let Some(path) = plan.file(part) else { return Ok(None) };
    load(path, device).map(Some).map_err(unusable(part))
}

impl MonoClip {
    /// What the networks of `plan` say of the pictures; `None` where it has none. A focal length that is known (pixels of the
    /// pictures) is given to networks that take one.
    ///
    /// # Errors
    ///
    /// [`Error`] where a network cannot be loaded or fails, or the user stops.
    pub fn measure(
        plan: &Plan,
        pictures: &[&RgbImage],
        focal_px: Option<f64>,
        device: &Device,
        progress: &dyn Progress,
    ) -> Result<Option<Self>, Error> {
        let moge = load(Part::Moge, plan, device, MoGe::load)?.map(Metric::MoGe);
        let networks = Networks {
            metric: moge,
            relative: load(Part::DepthAnything, plan, device, DepthAnything::load)?,
        };
        if networks.metric.is_none() && networks.relative.is_none() {
            return Ok(None);
        }
        let name = [Part::Moge, Part::Unidepth, Part::DepthAnything];
        let name: Vec<&str> = name
            .into_iter()
            .filter(|&p| plan.frontend.has(p))
            .map(Part::name)
            .collect();
        let name = name.join("+");
        let (mut metric_m, mut relative, mut fovs) = (Vec::new(), Vec::new(), Vec::new());
        for (frame, picture) in pictures.iter().enumerate() {
            if progress.cancelled() {
                return Err(MegasamError::Cancelled.into());
            }
            let failed = |error: Box<dyn std::error::Error + Send + Sync>| Error::MonoDepth {
                source_name: name.clone(),
                frame,
                reason: error,
            };
            if let Some(network) = &networks.metric {
                let (depth_m, fov_rad) = network.depth(picture, focal_px).map_err(failed)?;
                metric_m.push(kept(depth_m));
                fovs.push(fov_rad);
            }
            if let Some(network) = &networks.relative {
                let disparity = network.disparity(picture).map_err(|e| failed(Box::new(e)))?;
                relative.push(kept(disparity));
            }
            progress.update(PHASE, frame + 1, pictures.len(), &name);
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
        picture: &RgbImage,
        focal_px: Option<f64>,
    ) -> Result<(Plane<f32>, f64), Box<dyn std::error::Error + Send + Sync>> {
        match self {
            Self::MoGe(net) => {
                let options = MoGeOptions {
                    known_focal_px: focal_px,
                    ..MoGeOptions::default()
                };
                let map = net.infer(picture, &options)?;
                Ok((map.depth_m, map.fov_x_rad))
            }
        }
    }
}
