//! Converts the values of a video stream to sRGB, those of high dynamic range (BT.2100 PQ and HLG)
//! too.

use m4_core::{Plane, RgbImage};
use rayon::prelude::*;

/// Which numbers stand for black and white.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Range {
    /// 16 to 235 (chroma 16 to 240).
    Limited,
    /// 0 to 255.
    Full,
}

/// Codes of ITU-T H.273 for the colours of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colours {
    /// Table 3; 2 = unspecified.
    pub transfer: u16,
    /// Table 4; 2 = unspecified.
    pub matrix: u16,
    /// `None` where the stream does not say.
    pub full_range: Option<bool>,
}

impl Default for Colours {
    fn default() -> Self {
        Self {
            transfer: 2,
            matrix: 2,
            full_range: None,
        }
    }
}

impl Colours {
    /// What is not specified is taken from `other`.
    pub fn or(self, other: Self) -> Self {
        let specified = |code: u16, other: u16| if code == 2 { other } else { code };
        Self {
            transfer: specified(self.transfer, other.transfer),
            matrix: specified(self.matrix, other.matrix),
            full_range: self.full_range.or(other.full_range),
        }
    }
}

/// Bytes of the planes of a 4:2:0 image.
pub fn bytes_420((width, height): (usize, usize)) -> usize {
    width * height + 2 * width.div_ceil(2) * height.div_ceil(2)
}

/// Weights of red and blue in luma: the rest of the matrix follows from them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct YuvMatrix {
    kr: f32,
    kb: f32,
    range: Range,
}

impl YuvMatrix {
    /// By the code of ITU-T H.273 table 4; what is unspecified (2) is guessed as players do: BT.601
    /// below 720 rows, BT.709 from there. `None` for codes of other kinds (RGB, YCgCo, constant
    /// luminance).
    pub fn from_code(code: u16, height: usize, range: Range) -> Option<Self> {
        let (kr, kb) = match code {
            1 => (0.2126, 0.0722),
            2 if height >= 720 => (0.2126, 0.0722),
            2 | 5 | 6 => (0.299, 0.114),
            4 => (0.30, 0.11),
            7 => (0.212, 0.087),
            9 => (0.2627, 0.0593),
            _ => return None,
        };
        Some(Self { kr, kb, range })
    }

    /// An image from its 4:2:0 planes: luma, blue, red. Chroma lies at the left luma column and
    /// between two luma rows (MPEG-2 siting, H.264's default) and is interpolated. `None` if the
    /// length is wrong.
    pub fn image_420(&self, (width, height): (usize, usize), planes: &[u8]) -> Option<RgbImage> {
        if width == 0 || height == 0 || planes.len() != bytes_420((width, height)) {
            return None;
        }
        let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
        let (luma, chroma) = planes.split_at(width * height);
        let (cb, cr) = chroma.split_at(half_width * half_height);
        let k = self.coefficients();
        let mut data = vec![[0u8; 3]; width * height];
        data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            let luma = &luma[y * width..][..width];
            let near = y / 2;
            let far = if y % 2 == 0 {
                near.saturating_sub(1)
            } else {
                (near + 1).min(half_height - 1)
            };
            // Chroma of the whole row first, so that the arithmetic below runs over plain arrays.
            let line = |plane: &[u8]| -> Vec<f32> {
                let a = &plane[near * half_width..][..half_width];
                let b = &plane[far * half_width..][..half_width];
                let blend = |(&a, &b)| 0.75 * f32::from(a) + 0.25 * f32::from(b);
                let half: Vec<f32> = a.iter().zip(b).map(blend).collect();
                let next = half[1..].iter().chain(half.last());
                half.iter()
                    .zip(next)
                    .flat_map(|(&a, &b)| [a, 0.5 * (a + b)])
                    .collect()
            };
            let (u, v) = (line(cb), line(cr));
            for (((pixel, &l), &u), &v) in row.iter_mut().zip(luma).zip(&u).zip(&v) {
                *pixel = k.rgb(f32::from(l), u, v);
            }
        });
        Plane::from_vec(width, height, data).ok()
    }

    fn coefficients(&self) -> Coefficients {
        let kg = 1.0 - self.kr - self.kb;
        let (black, luma, chroma) = match self.range {
            Range::Limited => (16.0, 255.0 / 219.0, 255.0 / 224.0),
            Range::Full => (0.0, 1.0, 1.0),
        };
        Coefficients {
            black,
            luma,
            r_v: 2.0 * (1.0 - self.kr) * chroma,
            g_u: -2.0 * (1.0 - self.kb) * self.kb / kg * chroma,
            g_v: -2.0 * (1.0 - self.kr) * self.kr / kg * chroma,
            b_u: 2.0 * (1.0 - self.kb) * chroma,
        }
    }

    /// Luma and chroma of a colour, each 0..255 before rounding: the inverse of the conversion
    /// above.
    pub fn yuv(&self, [r, g, b]: [f32; 3]) -> [f32; 3] {
        let kg = 1.0 - self.kr - self.kb;
        let y = self.kr * r + kg * g + self.kb * b;
        let (black, luma, chroma) = match self.range {
            Range::Limited => (16.0, 219.0 / 255.0, 224.0 / 255.0),
            Range::Full => (0.0, 1.0, 1.0),
        };
        [
            y * luma + black,
            (b - y) / (2.0 * (1.0 - self.kb)) * chroma + 128.0,
            (r - y) / (2.0 * (1.0 - self.kr)) * chroma + 128.0,
        ]
    }
}

