//! The device that networks run on.

use super::DeviceChoice;
use crate::Error;

/// A device for networks.
#[derive(Debug, Clone)]
pub struct NetworkDevice {
    #[cfg(feature = "nets")]
    pub(crate) device: m4_nets::Compute,
    pub(super) name: String,
}

impl NetworkDevice {
    /// `cpu`, or what the GPU is called.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn processor() -> Self {
        Self {
            #[cfg(feature = "nets")]
            device: m4_nets::cpu().into(),
            name: "cpu".to_owned(),
        }
    }
}

impl DeviceChoice {
    /// Where networks run by this choice.
    ///
    /// # Errors
    ///
    /// As [`DeviceChoice::open`].
    pub fn for_networks(self) -> Result<NetworkDevice, Error> {
        let Some(gpu) = self.open()? else {
            return Ok(NetworkDevice::processor());
        };
        Ok(gpu.for_networks())
    }
}
