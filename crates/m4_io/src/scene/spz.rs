//! SPZ, the compressed splats of Niantic (version 3): one instant, about 10 bytes per splat.
//!
//! A gzip stream of a header of 16 bytes and then one block per parameter, little-endian:
//!
//! ```text
//! u32 0x5053474e ("NGSP"), u32 version, u32 n, u8 sh_degree, u8 fractional_bits, u8 flags, u8 0
//! positions   n x 3 x i24    fixed point: steps of 2^-fractional_bits
//! alphas      n x u8         opacity x 255
//! colours     n x 3 x u8     (0.15 c + 0.5) x 255 of the harmonic of degree 0
//! scales      n x 3 x u8     (ln scale + 10) x 16
//! rotations   n x u32        smallest three: index of the largest of (x, y, z, w) in the upper 2 bits,
//!                            then 3 x 10 bits of sign and magnitude, steps of 1/sqrt(2)/511
//! harmonics   n x k x 3 x u8 128 c + 128, k = (degree + 1)^2 - 1
//! ```
//!
//! Flag 1 says that splats were trained with the opacity-compensated filter. By convention worlds
//! are right, up, back (RUB); `splat-transform` 3.7 expects the axes of a PLY instead. Version 4
//! (streams of zstd) is not written: fewer players know it.
//!
//! Source: the README of `nianticlabs/spz`.

use super::splats::{sigmoid, turn_splats, unit};
use super::{Loss, VerifiedFile, Written, check_unbound, instant};
use crate::WriteError;
use flate2::{Compression, GzBuilder};
use m4_core::{Column, Scene, Splats};
use std::io::Write;
use std::path::Path;

/// Effort of gzip: that of zlib.
const GZIP_LEVEL: u32 = 6;

/// Writes the splats that the instant `t` (frames) sees; the file gets its name when the bytes on
/// the disk are compared.
pub fn write(path: &Path, scene: &Scene, t: f64) -> Result<Written, WriteError> {
    if !t.is_finite() {
        return Err(WriteError::bad(
            path,
            format!("t = {t}; a number of frames was expected"),
        ));
    }
    check_unbound(path, &scene.splats)?;
    let io = |e| WriteError::io(path, e);
    let mut splats = instant(&scene.splats, t, scene.period_frames());
    turn_splats(&mut splats);
    let encoded = encode(&splats, scene.mip).map_err(|what| WriteError::bad(path, what))?;
    let count = splats.n();
    drop(splats);
    let mut file = VerifiedFile::create(path).map_err(io)?;
    // neither name nor time of day: the same scene gives the same bytes
    let mut stream = GzBuilder::new()
        .mtime(0)
        .write(&mut file, Compression::new(GZIP_LEVEL));
    stream.write_all(&encoded.bytes).map_err(io)?;
    stream.finish().map_err(io)?;
    let bytes = file.publish(path)?;
    Ok(Written {
        path: path.to_path_buf(),
        bytes,
        splats: count,
        losses: losses(scene, t, &encoded),
    })
}

fn losses(scene: &Scene, t: f64, encoded: &Encoded) -> Vec<Loss> {
    let clipped = |n: usize, range: &str| match n {
        0 => String::new(),
        n => format!(" ({n} outside of {range} were clipped)"),
    };
    let mut losses = vec![
        Loss::Baked(format!("everything, at frame {t}")),
        Loss::Dropped("motion, the background and the colour corrections of the frames".into()),
        Loss::Quantised(format!(
            "positions to steps of 2^-{} units",
            encoded.header.fractional_bits
        )),
        Loss::Quantised(format!(
            "scales to steps of 6.4 %{}, opacities to 1/255, rotations to 0.0014",
            clipped(encoded.clipped_scales, "e^-10 to e^5.94")
        )),
        Loss::Quantised(format!(
            "colours to steps of 1/136{}",
            clipped(encoded.clipped_colours, "-0.44 to 1.44")
        )),
    ];
    if scene.splats.layout().sh_degree > 0 {
        losses.push(Loss::Quantised(format!(
            "harmonics to {SH1_BITS} bits (degree 1) and {SH_REST_BITS} bits{}",
            clipped(encoded.clipped_harmonics, "-1 to 1")
        )));
    }
    losses
}

