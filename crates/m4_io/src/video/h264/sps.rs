//! Sequence parameter sets (ITU-T H.264, 7.3.2.1.1 and E.1.1): size, sampling and colours.

/// What a decoder and a colour conversion must know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sps {
    pub profile: u8,
    /// 0 = grey, 1 = 4:2:0, 2 = 4:2:2, 3 = 4:4:4.
    pub chroma_format: u32,
    pub bit_depth: u32,
    /// Every image is a whole frame.
    pub progressive: bool,
    /// Cropped, pixels.
    pub width: usize,
    /// Cropped, pixels.
    pub height: usize,
    /// Width of a pixel over its height.
    pub pixel_aspect: Option<f64>,
    /// ITU-T H.273 table 3; 2 = unspecified.
    pub transfer: u16,
    /// ITU-T H.273 table 4; 2 = unspecified.
    pub matrix: u16,
    pub full_range: Option<bool>,
}

/// Profiles whose parameter set says more about sampling.
const HIGH_PROFILES: [u8; 13] = [100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135];

/// Shapes of pixels by `aspect_ratio_idc` (table E-1).
const ASPECTS: [(u16, u16); 17] = [
    (0, 0),
    (1, 1),
    (12, 11),
    (10, 11),
    (16, 11),
    (40, 33),
    (24, 11),
    (20, 11),
    (32, 11),
    (80, 33),
    (18, 11),
    (15, 11),
    (64, 33),
    (160, 99),
    (4, 3),
    (3, 2),
    (2, 1),
];

impl Sps {
    /// Parses a NAL unit of type 7, header byte included; `None` if it is cut short or impossible.
    pub fn parse(nal: &[u8]) -> Option<Self> {
        let mut bits = Bits::new(nal.get(1..)?);
        let profile = bits.bits(8)? as u8;
        bits.bits(16)?;
        bits.ue()?;
        let (mut chroma_format, mut bit_depth) = (1, 8);
        if HIGH_PROFILES.contains(&profile) {
            chroma_format = bits.ue()?;
            if chroma_format == 3 {
                bits.bit()?;
            }
            let (luma, chroma) = (bits.ue()?, bits.ue()?);
            bit_depth = luma.max(chroma).checked_add(8)?;
            bits.bit()?;
            if bits.bit()? {
                for i in 0..if chroma_format == 3 { 12 } else { 8 } {
                    if bits.bit()? {
                        skip_scaling_list(&mut bits, if i < 6 { 16 } else { 64 })?;
                    }
                }
            }
        }
        bits.ue()?;
        match bits.ue()? {
            0 => drop(bits.ue()?),
            1 => {
                bits.bit()?;
                bits.se()?;
                bits.se()?;
                let cycle = bits.ue()?;
                if cycle > 255 {
                    return None;
                }
                for _ in 0..cycle {
                    bits.se()?;
                }
            }
            _ => {}
        }
        bits.ue()?;
        bits.bit()?;
        let (columns, rows) = (bits.ue()?.checked_add(1)?, bits.ue()?.checked_add(1)?);
        let progressive = bits.bit()?;
        let fields = if progressive { 1 } else { 2 };
        if !progressive {
            bits.bit()?;
        }
        bits.bit()?;
        let mut crop = [0u32; 4];
        if bits.bit()? {
            for side in &mut crop {
                *side = bits.ue()?;
            }
        }
        let unit_x = if matches!(chroma_format, 1 | 2) { 2 } else { 1 };
        let unit_y = if chroma_format == 1 { 2 * fields } else { fields };
        let side = |blocks: u32, unit: u32, a: u32, b: u32| {
            let cropped = a.checked_add(b)?.checked_mul(unit)?;
            blocks.checked_mul(16)?.checked_sub(cropped).filter(|&n| n > 0 && n <= 16_384)
        };
        let mut sps = Self {
            profile,
            chroma_format,
            bit_depth,
            progressive,
            width: side(columns, unit_x, crop[0], crop[1])? as usize,
            height: side(rows.checked_mul(fields)?, unit_y, crop[2], crop[3])? as usize,
            pixel_aspect: None,
            transfer: 2,
            matrix: 2,
            full_range: None,
        };
        if bits.bit()? {
            // A usability part that is cut short says nothing; the size above stands.
            let _ = sps.usability(&mut bits);
        }
        Some(sps)
    }

