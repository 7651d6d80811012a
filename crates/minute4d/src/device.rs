//! Where kernels run: on the processor or on a GPU.

use crate::Error;
use m4_kernels::{Frame, View};
use m4_scene::Splats;
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

impl DeviceChoice {
    /// Draws `splats` on the GPU that is chosen; `None` where that is the processor.
    ///
    /// # Errors
    ///
    /// [`Error::Gpu`] if there is no such GPU, it does not start, or the splats do not fit; [`Error::NoGpuSupport`]
    /// where one is asked for and this build has no support for it.
    pub fn painter(self, splats: &Splats) -> Result<Option<GpuPainter>, Error> {
        match self {
            Self::Cpu => Ok(None),
            Self::Auto => GpuPainter::best(splats),
            Self::Gpu(index) => GpuPainter::open(index, splats).map(Some),
        }
    }
}

#[cfg(feature = "gpu")]
pub use with_gpu::GpuPainter;
#[cfg(not(feature = "gpu"))]
pub use without_gpu::GpuPainter;

#[cfg(feature = "gpu")]
mod with_gpu {
    use super::{Error, Frame, Splats, View};
    use m4_gpu::{Choice, Gpu, Renderer, adapters, best};

    /// Draws splats that lie on a GPU.
    #[derive(Debug)]
    pub struct GpuPainter {
        renderer: Renderer,
        name: String,
    }

    impl GpuPainter {
        pub(super) fn best(splats: &Splats) -> Result<Option<Self>, Error> {
            match best(&adapters()) {
                Some(_) => Self::open(None, splats).map(Some),
                None => Ok(None),
            }
        }

        pub(super) fn open(index: Option<usize>, splats: &Splats) -> Result<Self, Error> {
            let gpu = Gpu::open(index.map_or(Choice::Best, Choice::Index))?;
            Ok(Self {
                name: gpu.adapter().name.clone(),
                renderer: Renderer::new(gpu, splats)?,
            })
        }

        /// What the GPU is called.
        #[must_use]
        pub fn name(&self) -> &str {
            &self.name
        }

        /// The picture of `view`.
        ///
        /// # Errors
        ///
        /// [`Error::Gpu`] if it does not fit or the device fails.
        pub fn frame(&mut self, view: &View) -> Result<Frame, Error> {
            Ok(self.renderer.render(view)?)
        }
    }
}

#[cfg(not(feature = "gpu"))]
mod without_gpu {
    use super::{Error, Frame, Splats, View};

    /// What draws on a GPU; there is none in this build.
    #[derive(Debug)]
    pub enum GpuPainter {}

    impl GpuPainter {
        pub(super) fn best(_: &Splats) -> Result<Option<Self>, Error> {
            Ok(None)
        }

        pub(super) fn open(_: Option<usize>, _: &Splats) -> Result<Self, Error> {
            Err(Error::NoGpuSupport)
        }

        /// What the GPU is called.
        #[must_use]
        pub fn name(&self) -> &str {
            match *self {}
        }

        /// The picture of `view`.
        ///
        /// # Errors
        ///
        /// Never: there is no value of this type.
        pub fn frame(&mut self, _: &View) -> Result<Frame, Error> {
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
        for wrong in ["", "GPU", "gpu:", "gpu:-1", "gpu:one", "cuda"] {
            assert_eq!(named(wrong), Err(UnknownDevice), "{wrong}");
        }
    }
}
