//! Loads the source of optical flow.

use super::{MonoClip, Plan};
use crate::Error;
use crate::device::NetworkDevice;
use crate::steps::Steps;
use m4_core::RgbImage;
use m4_geometry::classical::dense::{FlowSource, InverseSearch};

impl Plan {
    /// The source of flow; a recurrent network takes `iterations`.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if weights cannot be used.
    pub fn flow(&self, iterations: usize, device: &NetworkDevice) -> Result<Box<dyn FlowSource>, Error> {
        #[cfg(feature = "nets")]
        if let Some(network) = self.flow_network(iterations, device)? {
            return Ok(network);
        }
        let _ = (iterations, device);
        Ok(Box::new(InverseSearch))
    }
}

impl Plan {
    /// Depth of every image from itself alone; `None` where the front end has no network for that. A focal length that is
    /// known (pixels of the images) is given to networks that take one. Each frame is a step.
    ///
    /// # Errors
    ///
    /// [`Error`] where a network cannot be loaded or fails, or the user stops.
    pub fn depth(
        &self,
        images: &[&RgbImage],
        focal_px: Option<f64>,
        device: &NetworkDevice,
        steps: &Steps<'_>,
    ) -> Result<Option<MonoClip>, Error> {
        #[cfg(feature = "nets")]
        return MonoClip::measure(self, images, focal_px, &device.device, steps);
        #[cfg(not(feature = "nets"))]
        {
            let _ = (images, focal_px, device, steps);
            Ok(None)
        }
    }
}

#[cfg(feature = "nets")]
mod networks {
    use super::super::flow::{RaftPairs, RaftSource};
    use super::super::{Part, Plan};
    use super::{Error, NetworkDevice};
    use crate::error::{NetworkError, NetworkMethod};
    use m4_geometry::classical::dense::FlowSource;
    use m4_geometry::megasam::PairFlow;
    use m4_nets::{LoadError, Raft};

    pub fn unusable(part: Part) -> impl Fn(LoadError) -> Error {
        move |source| {
            Error::from(NetworkError::Load { method: NetworkMethod::FrontEnd(part), source: Box::new(source) })
        }
    }

    impl Plan {
        fn raft(&self, device: &NetworkDevice) -> Result<Option<Raft>, Error> {
            let file = self.file(Part::Raft);
            file.map(|path| Raft::load(path, &device.device).map_err(unusable(Part::Raft))).transpose()
        }

        pub(super) fn flow_network(
            &self,
            iterations: usize,
            device: &NetworkDevice,
        ) -> Result<Option<Box<dyn FlowSource>>, Error> {
            let raft = self.raft(device)?;
            Ok(raft.map(|net| Box::new(RaftSource { net, iterations }) as Box<dyn FlowSource>))
        }

        /// RAFT along a clip; `None` if another method measures flow.
        ///
        /// # Errors
        ///
        /// [`Error::Network`] if its weights cannot be used.
        pub fn raft_pairs(
            &self,
            iterations: usize,
            device: &NetworkDevice,
        ) -> Result<Option<Box<dyn PairFlow>>, Error> {
            let raft = self.raft(device)?;
            Ok(raft.map(|net| Box::new(RaftPairs::new(net, iterations)) as Box<dyn PairFlow>))
        }
    }
}

#[cfg(feature = "nets")]
pub(super) use networks::unusable;