    fn usability(&mut self, bits: &mut Bits) -> Option<()> {
        if bits.bit()? {
            let code = bits.bits(8)? as usize;
            let (w, h) = if code == 255 {
                (bits.bits(16)? as u16, bits.bits(16)? as u16)
            } else {
                *ASPECTS.get(code).unwrap_or(&(0, 0))
            };
            let aspect = f64::from(w) / f64::from(h);
            self.pixel_aspect = Some(aspect).filter(|a| (0.1..=10.0).contains(a));
        }
        if bits.bit()? {
            bits.bit()?;
        }
        if bits.bit()? {
            bits.bits(3)?;
            self.full_range = Some(bits.bit()?);
            if bits.bit()? {
                bits.bits(8)?;
                self.transfer = bits.bits(8)? as u16;
                self.matrix = bits.bits(8)? as u16;
            }
        }
        Some(())
    }
}

/// Profile whose images the decoder gives out at once (Scalable Baseline, with the syntax of a High parameter set).
const UNDELAYED_PROFILE: u8 = 83;

/// The parameter set (a NAL unit of type 7) with a profile for which OpenH264 does not hold images
/// back to put them in order of display. What is decoded does not change: for progressive 8-bit 4:2:0
/// the profile decides about nothing else in that decoder. The order is ours to make, from the times in
/// the container; the decoder's own order would hide which image a damaged frame took away.
pub fn undelayed(nal: &[u8]) -> Option<Vec<u8>> {
    let &[header, profile, constraints, level, ref rest @ ..] = nal else {
        return None;
    };
    let start = [header, UNDELAYED_PROFILE, constraints, level];
    match profile {
        100 => Some([&start, rest].concat()),
        77 => {
            // Main has no fields about sampling: 4:2:0, 8 bits twice, no bypass, no scaling lists.
            let mut bits = Bits::new(rest);
            let mut id = Vec::new();
            while !bits.bit()? {
                id.push(false);
            }
            id.push(true);
            for _ in 1..id.len() {
                id.push(bits.bit()?);
            }
            let sampling = [false, true, false, true, true, false, false];
            let tail = std::iter::from_fn(|| bits.bit());
            let all: Vec<bool> = id.into_iter().chain(sampling).chain(tail).collect();
            let byte = |bits: &[bool]| bits.iter().enumerate().fold(0u8, |b, (i, &bit)| b | u8::from(bit) << (7 - i));
            let mut bytes: Vec<u8> = all.chunks(8).map(byte).collect();
            while bytes.last() == Some(&0) {
                bytes.pop();
            }
            Some([&start, escape(&bytes).as_slice()].concat())
        }
        _ => Some(nal.to_vec()),
    }
}

fn skip_scaling_list(bits: &mut Bits, size: usize) -> Option<()> {
    let (mut last, mut next) = (8i32, 8i32);
    for _ in 0..size {
        if next != 0 {
            next = last.checked_add(bits.se()?)?.rem_euclid(256);
        }
        last = if next == 0 { last } else { next };
    }
    Some(())
}

/// Reads the payload of a NAL unit, without its emulation prevention bytes (`00 00 03` -> `00 00`).
pub struct Bits {
    bytes: Vec<u8>,
    at: usize,
}

impl Bits {
    pub fn new(payload: &[u8]) -> Self {
        let mut bytes = Vec::with_capacity(payload.len());
        let mut zeros = 0;
        for &b in payload {
            if zeros >= 2 && b == 3 {
                zeros = 0;
                continue;
            }
            zeros = if b == 0 { zeros + 1 } else { 0 };
            bytes.push(b);
        }
        Self { bytes, at: 0 }
    }

    pub fn bit(&mut self) -> Option<bool> {
        let byte = self.bytes.get(self.at / 8)?;
        let bit = byte >> (7 - self.at % 8) & 1;
        self.at += 1;
        Some(bit == 1)
    }

    /// `n` bits, at most 32.
    pub fn bits(&mut self, n: u32) -> Option<u32> {
        (0..n).try_fold(0u32, |value, _| Some(value << 1 | u32::from(self.bit()?)))
    }

