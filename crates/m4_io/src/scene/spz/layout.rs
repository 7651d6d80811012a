//! The header and the sizes of the blocks.

/// "NGSP", little-endian.
const MAGIC: u32 = 0x5053_474e;
/// Version that is written.
const VERSION: u32 = 3;
/// Bytes before the first block.
pub const HEADER_BYTES: usize = 16;
/// Trained with the opacity-compensated filter.
pub const FLAG_ANTIALIASED: u8 = 1;
/// Factor of the colour of degree 0.
pub const COLOUR_SCALE: f32 = 0.15;
/// Largest magnitude of a 10-bit component.
pub const ROTATION_STEPS: f32 = 511.0;

/// The contents of the header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    pub splats: u32,
    pub sh_degree: u8,
    pub fractional_bits: u8,
    pub flags: u8,
}

impl Header {
    /// Harmonics beyond degree 0, a channel.
    fn rest_terms(&self) -> usize {
        let side = usize::from(self.sh_degree) + 1;
        side * side - 1
    }

    /// Bytes per splat of positions, alphas, colours, scales, rotations, harmonics.
    fn widths(&self) -> [usize; 6] {
        [9, 1, 3, 3, 4, 3 * self.rest_terms()]
    }

    /// Bytes of all blocks.
    pub fn payload_bytes(&self) -> u64 {
        u64::from(self.splats) * self.widths().iter().sum::<usize>() as u64
    }

    pub fn to_bytes(self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        bytes[0..4].copy_from_slice(&MAGIC.to_le_bytes());
        bytes[4..8].copy_from_slice(&VERSION.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.splats.to_le_bytes());
        bytes[12..15].copy_from_slice(&[self.sh_degree, self.fractional_bits, self.flags]);
        bytes
    }
}
