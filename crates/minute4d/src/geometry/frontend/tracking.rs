//! The tracking network as a source of correspondences.

use super::Plan;
use crate::Error;
use crate::error::NetworkMethod;
use crate::networks::unusable;
use crate::settings::FrontendPart;
use m4_core::{Mask, Plane, RgbImage};
use m4_geometry::megasam::TrackingSize;
use m4_geometry::megasam::graph::EdgeChanges;
use m4_geometry::megasam::tracker::{Correspondence, CorrespondenceError, Revision};
use m4_nets::droid::{DroidMemory, DroidNet, EdgeUpdate, MemoryOptions, Storage};
use m4_nets::{Compute, NetError};
use std::sync::Arc;

/// The network's memory of one clip.
pub struct NetworkCorrespondence<'a> {
    memory: DroidMemory<'a>,
    /// What is known to move, a plane per frame on the grid.
    dynamic: Option<Vec<Vec<bool>>>,
}

impl<'a> NetworkCorrespondence<'a> {
    /// Reads the network of `plan`. `masks` (255 where something moves) are what the user knows
    /// better than it; `budget_mb` is how much of features and states stays in memory. Fails if its
    /// weights cannot be used.
    pub fn load(
        plan: &Plan,
        images: &'a [&'a RgbImage],
        masks: Option<&[Mask]>,
        size: TrackingSize,
        budget_mb: usize,
        device: &Compute,
    ) -> Result<Self, Error> {
        let Some(path) = plan.file(FrontendPart::Megasam) else {
            return Err(Error::internal("the front end has no tracking network"));
        };
        let net = DroidNet::load(path, device)
            .map_err(unusable(NetworkMethod::FrontEnd(FrontendPart::Megasam)))?;
        Ok(Self::new(net, images, masks, size, memory(budget_mb)))
    }

    /// The same of a network that is loaded.
    pub fn new(
        net: DroidNet,
        images: &'a [&'a RgbImage],
        masks: Option<&[Mask]>,
        size: TrackingSize,
        options: MemoryOptions,
    ) -> Self {
        let image = move |frame: usize| match images.get(frame) {
            Some(full) => Ok(size.resized(full)),
            None => Err(format!("the clip has {} frames", images.len()).into()),
        };
        let on_grid = |mask: &Mask| {
            let grid = size.grid();
            let scaled = m4_geometry::resample::resize_nearest(mask, size.scaled.0, size.scaled.1);
            let plane = Plane::from_fn(grid.width, grid.height, |x, y| {
                scaled.row(8 * y)[8 * x] != 0
            });
            plane.into_vec()
        };
        Self {
            memory: DroidMemory::new(Arc::new(net), options, Box::new(image)),
            dynamic: masks.map(|masks| masks.iter().map(on_grid).collect()),
        }
    }
}

/// In half precision, as the published program has it.
fn memory(budget_mb: usize) -> MemoryOptions {
    MemoryOptions {
        budget_bytes: budget_mb.saturating_mul(1_000_000),
        storage: Storage::F16,
        scratch: std::env::temp_dir(),
    }
}

fn failed(error: NetError) -> CorrespondenceError {
    CorrespondenceError(Box::new(error))
}

impl Correspondence for NetworkCorrespondence<'_> {
    fn change(&mut self, changes: &EdgeChanges) -> Result<(), CorrespondenceError> {
        for key in &changes.entered {
            self.memory
                .enter(key.id.number(), key.source_frame, key.target_frame);
        }
        for key in &changes.left {
            self.memory.leave(key.id.number());
        }
        Ok(())
    }

    fn revise(&mut self, revision: &mut Revision<'_>) -> Result<(), CorrespondenceError> {
        for source in &mut revision.sources {
            let mut edges: Vec<EdgeUpdate<'_>> = revision.edges[source.edges.clone()]
                .iter_mut()
                .map(|edge| EdgeUpdate {
                    id: edge.key.id.number(),
                    projected_px: [&edge.projected_px[0], &edge.projected_px[1]],
                    target_px: &mut *edge.target_px,
                    weight: &mut *edge.weight,
                    static_confidence: &mut *edge.static_confidence,
                })
                .collect();
            let eta = self
                .memory
                .revise_source(source.frame, &mut edges)
                .map_err(failed)?;
            source.damping.copy_from_slice(&eta);
            if let Some(dynamic) = self.dynamic.as_ref().and_then(|m| m.get(source.frame)) {
                for edge in edges {
                    let confident = edge.static_confidence.iter_mut().zip(dynamic);
                    confident
                        .filter(|(_, dynamic)| **dynamic)
                        .for_each(|(m, _)| *m = 0.0);
                }
            }
        }
        Ok(())
    }

    fn motion_px(
        &mut self,
        from_frame: usize,
        to_frame: usize,
    ) -> Result<f64, CorrespondenceError> {
        self.memory.motion_px(from_frame, to_frame).map_err(failed)
    }
}

#[cfg(test)]
#[path = "tracking_tests.rs"]
mod tests;