    /// Exponential-Golomb code, unsigned.
    pub fn ue(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while !self.bit()? {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        Some((1u32 << zeros) - 1 + self.bits(zeros)?)
    }

    /// Exponential-Golomb code, signed.
    pub fn se(&mut self) -> Option<i32> {
        let code = i64::from(self.ue()?);
        let half = (code + 1) / 2;
        i32::try_from(if code % 2 == 1 { half } else { -half }).ok()
    }
}

/// Bytes as the payload of a NAL unit: with emulation prevention.
pub fn escape(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len() + 8);
    let mut zeros = 0;
    for &b in bytes {
        if zeros >= 2 && b <= 3 {
            out.push(3);
            zeros = 0;
        }
        zeros = if b == 0 { zeros + 1 } else { 0 };
        out.push(b);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{Bits, Sps, escape, undelayed};

    #[test]
    fn high_profile_sps_of_x264_is_parsed() {
        // Of the example clip: 480 x 360 (368 coded rows, cropped by 8), BT.709, limited range, square pixels.
        let nal = [
            0x67, 0x64, 0x00, 0x1f, 0xac, 0x76, 0x11, 0x07, 0x82, 0xff, 0x97, 0x01, 0x6a, 0x02, 0x02, 0x03, 0x4a, 0x00,
            0x00, 0x03, 0x00, 0x02, 0x00, 0x00, 0x03, 0x00, 0x60, 0x1e, 0x30, 0x63, 0x08, 0xc0,
        ];
        let sps = Sps::parse(&nal).unwrap();
        assert_eq!((sps.profile, sps.width, sps.height, sps.progressive), (100, 480, 360, true));
        assert_eq!((sps.chroma_format, sps.bit_depth), (1, 8));
        assert_eq!((sps.transfer, sps.matrix, sps.full_range), (1, 1, Some(false)));
        assert_eq!(sps.pixel_aspect, Some(1.0));
        for cut in 0..nal.len() {
            let _ = (Sps::parse(&nal[..cut]), undelayed(&nal[..cut]));
        }
        let quick = Sps::parse(&undelayed(&nal).unwrap()).unwrap();
        assert_eq!(Sps { profile: 100, ..quick }, sps);
    }

    #[test]
    fn main_profile_sps_is_parsed() {
        // x264, 320 x 240, Main.
        let nal = [
            0x67, 0x4d, 0x40, 0x0d, 0xe8, 0x8a, 0x0a, 0x0f, 0xcb, 0x80, 0xb5, 0x01, 0x01, 0x01, 0x40, 0x00, 0x00, 0x03,
            0x00, 0x40, 0x00, 0x00, 0x0c, 0x03, 0xc5, 0x0a, 0x44, 0x80,
        ];
        let sps = Sps::parse(&nal).unwrap();
        let quick = undelayed(&nal).unwrap();
        assert_eq!(Sps { profile: 77, ..Sps::parse(&quick).unwrap() }, sps);
        assert!(quick.windows(3).all(|w| w != [0, 0, 0] && w != [0, 0, 1] && w != [0, 0, 2]), "{quick:x?}");
    }

    #[test]
    fn golomb_codes_and_emulation_prevention() {
        // 1 010 011 00100 00101 -> 0 1 2 3 4
        let mut bits = Bits::new(&[0b1010_0110, 0b0100_0010, 0b1000_0000]);
        assert_eq!((0..5).map(|_| bits.ue().unwrap()).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
        let mut bits = Bits::new(&[0b1010_0110, 0b0100_0010, 0b1000_0000]);
        assert_eq!((0..5).map(|_| bits.se().unwrap()).collect::<Vec<_>>(), [0, 1, -1, 2, -2]);
        assert_eq!(Bits::new(&[0, 0, 3, 1]).bits(24), Some(1));
        assert_eq!(escape(&[0, 0, 1, 0, 0, 0, 4]), [0, 0, 3, 1, 0, 0, 3, 0, 4]);
        assert_eq!(Bits::new(&[0; 9]).ue(), None);
        assert_eq!(Bits::new(&[]).bit(), None);
    }
}
