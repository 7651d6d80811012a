//! The launches of a frame on the GPU.
//!
//! ```text
//! pose -> project -> starts of the tile lists -> entries -> sort of each list -> blend -> loss
//! adam <- pose backward <- project backward <- blend backward <- gradient of the loss
//! ```
//!
//! Splats, moments, frames and everything between stay on the device while it trains; a step
//! uploads a camera, and what says where windows are in time, and reads nothing back. There are no
//! floating-point atomics: every tile entry has a slot of its own for its sums, and each splat adds
//! its slots up in order, so that the same seed gives the same bits on the same device. How many
//! entries there are is known on the device alone: buffers are sized by capacity, and a peak that
//! is read now and then says when they must grow.
//!
//! [`Renderer`] draws one view and its gradient and reads them back: for images, and for the tests
//! that compare with the CPU.

mod size;
mod work;

pub use size::Size;
pub(crate) use work::CHECKPOINT;
pub use work::Work;

use crate::gpu::buffer::Buffer;
use crate::gpu::{Gpu, GpuError};
use crate::splats::{DeviceSplats, parts};
use crate::{Frame, Gradients, View};
use m4_core::Splats;

/// Draws splats that stay on the device. The twin of [`crate::Renderer`].
#[derive(Debug)]
pub struct Renderer {
    gpu: Gpu,
    splats: DeviceSplats,
    work: Option<Work>,
}

impl Renderer {
    /// Copies `splats` to the device. Fails with [`GpuError::TooLarge`] if they do not fit into its
    /// buffers.
    pub fn new(gpu: Gpu, splats: &Splats) -> Result<Self, GpuError> {
        Ok(Self {
            splats: DeviceSplats::upload(&gpu, splats)?,
            gpu,
            work: None,
        })
    }

    /// The image of `view`. Fails with [`GpuError`] if it does not fit or the device fails.
    pub fn render(&mut self, view: &View) -> Result<Frame, GpuError> {
        self.draw(view, false)?;
        let k = &view.camera.intrinsics;
        let pixels = k.width * k.height;
        let work = self.work.as_ref().ok_or_else(nothing_drawn)?;
        let image = work
            .image
            .read_floats(&self.gpu.client, "drawing an image")?;
        let plane = |k: usize| image[k * pixels..(k + 1) * pixels].to_vec();
        Ok(Frame {
            width: k.width,
            height: k.height,
            rgb: [plane(0), plane(1), plane(2)],
            transmittance: plane(3),
            depth: if view.with_depth {
                plane(4)
            } else {
                Vec::new()
            },
        })
    }

    /// The gradient of a loss with respect to the splats, given that with respect to the colours of
    /// the image of `view`; that of the camera and of the background are left 0. Fails as
    /// [`render`](Self::render). Panics if the planes of the gradient are not as long as the image.
    pub fn backward(
        &mut self,
        view: &View,
        gradient: &[Vec<f32>; 3],
        out: &mut Gradients,
    ) -> Result<(), GpuError> {
        if let Some(work) = &mut self.work {
            work.node_keys.clear();
        }
        self.draw(view, true)?;
        let pixels = view.camera.intrinsics.width * view.camera.intrinsics.height;
        let planes = gradient.concat();
        assert_eq!(
            planes.len(),
            3 * pixels,
            "backward: the gradient has the image's size"
        );
        let doing = "computing a gradient";
        let mut result = self.splats.like(&self.gpu);
        // free splats have no trend
        result.time = Buffer::zeros(&self.gpu.client, result.time.len());
        let work = self.work.as_mut().ok_or_else(nothing_drawn)?;
        work.gradient = Buffer::floats(&self.gpu.client, &planes);
        work.backward(&self.gpu, &self.splats, &result, view.mip, None, None);
        let touched = work.touched.read_words(&self.gpu.client, doing)?;
        let columns = result.download(&self.gpu, doing)?;
        let nodes = match &self.splats.bound {
            Some(bound) if bound.n > 0 => {
                bound.node_gradients(&self.gpu, &work.node_keys, doing)?
            }
            _ => Vec::new(),
        };
        debug_assert_eq!(parts(self.splats.layout)[2].end, columns.columns().len());
        *out = Gradients {
            columns: columns.columns().to_vec(),
            touched: touched[..self.splats.n].iter().map(|&t| t as u8).collect(),
            nodes,
            ..Gradients::default()
        };
        Ok(())
    }

    /// Draws, again with more memory where a frame has more entries than there is room for.
    fn draw(&mut self, view: &View, training: bool) -> Result<(), GpuError> {
        let k = &view.camera.intrinsics;
        let n = self.splats.n;
        let mut size = Size {
            n,
            width: k.width,
            height: k.height,
            entries: Size::first_entries(n),
            training,
        };
        if let Some(work) = &self.work {
            size.entries = work.size.entries;
        }
        loop {
            let mut work = match self.work.take() {
                Some(work) if work.size == size => work,
                _ => Work::new(&self.gpu, size)?,
            };
            work.draw(&self.gpu, &self.splats, view);
            let peak = work.peak(&self.gpu, "drawing an image")?;
            self.work = Some(work);
            if peak <= size.entries {
                return Ok(());
            }
            size.entries = peak + peak / 4;
        }
    }
}

fn nothing_drawn() -> GpuError {
    GpuError::Failed {
        doing: "drawing an image",
        why: "nothing was drawn".to_owned(),
    }
}
