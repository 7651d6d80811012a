//! An open GPU.

use super::NetworkDevice;
use crate::Error;
use m4_core::Splats;
#[cfg(feature = "nets")]
use m4_kernels::gpu::Runtime;
use m4_kernels::gpu::{Choice, Gpu, Renderer, adapters, best};
use m4_kernels::{Frame, View};
use m4_train::backend::{Backend, gpu::GpuBackend};

/// A GPU that was started.
#[derive(Debug, Clone)]
pub struct OpenGpu {
    gpu: Gpu,
}

impl OpenGpu {
    pub(super) fn best() -> Result<Option<Self>, Error> {
        match best(&adapters()) {
            Some(_) => Self::open(None).map(Some),
            None => Ok(None),
        }
    }

    pub(super) fn open(index: Option<usize>) -> Result<Self, Error> {
        let gpu = Gpu::open(index.map_or(Choice::Best, Choice::Index))?;
        Ok(Self { gpu })
    }

    /// What it is called.
    #[must_use]
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
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if they do not fit.
    pub fn painter(&self, splats: &Splats) -> Result<GpuPainter, Error> {
        Ok(GpuPainter { renderer: Renderer::new(self.gpu.clone(), splats)? })
    }

    /// Takes training steps of `batch` frames on it, within `max_vram_mb`.
    #[must_use]
    pub fn training(&self, max_vram_mb: Option<usize>, batch: usize) -> Box<dyn Backend> {
        Box::new(GpuBackend::new(self.gpu.clone(), max_vram_mb, batch))
    }
}

/// Draws splats that lie on a GPU.
#[derive(Debug)]
pub struct GpuPainter {
    renderer: Renderer,
}

impl GpuPainter {
    /// The image of `view`.
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if it does not fit or the device fails.
    pub fn frame(&mut self, view: &View) -> Result<Frame, Error> {
        Ok(self.renderer.render(view)?)
    }
}
