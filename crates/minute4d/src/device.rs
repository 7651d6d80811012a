//! The device that kernels run on: CPU or GPU.

pub use gpu::OpenGpu;

use crate::Error;
use m4_kernels::{Frame, View};
use std::fmt;
use std::str::FromStr;

/// Where kernels are asked to run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The best GPU that is a card of its own, or the processor where there is none or it does not
    /// start: others have not been measured, and the processor's own path is faster than software.
    #[default]
    Auto,
    /// The processor.
    Cpu,
    /// A GPU: the best, or the one of that index in the list of `doctor`, software too.
    Gpu(Option<usize>),
}

/// A device that has no such name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected auto, cpu, gpu, or gpu:N with the index of a GPU of this machine")]
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
    /// The GPU that is chosen, ready for work; `None` where that is the processor. `warn` gets the
    /// reason where the GPU that [`Self::Auto`] chose does not start.
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if there is no such GPU or it does not start; [`Error::NoGpuSupport`] where
    /// one is asked for and this build has no support for it.
    pub fn open(self, warn: impl FnOnce(&str)) -> Result<Option<OpenGpu>, Error> {
        match self {
            Self::Cpu => Ok(None),
            Self::Auto => Ok(OpenGpu::automatic().unwrap_or_else(|error| {
                warn(&format!("the CPU is used instead of the GPU: {error}"));
                None
            })),
            Self::Gpu(index) => OpenGpu::open(index).map(Some),
        }
    }

    /// Whether a GPU was asked for, which then starts.
    ///
    /// # Errors
    ///
    /// As [`DeviceChoice::open`].
    pub(crate) fn is_gpu(self) -> Result<bool, Error> {
        match self {
            Self::Cpu | Self::Auto => Ok(false),
            Self::Gpu(index) => OpenGpu::open(index).map(|_| true),
        }
    }

    /// Where networks run by this choice: on a GPU that was asked for only, since they have not
    /// been measured on one.
    ///
    /// # Errors
    ///
    /// As [`DeviceChoice::open`].
    pub fn for_networks(self) -> Result<NetworkDevice, Error> {
        match self {
            Self::Cpu | Self::Auto => Ok(NetworkDevice::processor()),
            Self::Gpu(index) => Ok(OpenGpu::open(index)?.for_networks()),
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
        Self {
            choice,
            max_vram_mb: None,
        }
    }
}

/// A device for networks.
#[derive(Debug, Clone)]
pub struct NetworkDevice {
    /// The device of Burn.
    #[cfg(feature = "nets")]
    pub device: m4_nets::Compute,
    name: String,
}

impl NetworkDevice {
    /// `cpu`, or what the GPU is called.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The CPU.
    pub fn processor() -> Self {
        Self {
            #[cfg(feature = "nets")]
            device: m4_nets::cpu().into(),
            name: "cpu".to_owned(),
        }
    }
}

/// Draws a view on a GPU.
pub(crate) type Draw = dyn FnMut(&View) -> Result<Frame, Error>;

#[cfg(feature = "gpu")]
mod gpu {
    //! An open GPU.

    use super::{Draw, NetworkDevice};
    use crate::Error;
    use m4_core::{Capture, SplatLayout, Splats};
    #[cfg(feature = "nets")]
    use m4_kernels::gpu::Runtime;
    use m4_kernels::gpu::{Choice, Gpu, adapters, automatic};
    use m4_kernels::renderer::gpu::Renderer;
    use m4_train::TrainConfig;
    use m4_train::backend::{Backend, gpu::GpuBackend};

    /// A GPU that was started.
    #[derive(Debug, Clone)]
    pub struct OpenGpu {
        gpu: Gpu,
        automatic: bool,
    }

    impl OpenGpu {
        pub(super) fn automatic() -> Result<Option<Self>, Error> {
            let Some(adapter) = automatic(adapters()) else {
                return Ok(None);
            };
            Ok(Some(Self {
                automatic: true,
                ..Self::open(Some(adapter.index))?
            }))
        }