struct Coefficients {
    black: f32,
    luma: f32,
    r_v: f32,
    g_u: f32,
    g_v: f32,
    b_u: f32,
}

impl Coefficients {
    #[inline]
    fn rgb(&self, l: f32, u: f32, v: f32) -> [u8; 3] {
        let l = (l - self.black) * self.luma;
        let (u, v) = (u - 128.0, v - 128.0);
        // A cast from float saturates.
        [
            (l + self.r_v * v + 0.5) as u8,
            (l + self.g_u * u + self.g_v * v + 0.5) as u8,
            (l + self.b_u * u + 0.5) as u8,
        ]
    }
}

/// Planes of an image in 4:2:0.
#[derive(Debug, Clone, PartialEq)]
pub struct Planes420 {
    /// Even.
    pub width: usize,
    /// Even.
    pub height: usize,
    /// `[height][width]`
    pub luma: Vec<u8>,
    /// `[height / 2][width / 2]`, blue and red.
    pub chroma: [Vec<u8>; 2],
}

impl Planes420 {
    /// Converts an image; odd sides grow by repeating the last column or row. Chroma is sited at
    /// the left luma column, between two rows, and weighed 1 2 1 along the row. By the calling
    /// thread alone: those that encode must not wait for threads that wait for them.
    pub fn new(image: &RgbImage, matrix: &YuvMatrix) -> Self {
        let (w, h) = image.size();
        let (width, height) = (w.next_multiple_of(2), h.next_multiple_of(2));
        let pixel = |x: usize, y: usize| image[(x.min(w - 1), y.min(h - 1))].map(f32::from);
        let mut luma = vec![0; width * height];
        for (y, row) in luma.chunks_mut(width).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                *value = matrix.yuv(pixel(x, y))[0].round() as u8;
            }
        }
        let mut both = vec![[0; 2]; width / 2 * (height / 2)];
        for (y, row) in both.chunks_mut(width / 2).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                let mut mean = [0.0; 3];
                for (column, weight) in [
                    ((2 * x).saturating_sub(1), 0.125),
                    (2 * x, 0.25),
                    (2 * x + 1, 0.125),
                ] {
                    for line in [2 * y, 2 * y + 1] {
                        let p = pixel(column, line);
                        (0..3).for_each(|c| mean[c] += weight * p[c]);
                    }
                }
                let [_, cb, cr] = matrix.yuv(mean);
                *value = [cb.round() as u8, cr.round() as u8];
            }
        }
        let chroma = [0, 1].map(|c| both.iter().map(|v| v[c]).collect());
        Self {
            width,
            height,
            luma,
            chroma,
        }
    }
}

/// Luminance that becomes 1.0 before the shoulder, cd/m2: "HDR reference white" of ITU-R BT.2408.
const REFERENCE_WHITE: f64 = 203.0;
/// Brightest light that keeps its own tone, cd/m2: the peak that HLG and most PQ material is graded
/// for.
const PEAK: f64 = 1000.0;
/// Linear light, relative to reference white, up to which tones are kept.
const KNEE: f64 = 0.5;

/// The transfer function of a stream with high dynamic range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hdr {
    /// SMPTE ST 2084, absolute luminance.
    Pq,
    /// Hybrid log-gamma (ARIB STD-B67).
    Hlg,
}

impl Hdr {
    /// By ffprobe's name.
    pub fn from_name(transfer: &str) -> Option<Self> {
        match transfer {
            "smpte2084" => Some(Self::Pq),
            "arib-std-b67" => Some(Self::Hlg),
            _ => None,
        }
    }

