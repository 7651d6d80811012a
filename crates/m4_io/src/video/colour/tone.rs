//! Converts high dynamic range (BT.2100 PQ and HLG) to sRGB.

use m4_core::{Plane, RgbImage};

/// Luminance that becomes 1.0 before the shoulder, cd/m2: "HDR reference white" of ITU-R BT.2408.
const REFERENCE_WHITE: f64 = 203.0;
/// Brightest light that keeps its own tone, cd/m2: the peak that HLG and most PQ material is graded for.
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
    /// By the code of ITU-T H.273 table 3.
    pub fn from_code(transfer: u16) -> Option<Self> {
        match transfer {
            16 => Some(Self::Pq),
            18 => Some(Self::Hlg),
            _ => None,
        }
    }

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
                let (c1, c2, c3) = (3424.0 / 4096.0, 2413.0 / 4096.0 * 32.0, 2392.0 / 4096.0 * 32.0);
                let p = signal.powf(1.0 / m2);
                let light = ((p - c1).max(0.0) / (c2 - c3 * p)).powf(1.0 / m1);
                light * 10_000.0 / REFERENCE_WHITE
            }
            Self::Hlg => {
                let (a, b, c) = (0.178_832_77, 0.284_668_92, 0.559_910_73);
                if signal <= 0.5 { signal * signal / 3.0 } else { (((signal - c) / a).exp() + b) / 12.0 }
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
            if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
        };
        Self {
            hdr,
            linear: (0..=65535u32).map(|v| hdr.linear(f64::from(v) / 65535.0) as f32).collect(),
            encoded: (0..4096).map(|v| (srgb(f64::from(v) / 4095.0) * 255.0).round() as u8).collect(),
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

    /// An image of rows of `width` pixels of 3 little-endian 16-bit numbers; `None` if the length is wrong.
    pub fn image_16(&self, width: usize, height: usize, bytes: &[u8]) -> Option<RgbImage> {
        let pixel = |p: &[u8]| {
            let channel = |i: usize| u16::from_le_bytes([p[2 * i], p[2 * i + 1]]);
            self.pixel([channel(0), channel(1), channel(2)])
        };
        Plane::from_vec(width, height, bytes.chunks_exact(6).map(pixel).collect()).ok()
    }

    /// An image that a decoder gave with 8 bits per channel.
    pub fn image_8(&self, image: &RgbImage) -> RgbImage {
        image.map(|p| self.pixel(p.map(|v| u16::from(v) * 257)))
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
    use super::{Hdr, ToneMap, shoulder};

    #[test]
    fn transfer_functions_match_the_recommendation() {
        // BT.2408 table 1: reference white is 58 % PQ and 75 % HLG.
        assert!((Hdr::Pq.linear(0.5807) - 1.0).abs() < 0.01, "{}", Hdr::Pq.linear(0.5807));
        assert!((Hdr::Pq.linear(1.0) - 10_000.0 / 203.0).abs() < 1e-6);
        assert!((Hdr::Hlg.linear(1.0) - 1.0).abs() < 1e-5 && (Hdr::Hlg.linear(0.5) - 1.0 / 12.0).abs() < 1e-9);
        let white = Hdr::Hlg.linear(0.75);
        assert!((white.powf(1.2) * 1000.0 - 203.0).abs() < 1.0, "{}", white.powf(1.2) * 1000.0);
    }

    #[test]
    fn tone_curve_is_monotonic_and_continuous() {
        for hdr in [Hdr::Pq, Hdr::Hlg] {
            let map = ToneMap::new(hdr);
            let greys: Vec<[u8; 3]> = (0..=255u16).map(|v| map.pixel([v * 257; 3])).collect();
            assert_eq!(greys[0], [0; 3]);
            assert!(greys[255].iter().all(|&v| v >= 254), "{hdr:?} {:?}", greys[255]);
            for pair in greys.windows(2) {
                assert!(pair[1][1] >= pair[0][1] && pair[1][1] - pair[0][1] <= 6, "{hdr:?} {pair:?}");
            }
            // Reference white stays bright, a mid-grey stays a mid-grey.
            let white = map.pixel([if hdr == Hdr::Pq { 38_058 } else { 49_151 }; 3]);
            assert!((215..=240).contains(&white[1]), "{hdr:?} {white:?}");
            // Greys stay grey.
            assert!(greys.iter().all(|p| p[0].abs_diff(p[1]) <= 1 && p[2].abs_diff(p[1]) <= 1));
        }
        assert!((shoulder(1000.0 / 203.0) - 1.0).abs() < 1e-12 && shoulder(0.4) == 0.4);
    }
}
