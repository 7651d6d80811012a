//! The frames of a video, kept on the device as far as memory allows.

use crate::gpu::buffer::Buffer;
use crate::gpu::{Gpu, GpuError};
use crate::loss::cpu::Target;
use std::borrow::Borrow;

#[derive(Debug)]
enum Place {
    Device(Buffer),
    /// Goes to the device when it is used.
    Host(Vec<u32>),
}

impl Place {
    /// Takes from `left` what stays on the device; if that is not enough nothing does from there
    /// on.
    fn new(gpu: &Gpu, words: Vec<u32>, left: &mut usize) -> Self {
        let bytes = 4 * words.len();
        if bytes <= *left {
            *left -= bytes;
            Self::Device(Buffer::words(&gpu.client, &words))
        } else {
            *left = 0;
            Self::Host(words)
        }
    }

    fn get(&self, gpu: &Gpu) -> Buffer {
        match self {
            Self::Device(buffer) => buffer.clone(),
            Self::Host(words) => Buffer::words(&gpu.client, words),
        }
    }
}

/// Frames of one size.
#[derive(Debug)]
pub struct Frames {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    list: Vec<Place>,
}

impl Frames {
    /// Packs `frames`. Those that fit into `budget_bytes` go to the device for good, in their
    /// order. Fails with [`GpuError`] if there are none, they differ in size, or one does not fit.
    pub fn new<T: Borrow<Target>>(
        gpu: &Gpu,
        frames: impl IntoIterator<Item = T>,
        budget_bytes: usize,
    ) -> Result<Self, GpuError> {
        let mut out = Self {
            width: 0,
            height: 0,
            list: Vec::new(),
        };
        let mut left = budget_bytes;
        for (index, frame) in frames.into_iter().enumerate() {
            let frame = frame.borrow();
            let size = (frame.width(), frame.height());
            if index == 0 {
                (out.width, out.height) = size;
            }
            if size != (out.width, out.height) || size.0 * size.1 == 0 {
                return Err(GpuError::FrameSize {
                    index,
                    size,
                    first: (out.width, out.height),
                });
            }
            let words = packed(frame);
            gpu.fits("a frame", 4 * words.len())?;
            out.list.push(Place::new(gpu, words, &mut left));
        }
        if out.list.is_empty() {
            return Err(GpuError::NoFrames);
        }
        Ok(out)
    }

    /// How many of them stay on the device.
    pub fn resident(&self) -> usize {
        self.list
            .iter()
            .filter(|frame| matches!(frame, Place::Device(_)))
            .count()
    }

    /// Frame `index`, uploaded if it is missing: planes of bytes, four per word; each plane starts
    /// with a word of its own. Fails with [`GpuError`] if there is no such frame.
    pub fn get(&self, gpu: &Gpu, index: usize) -> Result<Buffer, GpuError> {
        let count = self.list.len();
        self.list
            .get(index)
            .map(|frame| frame.get(gpu))
            .ok_or(GpuError::NoFrame { index, count })
    }
}

/// The planes of a frame in words.
fn packed(frame: &Target) -> Vec<u32> {
    frame
        .planes()
        .iter()
        .flat_map(|plane| plane.chunks(4).map(word))
        .collect()
}

/// At most four bytes, the first the lowest.
fn word(bytes: &[u8]) -> u32 {
    bytes
        .iter()
        .rev()
        .fold(0, |word, &byte| word << 8 | u32::from(byte))
}

#[cfg(test)]
mod tests {
    use super::packed;
    use crate::loss::cpu::Target;

    #[test]
    fn planes_start_with_words_of_their_own() {
        let bytes = Target::from_bytes(5, 1, [[1, 2, 3, 4, 5], [6; 5], [7; 5]].map(|p| p.to_vec()))
            .unwrap();
        assert_eq!(
            packed(&bytes),
            [0x0403_0201, 5, 0x0606_0606, 6, 0x0707_0707, 7]
        );
    }
}