    /// For messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pq => "PQ",
            Self::Hlg => "HLG",
        }
    }

    /// Light of a signal in 0..1: for PQ displayed, relative to reference white; for HLG of the
    /// scene, 0..1 (ITU-R BT.2100 tables 4 and 5).
    fn linear(self, signal: f64) -> f64 {
        match self {
            Self::Pq => {
                let (m1, m2) = (2610.0 / 16384.0, 2523.0 / 4096.0 * 128.0);
                let (c1, c2, c3) = (
                    3424.0 / 4096.0,
                    2413.0 / 4096.0 * 32.0,
                    2392.0 / 4096.0 * 32.0,
                );
                let p = signal.powf(1.0 / m2);
                let light = ((p - c1).max(0.0) / (c2 - c3 * p)).powf(1.0 / m1);
                light * 10_000.0 / REFERENCE_WHITE
            }
            Self::Hlg => {
                let (a, b, c) = (0.178_832_77, 0.284_668_92, 0.559_910_73);
                if signal <= 0.5 {
                    signal * signal / 3.0
                } else {
                    (((signal - c) / a).exp() + b) / 12.0
                }
            }
        }
    }
}

/// Turns images with 16 bits per channel into sRGB; made once a clip.
pub struct ToneMap {
    hdr: Hdr,
    /// Light of each of the 65536 signals.
    linear: Vec<f32>,
    /// sRGB of light 0..1 in steps of 1/4095.
    encoded: Vec<u8>,
}

impl ToneMap {
    pub fn new(hdr: Hdr) -> Self {
        let srgb = |x: f64| {
            if x <= 0.003_130_8 {
                12.92 * x
            } else {
                1.055 * x.powf(1.0 / 2.4) - 0.055
            }
        };
        Self {
            hdr,
            linear: (0..=65535u32)
                .map(|v| hdr.linear(f64::from(v) / 65535.0) as f32)
                .collect(),
            encoded: (0..4096)
                .map(|v| (srgb(f64::from(v) / 4095.0) * 255.0).round() as u8)
                .collect(),
        }
    }

    /// One pixel with BT.2020 primaries.
    pub fn pixel(&self, signal: [u16; 3]) -> [u8; 3] {
        let mut light = signal.map(|v| f64::from(self.linear[usize::from(v)]));
        if self.hdr == Hdr::Hlg {
            // OOTF of a display of 1000 cd/m2: gamma 1.2 on the luminance of the scene.
            let y = 0.2627 * light[0] + 0.6780 * light[1] + 0.0593 * light[2];
            let gain = y.max(1e-9).powf(0.2) * PEAK / REFERENCE_WHITE;
            light = light.map(|v| v * gain);
        }
        let [r, g, b] = light;
        // ITU-R BT.2087, linear light.
        let narrow = [
            1.6605 * r - 0.5876 * g - 0.0728 * b,
            -0.1246 * r + 1.1329 * g - 0.0083 * b,
            -0.0182 * r - 0.1006 * g + 1.1187 * b,
        ]
        .map(|v| v.max(0.0));
        // The shoulder acts on the brightest channel, so that hues stay.
        let brightest = narrow.iter().fold(1e-9f64, |a, &b| a.max(b));
        let gain = shoulder(brightest) / brightest;
        narrow.map(|v| self.encoded[((v * gain).clamp(0.0, 1.0) * 4095.0).round() as usize])
    }

    /// An image of rows of `width` pixels of 3 little-endian 16-bit numbers; `None` if the length
    /// is wrong.
    pub fn image_16(&self, width: usize, height: usize, bytes: &[u8]) -> Option<RgbImage> {
        let pixel = |p: &[u8]| {
            let channel = |i: usize| u16::from_le_bytes([p[2 * i], p[2 * i + 1]]);
            self.pixel([channel(0), channel(1), channel(2)])
        };
        Plane::from_vec(width, height, bytes.chunks_exact(6).map(pixel).collect()).ok()
    }
}

