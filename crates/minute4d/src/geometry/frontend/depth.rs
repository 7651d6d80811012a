//! Monocular depth of every frame.

use super::Plan;
use crate::Error;
use crate::cache::Steps;
use crate::device::NetworkDevice;
use m4_core::RgbImage;
use m4_geometry::clip_depth::ClipDepth;

impl Plan {
    /// Depth of every image from itself alone; `None` where the front end has no network for that.
    /// A focal length that is known (pixels of the images) is given to networks that take one. Each
    /// frame is a step. Fails where a network cannot be loaded or fails, or the user stops.
    pub fn depth(
        &self,
        images: &[&RgbImage],
        focal_px: Option<f64>,
        device: &NetworkDevice,
        steps: Steps<'_>,
    ) -> Result<Option<ClipDepth>, Error> {
        #[cfg(feature = "nets")]
        return networks::measure(self, images, focal_px, &device.device, steps);
        #[cfg(not(feature = "nets"))]
        {
            let _ = (images, focal_px, device, steps);
            Ok(None)
        }
    }
}

#[cfg(feature = "nets")]
mod networks {
    //! Networks for monocular depth.

    use super::super::Plan;
    use super::{ClipDepth, Error, RgbImage, Steps};
    use crate::error::{NetworkError, NetworkMethod};
    use crate::networks::unusable;
    use crate::settings::FrontendPart;
    use m4_core::{Plane, ResizeFilter, resize_rgb};
    use m4_geometry::megasam::MegasamError;
    use m4_nets::{Compute, DepthAnything, LoadError, MoGe, MoGeOptions, NetError, UniDepth, cpu};
    use std::path::Path;

    /// Longer side of the stored maps, pixels: those of MegaSaM's metric depth.
    const STORED_SIDE: usize = 640;
    /// Patches that MoGe-2 cuts an image into on the processor: the fewest that it was trained
    /// with. On a GPU it is the most.
    const PROCESSOR_TOKENS: usize = 1200;
    const PHASE: &str = "depth from one image";

    type BoxedError = Box<dyn std::error::Error + Send + Sync>;

    enum Metric {
        MoGe(Box<MoGe>),
        UniDepth(Box<UniDepth>),
    }

    struct Networks {
        metric: Option<Metric>,
        relative: Option<DepthAnything>,
    }

    /// The map with its longer side at most [`STORED_SIDE`].
    fn limited(plane: Plane<f32>) -> Plane<f32> {
        let (w, h) = plane.size();
        let long = w.max(h);
        if long <= STORED_SIDE {
            return plane;
        }
        let side = |n: usize| (n * STORED_SIDE / long).max(1);
        m4_geometry::resample::resize_nearest(&plane, side(w), side(h))
    }

    fn load<T>(
        part: FrontendPart,
        plan: &Plan,
        device: &Compute,
        load: impl Fn(&Path, &Compute) -> Result<T, LoadError>,
    ) -> Result<Option<T>, Error> {
        let Some(path) = plan.file(part) else {
            return Ok(None);
        };
        load(path, device)
            .map(Some)
            .map_err(unusable(NetworkMethod::FrontEnd(part)))
    }

    /// See [`Plan::depth`].
    pub(super) fn measure(
        plan: &Plan,
        images: &[&RgbImage],
        focal_px: Option<f64>,
        device: &Compute,
        steps: Steps<'_>,
    ) -> Result<Option<ClipDepth>, Error> {
        let progress = steps.observer();
        let moge = load(FrontendPart::Moge, plan, device, |path, on| {
            MoGe::load(path, on)
        })?;
        let moge = moge.map(|net| Metric::MoGe(Box::new(net)));
        let unidepth = load(FrontendPart::Unidepth, plan, device, |path, on| {
            UniDepth::load(path, on)
        })?;
        let unidepth = unidepth.map(|net| Metric::UniDepth(Box::new(net)));
        let networks = Networks {
            metric: moge.or(unidepth),
            relative: load(FrontendPart::DepthAnything, plan, device, |path, on| {
                DepthAnything::load(path, on)
            })?,
        };
        if networks.metric.is_none() && networks.relative.is_none() {
            return Ok(None);
        }
        let name = [
            FrontendPart::Moge,
            FrontendPart::Unidepth,
            FrontendPart::DepthAnything,
        ];
        let name: Vec<&str> = name
            .into_iter()
            .filter(|&p| plan.frontend.has(p))
            .map(FrontendPart::name)
            .collect();
        let name = name.join("+");
        let (mut metric_m, mut relative, mut fovs) = (Vec::new(), Vec::new(), Vec::new());
        for (frame, image) in images.iter().enumerate() {
            if progress.cancelled() {
                return Err(MegasamError::Cancelled.into());
            }
            let failed = |reason: BoxedError| NetworkError::Depth {
                networks: name.clone(),
                frame,
                reason,
            };
            let step = format!("depth-{frame:05}");
            let (measured, disparity) = match steps.load(&step) {
                Some(maps) => maps,
                None => {
                    let measured = networks
                        .metric
                        .as_ref()
                        .map(|n| n.depth(image, focal_px, device));
                    let measured = measured.transpose().map_err(failed)?;
                    let disparity = networks.relative.as_ref().map(|n| n.disparity(image));
                    let disparity = disparity.transpose().map_err(|e| failed(Box::new(e)))?;
                    let maps = (
                        measured.map(|(depth_m, fov_rad)| (limited(depth_m), fov_rad)),
                        disparity.map(limited),
                    );
                    steps.store(&step, &maps);
                    maps
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
        Ok(Some(ClipDepth {
            given: false,
            fov_rad: (!fovs.is_empty())
                .then(|| 0.5 * (fovs[fovs.len() / 2] + fovs[(fovs.len() - 1) / 2])),
            metric_m: networks.metric.is_some().then_some(metric_m),
            relative: networks.relative.is_some().then_some(relative),
        }))
    }

    impl Metric {
        /// z-depth in metres, 0 where unknown, and the horizontal field of view, radians.
        fn depth(
            &self,
            image: &RgbImage,
            focal_px: Option<f64>,
            device: &Compute,
        ) -> Result<(Plane<f32>, Option<f64>), BoxedError> {
            let moge = MoGeOptions {
                tokens: (device.device == cpu()).then_some(PROCESSOR_TOKENS),
                known_focal_px: focal_px,
            };
            match self {
                Self::MoGe(net) => match net.infer(image, &moge) {
                    Ok(map) => Ok((map.depth_m, Some(map.fov_x_rad))),
                    // all sky, or no points of a camera: nothing is known
                    Err(NetError::NoDepth(_)) => {
                        Ok((Plane::filled(image.width(), image.height(), 0.0), None))
                    }
                    Err(error) => Err(error.into()),
                },
                Self::UniDepth(net) => {
                    // MegaSaM hands it images of this size.
                    let (w, h) = image.size();
                    let side = |n: usize| (n * STORED_SIDE.min(w.max(h)) / w.max(h).max(1)).max(1);
                    let small = resize_rgb(image, side(w), side(h), ResizeFilter::Triangle)
                        .ok_or("the image is empty")?;
                    let map = net.depth(&small)?;
                    Ok((map.depth_m, Some(map.camera.horizontal_fov_rad())))
                }
            }
        }
    }
}
