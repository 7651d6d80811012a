//! The device that kernels run on: CPU or GPU.

#[cfg(feature = "gpu")]
mod gpu;
#[cfg(not(feature = "gpu"))]
mod no_gpu;

#[cfg(feature = "gpu")]
pub use gpu::{GpuPainter, OpenGpu};
#[cfg(not(feature = "gpu"))]
pub use no_gpu::{GpuPainter, OpenGpu};

use crate::Error;
use std::fmt;
use std::str::FromStr;

/// Where kernels are asked to run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The best GPU, or the processor where there is none. Software that plays GPU is never chosen: the processor's own
    /// path is faster.
    Auto,
    /// The processor.
    #[default]
    Cpu,
    /// A GPU: the best, or the one of that index in the list of `doctor`, software too.
    Gpu(Option<usize>),
}

/// A device that has no such name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected auto, cpu, gpu, or gpu:N with an index that `minute4d doctor` lists")]
pub struct UnknownDevice;

impl FromStr for DeviceChoice {
    type Err = UnknownDevice;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu(None)),
            other => match other.strip_prefix("gpu:").map(str::parse) {
                Some(Ok(index)) => Ok(Self::Gpu(Some(index))),
                _ => Err(UnknownDevice),
            },
        }
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => out.write_str("auto"),
            Self::Cpu => out.write_str("cpu"),
            Self::Gpu(None) => out.write_str("gpu"),
            Self::Gpu(Some(index)) => write!(out, "gpu:{index}"),
        }
    }
}

impl DeviceChoice {
    /// The GPU that is chosen, ready for work; `None` where that is the processor.
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if there is no such GPU or it does not start; [`Error::NoGpuSupport`] where one is asked for and this
    /// build has no support for it.
    pub fn open(self) -> Result<Option<OpenGpu>, Error> {
        match self {
            Self::Cpu => Ok(None),
            Self::Auto => OpenGpu::best(),
            Self::Gpu(index) => OpenGpu::open(index).map(Some),
        }
    }
}

/// Where a run is asked to train.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DeviceRequest {
    /// Processor or GPU.
    pub choice: DeviceChoice,
    /// Most memory that training may take on a GPU, megabytes; `None` for as much as it takes.
    pub max_vram_mb: Option<usize>,
}

impl From<DeviceChoice> for DeviceRequest {
    fn from(choice: DeviceChoice) -> Self {
        Self { choice, max_vram_mb: None }
    }
}

/// A device for networks.
#[derive(Debug, Clone)]
pub struct NetworkDevice {
    #[cfg(feature = "nets")]
    pub(crate) device: m4_nets::Compute,
    name: String,
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

#[cfg(test)]
mod tests {
    use super::{DeviceChoice, UnknownDevice};

    #[test]
    fn devices_have_names() {
        let named = |text: &str| text.parse::<DeviceChoice>();
        assert_eq!(named("auto"), Ok(DeviceChoice::Auto));
        assert_eq!(named("cpu"), Ok(DeviceChoice::Cpu));
        assert_eq!(named("gpu"), Ok(DeviceChoice::Gpu(None)));
        assert_eq!(named("gpu:2"), Ok(DeviceChoice::Gpu(Some(2))));
        for name in ["auto", "cpu", "gpu", "gpu:2"] {
            assert_eq!(named(name).map(|device| device.to_string()), Ok(name.to_owned()));
        }
        for wrong in ["", "GPU", "gpu:", "gpu:-1", "gpu:one", "cuda"] {
            assert_eq!(named(wrong), Err(UnknownDevice), "{wrong}");
        }
    }
}