/// Light above the knee is bent so that the peak becomes 1 (slope 1 at the knee, no step).
fn shoulder(x: f64) -> f64 {
    let span = PEAK / REFERENCE_WHITE - KNEE;
    let over = x - KNEE;
    if over <= 0.0 {
        return x;
    }
    let c = span / (span / (1.0 - KNEE) - 1.0);
    (KNEE + over / (1.0 + over / c)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::{Hdr, Range, ToneMap, YuvMatrix, shoulder};

    #[test]
    fn flat_colours_survive_both_ways_in_every_matrix_and_range() {
        for code in [1, 4, 5, 6, 7, 9] {
            for range in [Range::Limited, Range::Full] {
                let matrix = YuvMatrix::from_code(code, 480, range).unwrap();
                for colour in [
                    [255.0, 0.0, 0.0],
                    [10.0, 200.0, 60.0],
                    [0.0, 0.0, 255.0],
                    [255.0; 3],
                    [0.0; 3],
                ] {
                    let [l, u, v] = matrix.yuv(colour).map(|v| v.round() as u8);
                    let got = matrix
                        .image_420((6, 4), &[&[l; 24][..], &[u; 6], &[v; 6]].concat())
                        .unwrap();
                    for (got, want) in got.data().iter().flatten().zip(colour.iter().cycle()) {
                        assert!(
                            (f32::from(*got) - want).abs() <= 3.0,
                            "{code} {range:?} {colour:?} {got}"
                        );
                    }
                }
            }
        }
        assert!(YuvMatrix::from_code(0, 480, Range::Full).is_none());
        assert_eq!(
            YuvMatrix::from_code(2, 1080, Range::Full),
            YuvMatrix::from_code(1, 1080, Range::Full)
        );
        assert_eq!(
            YuvMatrix::from_code(2, 480, Range::Full),
            YuvMatrix::from_code(6, 480, Range::Full)
        );
    }

    #[test]
    fn known_values_of_bt_601_and_709() {
        // Pure red, limited range: (82, 90, 240) in BT.601 and (63, 102, 240) in BT.709.
        let limited = |code| {
            YuvMatrix::from_code(code, 480, Range::Limited)
                .unwrap()
                .yuv([255.0, 0.0, 0.0])
        };
        assert_eq!(limited(6).map(|v| v.round() as u8), [81, 90, 240]);
        assert_eq!(limited(1).map(|v| v.round() as u8), [63, 102, 240]);
    }

    #[test]
    fn chroma_is_interpolated_at_its_site() {
        // Chroma rising along x: a luma column x lies at chroma column x / 2.
        let matrix = YuvMatrix::from_code(6, 480, Range::Full).unwrap();
        let cr: Vec<u8> = (0..4)
            .flat_map(|_| (0..8).map(|i| 128 + 4 * i as u8))
            .collect();
        let got = matrix
            .image_420((16, 8), &[&[100; 128][..], &[128; 32], &cr].concat())
            .unwrap();
        for x in 0..15 {
            let want = 100.0 + 1.402 * 2.0 * x as f64;
            assert!((f64::from(got[(x, 3)][0]) - want).abs() <= 1.0, "{x}");
        }
        assert!(matrix.image_420((16, 8), &[0; 191]).is_none());
    }

    #[test]
    fn transfer_functions_match_the_recommendation() {
        // BT.2408 table 1: reference white is 58 % PQ and 75 % HLG.
        assert!(
            (Hdr::Pq.linear(0.5807) - 1.0).abs() < 0.01,
            "{}",
            Hdr::Pq.linear(0.5807)
        );
        assert!((Hdr::Pq.linear(1.0) - 10_000.0 / 203.0).abs() < 1e-6);
        assert!(
            (Hdr::Hlg.linear(1.0) - 1.0).abs() < 1e-5
                && (Hdr::Hlg.linear(0.5) - 1.0 / 12.0).abs() < 1e-9
        );
        let white = Hdr::Hlg.linear(0.75);
        assert!(
            (white.powf(1.2) * 1000.0 - 203.0).abs() < 1.0,
            "{}",
            white.powf(1.2) * 1000.0
        );
    }

    #[test]
    fn tone_curve_is_monotonic_and_continuous() {
        for hdr in [Hdr::Pq, Hdr::Hlg] {
            let map = ToneMap::new(hdr);
            let greys: Vec<[u8; 3]> = (0..=255u16).map(|v| map.pixel([v * 257; 3])).collect();
            assert_eq!(greys[0], [0; 3]);
            assert!(
                greys[255].iter().all(|&v| v >= 254),
                "{hdr:?} {:?}",
                greys[255]
            );
            for pair in greys.windows(2) {
                assert!(
                    pair[1][1] >= pair[0][1] && pair[1][1] - pair[0][1] <= 6,
                    "{hdr:?} {pair:?}"
                );
            }
            // Reference white stays bright, a mid-grey stays a mid-grey.
            let white = map.pixel([if hdr == Hdr::Pq { 38_058 } else { 49_151 }; 3]);
            assert!((215..=240).contains(&white[1]), "{hdr:?} {white:?}");
            // Greys stay grey.
            assert!(
                greys
                    .iter()
                    .all(|p| p[0].abs_diff(p[1]) <= 1 && p[2].abs_diff(p[1]) <= 1)
            );
        }
        assert!((shoulder(1000.0 / 203.0) - 1.0).abs() < 1e-12 && shoulder(0.4) == 0.4);
    }
}
