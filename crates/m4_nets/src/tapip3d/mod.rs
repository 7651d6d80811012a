//! TAPIP3D: points of the world, followed through a clip whose cameras and depth are known, whether
//! they are seen or not.
//!
//! - Paper: Zhang et al., "TAPIP3D: Tracking Any Point in Persistent 3D Geometry", 2025. Its
//!   encoder and updater are those of Karaev et al., "CoTracker3: Simpler and Better Point Tracking
//!   by Pseudo-Labelling Real Videos", 2024.
//! - Upstream: zbww/tapip3d. The encoder's weights started as CoTracker3's, which are CC BY-NC 4.0:
//!   see the licence of the weights before they are used for more than research.
//!
//! ```text
//! image --encoder--> features at 1/4, 1/8, 1/16, 1/32       depth, camera --> where these pixels are in the world
//! query: frame, point --32 nearest points of each map--> what it looks like
//! window of 16 frames, 6 times: 32 nearest points around where each point is now, compared with its query's;
//!     visibility, comparison, steps --attention over time, and among points through 64 virtual ones--> how points move
//! windows start every 8 frames with what the one before found; frames before a query are followed on the reversed clip
//! ```
//!
//! Queries are followed in groups that share a window's work; points of a group see each other
//! through the virtual ones, so that what is predicted for a point depends a little on the group,
//! and thereby on the setting for memory. It depends on nothing else: the same input gives the same
//! bits on the processor for any number of threads. Each group has a grid of points of the first
//! frame beside it.
//!
//! Where points are stays in 32 bits whatever the network computes in, and the search for
//! neighbours runs on the processor for every device. Depth that is not known is 0: its pixels are
//! at the camera's centre, where the network learned to have them.

mod clip;
mod config;
mod depth;
mod encoder;
mod encoding;
mod frame;
mod layers;
mod neighbours;
mod pass;
mod pickle;
mod source;
#[cfg(test)]
mod tests;
mod track;
mod updater;
mod window;

pub use clip::{PointQuery, PointTracks, PosedClip, Tapip3dOptions};

use crate::ops::zeros;
use crate::{Compute, LoadError, NetError, load};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use config::{Config, Sizes};
use encoder::Encoder;
use m4_core::Progress;
use std::path::Path;
use updater::{Correlation, Updater};

const NAME: &str = "TAPIP3D";

/// Names of the checkpoint that are not those of fields.
const RENAMES: [(&str, &str); 8] = [
    // of the published file, with weights beside other things, in a wrapper or not
    (r"^weight\.(module\.)?", ""),
    (r"^encoder\.backbone\.", "encoder."),
    (r"\.downsample\.0\.", ".downsample.conv."),
    (r"\.posenc_mlps\.(\d+)\.0\.", ".posenc_mlps.${1}.norm_in."),
    (r"\.posenc_mlps\.(\d+)\.1\.", ".posenc_mlps.${1}.hidden."),
    (r"\.posenc_mlps\.(\d+)\.3\.", ".posenc_mlps.${1}.out."),
    (r"\.posenc_mlps\.(\d+)\.5\.", ".posenc_mlps.${1}.norm_out."),
    (r"\.virual_tracks", ".virtual_tracks"),
];

/// The network with its weights.
#[derive(Debug)]
pub struct Tapip3d {
    net: Net,
    config: Config,
    sizes: Sizes,
    device: Device,
}

#[derive(Module, Debug)]
struct Net {
    time_emb: Param<Tensor<3>>,
    encoder: Encoder,
    corr_processor: Correlation,
    point_updater: Updater,
}

impl Net {
    fn new(sizes: &Sizes, config: &Config, device: &Device) -> Self {
        Self {
            time_emb: zeros([1, sizes.times, sizes.input], device),
            encoder: Encoder::new(sizes.features, device),
            corr_processor: Correlation::new(sizes, config.heads, device),
            point_updater: Updater::new(sizes, config.updater_heads, device),
        }
    }
}

impl Tapip3d {
    /// The network with the weights of the checkpoint at `path`, on `device`: the published one, or
    /// safetensors with the configuration as JSON in the metadata entry `config`.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read, has no configuration, or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let device = &on.device;
        if !path.is_file() {
            return Err(LoadError::Missing {
                path: path.to_owned(),
            });
        }
        let config = Config::of_checkpoint(path).map_err(|reason| LoadError::Unreadable {
            path: path.to_owned(),
            network: NAME,
            reason,
        })?;
        let shapes = load::shapes(NAME, path, &RENAMES)?;
        let sizes = Sizes::in_checkpoint(&shapes, &config)
            .map_err(|wrong| LoadError::misfit(NAME, path, &[], &[wrong]))?;
        let mut net = Net::new(&sizes, &config, device);
        load::fill(&mut net, NAME, path, &RENAMES, |_| false)?;
        Ok(Self {
            net: on.fit(net),
            config,
            sizes,
            device: device.clone(),
        })
    }

    /// Columns and rows that upstream brings frames to: twice the pixels of training.
    #[must_use]
    pub fn published_size(&self) -> (usize, usize) {
        let longer = |n: usize| (n as f64 * std::f64::consts::SQRT_2) as usize;
        (longer(self.config.size.0), longer(self.config.size.1))
    }

    /// Follows `queries` through all frames of `clip` (Minute4D Eq. 5).
    ///
    /// # Errors
    ///
    /// [`NetError`] if the clip has no frames or no depth, a frame cannot be had, a query is in
    /// none of them, the size is too small, the device fails, or `progress` is cancelled.
    pub fn track(
        &self,
        clip: &dyn PosedClip,
        queries: &[PointQuery],
        options: &Tapip3dOptions,
        progress: &dyn Progress,
    ) -> Result<PointTracks, NetError> {
        track::track_within(self, clip, queries, options, None, progress)
    }
}