/// Steps of a coordinate on either side of 0.
const POSITION_STEPS: f64 = ((1 << 23) - 1) as f64;
/// Most fractional bits that are used: steps of a four-millionth of a unit.
const MAX_FRACTIONAL_BITS: u8 = 22;
/// Bits that are kept of a harmonic of degree 1, and of degrees 2 and 3: those of the reference
/// encoder.
const SH1_BITS: u8 = 5;
const SH_REST_BITS: u8 = 4;
/// Step of an ln scale: 1/16.
const SCALES_PER_STEP: f32 = 16.0;

/// The packed bytes and what did not fit.
struct Encoded {
    header: Header,
    bytes: Vec<u8>,
    /// Scales outside of e^-10 to e^5.94.
    clipped_scales: usize,
    /// Colours of degree 0 outside of -0.44 to 1.44.
    clipped_colours: usize,
    /// Harmonics of higher degree outside of -1 to 127/128.
    clipped_harmonics: usize,
}

/// Packs static splats; fails with the row of a position that is NaN or beyond the range of the
/// format.
fn encode(splats: &Splats, mip: bool) -> Result<Encoded, String> {
    let n = splats.n();
    let header = Header {
        splats: u32::try_from(n)
            .map_err(|_| format!("it has {n} splats; the format counts up to 2^32 - 1"))?,
        sh_degree: splats.layout().sh_degree as u8,
        fractional_bits: fractional_bits(splats)?,
        flags: if mip { FLAG_ANTIALIASED } else { 0 },
    };
    let mut out = Encoded {
        header,
        bytes: Vec::with_capacity(HEADER_BYTES + header.payload_bytes() as usize),
        clipped_scales: 0,
        clipped_colours: 0,
        clipped_harmonics: 0,
    };
    out.bytes.extend(header.to_bytes());
    let columns = |column, len: usize| -> Vec<&[f32]> {
        (0..len).map(|k| splats.column(column, k)).collect()
    };
    let steps_per_unit = f64::from(1u32 << header.fractional_bits);
    let (mean, opacity) = (columns(Column::Mean, 3), splats.column(Column::Opacity, 0));
    for i in 0..n {
        for column in &mean {
            let steps = (f64::from(column[i]) * steps_per_unit).round() as i32;
            out.bytes.extend_from_slice(&steps.to_le_bytes()[..3]);
        }
    }
    out.bytes
        .extend(opacity.iter().map(|&o| (255.0 * sigmoid(o)).round() as u8));
    let colour = columns(Column::Colour, 3);
    for i in 0..n {
        for column in &colour {
            let steps = ((COLOUR_SCALE * column[i] + 0.5) * 255.0).round();
            out.clipped_colours += usize::from(!(0.0..=255.0).contains(&steps));
            out.bytes.push(steps as u8);
        }
    }
    let scale = columns(Column::LogScale, 3);
    for i in 0..n {
        for column in &scale {
            let steps = ((column[i] + 10.0) * SCALES_PER_STEP).round();
            out.clipped_scales += usize::from(!(0.0..=255.0).contains(&steps));
            out.bytes.push(steps as u8);
        }
    }
    let quat = columns(Column::Quat, 4);
    for i in 0..n {
        let q: [f32; 4] = std::array::from_fn(|k| quat[k][i]);
        out.bytes.extend(smallest_three(q).to_le_bytes());
    }
    let harmonics = columns(Column::Colour, 3 * splats.layout().sh_terms());
    for i in 0..n {
        for (c, column) in harmonics.iter().enumerate().skip(3) {
            let bits = if c < 12 { SH1_BITS } else { SH_REST_BITS };
            let (byte, clipped) = harmonic(column[i], bits);
            out.clipped_harmonics += usize::from(clipped);
            out.bytes.push(byte);
        }
    }
    Ok(out)
}

/// Bits behind the point of a coordinate: as many as the farthest splat leaves.
fn fractional_bits(splats: &Splats) -> Result<u8, String> {
    let mut bits = MAX_FRACTIONAL_BITS;
    for k in 0..3 {
        for (row, v) in splats.column(Column::Mean, k).iter().enumerate() {
            let v = f64::from(*v).abs();
            let fits = |b: &u8| v * f64::from(1u32 << b) <= POSITION_STEPS;
            let fit = (0..=bits).rev().find(fits);
            bits = fit.ok_or_else(|| {
                format!("splat {row} lies at {v} along axis {k}; up to {POSITION_STEPS} fits")
            })?;
        }
    }
    Ok(bits)
}