        pub(super) fn open(index: Option<usize>) -> Result<Self, Error> {
            let gpu = Gpu::open(index.map_or(Choice::Best, Choice::Index))?;
            Ok(Self {
                gpu,
                automatic: false,
            })
        }

        /// Whether no one asked for it: where it fails, the CPU goes on.
        pub fn is_automatic(&self) -> bool {
            self.automatic
        }

        /// What it is called.
        pub fn name(&self) -> &str {
            &self.gpu.adapter().name
        }

        /// The same GPU for networks.
        pub(super) fn for_networks(&self) -> NetworkDevice {
            NetworkDevice {
                #[cfg(feature = "nets")]
                device: m4_nets::Compute::half(match self.gpu.adapter().runtime() {
                    Runtime::Wgpu(device) => m4_nets::gpu(device),
                    #[cfg(feature = "cuda")]
                    Runtime::Cuda(ordinal) => m4_nets::cuda(ordinal),
                }),
                name: self.name().to_owned(),
            }
        }

        /// Draws `splats` on it.
        pub(crate) fn painter(&self, splats: &Splats) -> Result<Box<Draw>, Error> {
            let mut renderer = Renderer::new(self.gpu.clone(), splats)?;
            Ok(Box::new(move |view| Ok(renderer.render(view)?)))
        }

        /// Takes the steps of a training by `config` on it, within `max_vram_mb`.
        pub fn training(
            &self,
            max_vram_mb: Option<usize>,
            config: &TrainConfig,
        ) -> Box<dyn Backend> {
            Box::new(GpuBackend::new(self.gpu.clone(), max_vram_mb, config))
        }

        /// Compiles the kernels of a training by `config` of splats of `layout`, as
        /// [`m4_train::warm_up`] does, and gives the memory for it back. What fails here fails
        /// again in the training, which then says so.
        pub(crate) fn warm_up(
            &self,
            capture: &Capture,
            layout: SplatLayout,
            config: &TrainConfig,
            max_vram_mb: Option<usize>,
        ) {
            let backend = self.training(max_vram_mb, config);
            let done = m4_train::warm_up(capture, layout, config, backend);
            drop(done.map(|()| self.gpu.give_back()));
        }
    }
}

#[cfg(not(feature = "gpu"))]
mod gpu {
    //! Replaces the GPU in a build without GPU support; every request is an error.

    use crate::Error;
    use m4_core::{Capture, SplatLayout, Splats};
    use m4_train::{Backend, TrainConfig};

    /// A GPU that was started; there is none in this build.
    #[derive(Debug, Clone)]
    pub enum OpenGpu {}

    impl OpenGpu {
        pub(super) fn automatic() -> Result<Option<Self>, Error> {
            Ok(None)
        }

        pub(super) fn open(_: Option<usize>) -> Result<Self, Error> {
            Err(Error::NoGpuSupport)
        }

        /// Whether no one asked for it: where it fails, the CPU goes on.
        pub fn is_automatic(&self) -> bool {
            match *self {}
        }

        /// What it is called.
        pub fn name(&self) -> &str {
            match *self {}
        }

        pub(super) fn for_networks(&self) -> super::NetworkDevice {
            match *self {}
        }

        pub(crate) fn painter(&self, _: &Splats) -> Result<Box<super::Draw>, Error> {
            match *self {}
        }

        /// Takes training steps on it.
        pub fn training(&self, _: Option<usize>, _: &TrainConfig) -> Box<dyn Backend> {
            match *self {}
        }

        pub(crate) fn warm_up(
            &self,
            _: &Capture,
            _: SplatLayout,
            _: &TrainConfig,
            _: Option<usize>,
        ) {
            match *self {}
        }
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
            assert_eq!(
                named(name).map(|device| device.to_string()),
                Ok(name.to_owned())
            );
        }
        for wrong in ["", "GPU", "gpu:", "gpu:-1", "gpu:one", "cuda"] {
            assert_eq!(named(wrong), Err(UnknownDevice), "{wrong}");
        }
    }
}
