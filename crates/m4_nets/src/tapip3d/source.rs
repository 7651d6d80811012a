//! Frames of a clip as the network takes them.

use super::camera::PosedPinhole;
use super::clip::PosedClip;
use super::depth::{Histogram, cleaned, resized};
use super::frame::{Frame, Geometry, image_tensor, maps};
use super::{Tapip3d, Tapip3dError, Tapip3dOptions};
use burn_core::tensor::Tensor;
use m4_core::{Progress, nalgebra::Vector3};

/// A clip, and how its frames are brought to what the network takes.
pub struct Source<'a> {
    pub net: &'a Tapip3d,
    clip: &'a dyn PosedClip,
    pub options: &'a Tapip3dOptions,
    /// The place of the world that is the origin here.
    pub origin: Vector3<f64>,
}

/// A frame before its features are prepared.
pub struct Loaded {
    pub maps: Vec<Tensor<2>>,
    pub geometry: Geometry,
    /// Depth, `[h][w]`.
    pub z: Vec<f32>,
}

impl Loaded {
    /// As windows take it.
    pub fn frame(self, net: &Tapip3d) -> Frame {
        let prepared = |map: Tensor<2>| net.net.corr_processor.prepared(map);
        Frame {
            features: self.maps.into_iter().map(prepared).collect(),
            points: self.geometry.points,
            moments: self.geometry.moments,
        }
    }
}

impl<'a> Source<'a> {
    /// Of `clip`, in a world whose origin is the first camera.
    ///
    /// # Errors
    ///
    /// [`Tapip3dError`] if there is no frame, or its camera is none.
    pub fn new(net: &'a Tapip3d, clip: &'a dyn PosedClip, options: &'a Tapip3dOptions) -> Result<Self, Tapip3dError> {
        if clip.frames() == 0 {
            return Err(Tapip3dError::NoFrames);
        }
        let camera = clip.camera(0).map_err(|source| Tapip3dError::Frame { frame: 0, source })?;
        let source = Self { net, clip, options, origin: camera.centre() };
        source.lens(0)?;
        Ok(source)
    }

    fn lens(&self, frame: usize) -> Result<PosedPinhole, Tapip3dError> {
        let camera = self.clip.camera(frame).map_err(|source| Tapip3dError::Frame { frame, source })?;
        PosedPinhole::new(&camera, self.options.size, &self.origin).ok_or(Tapip3dError::BadFrame {
            frame,
            reason: "its camera has no positive focal lengths, or numbers that are not finite",
        })
    }

    /// Depth of `frame` in the network's size, and its camera.
    fn depth(&self, frame: usize) -> Result<(PosedPinhole, Vec<f32>), Tapip3dError> {
        let lens = self.lens(frame)?;
        let depth = self.clip.depth(frame).map_err(|source| Tapip3dError::Frame { frame, source })?;
        if depth.data().is_empty() {
            let reason = "its depth has no pixels";
            return Err(Tapip3dError::BadFrame { frame, reason });
        }
        let size = self.options.size;
        let z = resized(&depth, size);
        let z = if self.options.clean_edges { cleaned(&z, size, &lens) } else { z };
        Ok((lens, z))
    }

    /// The depths that count, over all frames.
    ///
    /// # Errors
    ///
    /// [`Tapip3dError`] if a frame cannot be had, no depth is known, or `progress` is cancelled.
    pub fn range(&self, progress: &dyn Progress) -> Result<[f32; 2], Tapip3dError> {
        let mut histogram = Histogram::new();
        let frames = self.clip.frames();
        for frame in 0..frames {
            if progress.cancelled() {
                return Err(Tapip3dError::Stopped);
            }
            histogram.add(&self.depth(frame)?.1);
            progress.update("depth to follow points in", frame + 1, frames, "");
        }
        let last = frames - 1;
        histogram.range().ok_or(Tapip3dError::NoDepth { first: 0, last })
    }

    /// `frame` with its features; depths within `range` count.
    ///
    /// # Errors
    ///
    /// [`Tapip3dError`] if the frame cannot be had.
    pub fn load(&self, frame: usize, range: [f32; 2]) -> Result<Loaded, Tapip3dError> {
        let (lens, z) = self.depth(frame)?;
        let image = self.clip.image(frame).map_err(|source| Tapip3dError::Frame { frame, source })?;
        if image.data().is_empty() {
            let reason = "its image has no pixels";
            return Err(Tapip3dError::BadFrame { frame, reason });
        }
        let (net, config) = (&self.net.net, &self.net.config);
        let image = image_tensor(&image, self.options.size, config, &self.net.device, net.encoder.dtype());
        Ok(Loaded {
            maps: maps(net, image, config.levels),
            geometry: Geometry::new(lens, &z, self.options.size, range, config.levels),
            z,
        })
    }

    /// Bytes of a frame of a window.
    pub fn frame_bytes(&self) -> usize {
        let pixels = (self.options.size.0 / 4) * (self.options.size.1 / 4);
        let channels = self.net.sizes.tokens * self.net.net.encoder.dtype().size();
        pixels * 4 / 3 * (channels + size_of::<[f32; 3]>())
    }
}