/// A quaternion `(w, x, y, z)` of any length in 32 bits; 0 or NaN is no rotation.
fn smallest_three(q: [f32; 4]) -> u32 {
    let [w, x, y, z] = unit(q);
    let q = [x, y, z, w];
    let largest = (1..4).fold(
        0,
        |best, i| if q[i].abs() > q[best].abs() { i } else { best },
    );
    let turn = q[largest] < 0.0;
    let mut packed = largest as u32;
    for (i, v) in q.into_iter().enumerate() {
        if i != largest {
            let magnitude = (v.abs() * std::f32::consts::SQRT_2 * ROTATION_STEPS).round();
            let sign = u32::from((v < 0.0) != turn);
            packed = packed << 10 | sign << 9 | (magnitude.min(ROTATION_STEPS) as u32);
        }
    }
    packed
}

/// A harmonic in steps of 1/128 of which the upper `bits` count, and whether it was out of reach.
fn harmonic(value: f32, bits: u8) -> (u8, bool) {
    let step = f32::from(1u16 << (8 - bits));
    let steps = ((value * 128.0 + 128.0) / step).round() * step;
    (steps as u8, !(0.0..=255.0).contains(&steps))
}

/// "NGSP", little-endian.
const MAGIC: u32 = 0x5053_474e;
/// Version that is written.
const VERSION: u32 = 3;
/// Bytes before the first block.
const HEADER_BYTES: usize = 16;
/// Trained with the opacity-compensated filter.
const FLAG_ANTIALIASED: u8 = 1;
/// Factor of the colour of degree 0.
const COLOUR_SCALE: f32 = 0.15;
/// Largest magnitude of a 10-bit component.
const ROTATION_STEPS: f32 = 511.0;

/// The contents of the header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Header {
    splats: u32,
    sh_degree: u8,
    fractional_bits: u8,
    flags: u8,
}

impl Header {
    /// Bytes of all blocks: positions, alphas, colours, scales, rotations, harmonics beyond degree
    /// 0.
    fn payload_bytes(&self) -> u64 {
        let terms = (u64::from(self.sh_degree) + 1).pow(2) - 1;
        u64::from(self.splats) * (9 + 1 + 3 + 3 + 4 + 3 * terms)
    }

    fn to_bytes(self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        bytes[0..4].copy_from_slice(&MAGIC.to_le_bytes());
        bytes[4..8].copy_from_slice(&VERSION.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.splats.to_le_bytes());
        bytes[12..15].copy_from_slice(&[self.sh_degree, self.fractional_bits, self.flags]);
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::{harmonic, smallest_three};

    #[test]
    fn packed_quaternion_matches_hand_computation() {
        // half a turn about x: x is the largest (index 0), the rest is 0
        let packed = smallest_three([0.0, 2.0, 0.0, 0.0]);
        assert_eq!(packed, 0);
        // a quarter of a turn about z, negated: z = w = -1/sqrt(2); z comes first and is the
        // largest (index 2), and the sign turns, so x = 0 (negative zero turned), y the same, w =
        // +511
        let h = -std::f32::consts::FRAC_1_SQRT_2;
        let packed = smallest_three([h, 0.0, 0.0, h]);
        assert_eq!(packed >> 30, 2);
        assert_eq!(packed & 0x3ff, 511);
        assert_eq!(packed >> 10 & 0x1ff, 0);
        // w = 0.5, x = -0.5, y = 0.1, z = 0.7: the largest is z; x is negative
        let packed = smallest_three([0.5, -0.5, 0.1, 0.7]);
        let steps = |v: f32| (v * std::f32::consts::SQRT_2 * 511.0).round() as u32;
        assert_eq!(packed >> 30, 2);
        assert_eq!(packed >> 20 & 0x3ff, 1 << 9 | steps(0.5));
        assert_eq!(packed >> 10 & 0x3ff, steps(0.1));
        assert_eq!(packed & 0x3ff, steps(0.5));
        assert_eq!(smallest_three([f32::NAN; 4]) >> 30, 3);
    }

    #[test]
    fn harmonics_keep_their_upper_bits() {
        assert_eq!(harmonic(0.0, 5), (128, false));
        assert_eq!(harmonic(0.5, 8), (192, false));
        // 0.1 * 128 + 128 = 140.8, in steps of 16: 144
        assert_eq!(harmonic(0.1, 4), (144, false));
        assert_eq!(harmonic(-2.0, 8), (0, true));
        assert_eq!(harmonic(2.0, 8), (255, true));
    }
}
