//! The frames of a video, kept on the device as far as memory allows.

use crate::gpu::buffer::Buffer;
use crate::gpu::{Gpu, GpuError};
use crate::loss::cpu::{Target, TargetPlanes};
use std::borrow::Borrow;

/// What a step of a 16-bit sample is worth where colours come as floats.
const FINEST: f32 = 1.0 / 65_535.0;

/// A frame as the kernels read it: planes of bytes, or of two bytes where `wide`, packed into words; each plane starts
/// with a word of its own.
#[derive(Debug, Clone)]
pub struct DeviceFrame {
    /// The planes.
    pub samples: Buffer,
    /// What one of a sample is worth.
    pub worth: f32,
    /// Two bytes per sample.
    pub wide: bool,
}

#[derive(Debug)]
struct Stored {
    place: Place,
    worth: f32,
    wide: bool,
}

#[derive(Debug)]
enum Place {
    Device(Buffer),
    /// Goes to the device when it is used.
    Host(Vec<u32>),
}

impl Place {
    /// Takes from `left` what stays on the device; if that is not enough nothing does from there on.
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
    list: Vec<Stored>,
}

impl Frames {
    /// Packs `frames`. Those that fit into `budget_bytes` go to the device for good, in their order.
    /// Fails with [`GpuError`] if there are none, they differ in size, or one does not fit.
    pub fn new<T: Borrow<Target>>(
        gpu: &Gpu,
        frames: impl IntoIterator<Item = T>,
        budget_bytes: usize,
    ) -> Result<Self, GpuError> {
        let mut out = Self { width: 0, height: 0, list: Vec::new() };
        let mut left = budget_bytes;
        for (index, frame) in frames.into_iter().enumerate() {
            let frame = frame.borrow();
            let size = (frame.width(), frame.height());
            if index == 0 {
                (out.width, out.height) = size;
            }
            if size != (out.width, out.height) || size.0 * size.1 == 0 {
                return Err(GpuError::FrameSize { index, size, first: (out.width, out.height) });
            }
            let (words, worth, wide) = packed(frame);
            gpu.fits("a frame", 4 * words.len())?;
            let place = Place::new(gpu, words, &mut left);
            out.list.push(Stored { place, worth, wide });
        }
        if out.list.is_empty() {
            return Err(GpuError::NoFrames);
        }
        Ok(out)
    }

    /// How many of them stay on the device.
    pub fn resident(&self) -> usize {
        let there = |frame: &&Stored| matches!(frame.place, Place::Device(_));
        self.list.iter().filter(there).count()
    }

    /// Frame `index`, uploaded if it is missing. Fails with [`GpuError`] if there is no such frame.
    pub fn get(&self, gpu: &Gpu, index: usize) -> Result<DeviceFrame, GpuError> {
        let frame = self.stored(index)?;
        Ok(DeviceFrame { samples: frame.place.get(gpu), worth: frame.worth, wide: frame.wide })
    }

    fn stored(&self, index: usize) -> Result<&Stored, GpuError> {
        let count = self.list.len();
        self.list.get(index).ok_or(GpuError::NoFrame { index, count })
    }
}

/// The samples of a frame in words, what one is worth, and whether a sample takes two bytes.
fn packed(frame: &Target) -> (Vec<u32>, f32, bool) {
    match frame.planes() {
        TargetPlanes::Bytes(planes) => (planes.into_iter().flat_map(four_a_word).collect(), 1.0 / 255.0, false),
        TargetPlanes::Floats(planes) => {
            let words = planes.into_iter().flat_map(|plane| {
                let samples: Vec<u16> = plane.iter().map(|v| (v.clamp(0.0, 1.0) / FINEST).round() as u16).collect();
                two_a_word(&samples).collect::<Vec<u32>>()
            });
            (words.collect(), FINEST, true)
        }
    }
}

fn four_a_word(plane: &[u8]) -> impl Iterator<Item = u32> {
    plane.chunks(4).map(|part| {
        let shifted = part.iter().enumerate().map(|(k, &v)| u32::from(v) << (8 * k));
        shifted.fold(0, |all, v| all | v)
    })
}

fn two_a_word(plane: &[u16]) -> impl Iterator<Item = u32> {
    plane.chunks(2).map(|part| {
        let shifted = part.iter().enumerate().map(|(k, &v)| u32::from(v) << (16 * k));
        shifted.fold(0, |all, v| all | v)
    })
}

#[cfg(test)]
mod tests {
    use super::packed;
    use crate::loss::cpu::Target;

    #[test]
    fn planes_start_with_words_of_their_own() {
        let bytes = Target::from_bytes(5, 1, [[1, 2, 3, 4, 5], [6; 5], [7; 5]].map(|p| p.to_vec())).unwrap();
        let (words, worth, wide) = packed(&bytes);
        assert_eq!(words, [0x0403_0201, 5, 0x0606_0606, 6, 0x0707_0707, 7]);
        assert!(!wide && worth == 1.0 / 255.0);
        let floats = Target::new(1, 1, [vec![0.0], vec![2.0], vec![0.5]]).unwrap();
        assert_eq!(packed(&floats).0, [0, 65_535, 32_768]);
    }
}
