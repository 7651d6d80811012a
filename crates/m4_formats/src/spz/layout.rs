//! The header and the sizes of the blocks.

/// "NGSP", little-endian.
pub const MAGIC: u32 = 0x5053_474e;
/// Version that is written.
pub const VERSION: u32 = 3;
/// Bytes before the first block.
pub const HEADER_BYTES: usize = 16;
/// Trained with the opacity-compensated filter.
pub const FLAG_ANTIALIASED: u8 = 1;
/// Factor of the colour of degree 0.
pub const COLOUR_SCALE: f32 = 0.15;
/// Largest magnitude of a 10-bit component.
pub const ROTATION_STEPS: f32 = 511.0;
/// Highest degree of harmonics that is read; the format knows a fourth, we do not.
pub const MAX_DEGREE: u8 = 3;

/// What the header says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    pub version: u32,
    pub splats: u32,
    pub sh_degree: u8,
    pub fractional_bits: u8,
    pub flags: u8,
}

impl Header {
    /// Harmonics beyond degree 0, a channel.
    pub fn rest_terms(&self) -> usize {
        let side = usize::from(self.sh_degree) + 1;
        side * side - 1
    }

    /// Bytes a splat of positions, alphas, colours, scales, rotations, harmonics.
    pub fn widths(&self) -> [usize; 6] {
        let rotation = if self.version == 2 { 3 } else { 4 };
        [9, 1, 3, 3, rotation, 3 * self.rest_terms()]
    }

    /// Bytes of all blocks.
    pub fn payload_bytes(&self) -> u64 {
        u64::from(self.splats) * self.widths().iter().sum::<usize>() as u64
    }

    pub fn to_bytes(self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        bytes[0..4].copy_from_slice(&MAGIC.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.version.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.splats.to_le_bytes());
        bytes[12..15].copy_from_slice(&[self.sh_degree, self.fractional_bits, self.flags]);
        bytes
    }

    /// The header and its magic number, whatever they are.
    pub fn from_bytes(bytes: &[u8; HEADER_BYTES]) -> (u32, Self) {
        let word = |i: usize| u32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]);
        let header = Self {
            version: word(4),
            splats: word(8),
            sh_degree: bytes[12],
            fractional_bits: bytes[13],
            flags: bytes[14],
        };
        (word(0), header)
    }
}
