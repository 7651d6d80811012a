//! Decodes bytes to splats.

use super::{HEADER_BYTES, MAGIC, VERSION, bytes_per_splat};
use super::{Linear, Sinh, rotation_value};
use m4_core::{Column, SplatLayout, Splats};

/// Why bytes are not the splats of a page.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PayloadError {
    /// Too short for a header, or another first word.
    #[error("these {0} bytes do not begin with the header of a minute4d page")]
    Header(usize),
    /// A later layout.
    #[error("the splats are of version {0}, this program reads version {VERSION}; write the page again")]
    Version(u32),
    /// Degrees of the colour that do not exist.
    #[error(
        "the header names harmonics of degree {sh_degree} in space and {time_degree} in time; 3 and 2 are the highest"
    )]
    Degree {
        /// The value in the file.
        sh_degree: u8,
        /// The value in the file.
        time_degree: u8,
    },
    /// Planes that are missing, or something behind them.
    #[error(
        "{expected} bytes were expected for {n_static} static and {n_dynamic} dynamic splats, and {found} are there"
    )]
    Length {
        /// From the header.
        n_static: usize,
        /// From the header.
        n_dynamic: usize,
        /// What that makes.
        expected: u64,
        /// What is there.
        found: usize,
    },
    /// A number of the header that is not finite.
    #[error("number {index} of the header is {value}; it must be finite")]
    Number {
        /// Counted from 0.
        index: usize,
        /// The value in the file.
        value: f64,
    },
}

/// The most opaque a splat comes back: its logit must be finite.
const OPAQUE: f64 = 1.0 - 1.0 / 2048.0;

/// The splats, as a renderer takes them.
pub fn decode(bytes: &[u8]) -> Result<Splats, PayloadError> {
    let header = bytes.first_chunk::<HEADER_BYTES>().filter(|h| h.starts_with(MAGIC));
    let header = header.ok_or(PayloadError::Header(bytes.len()))?;
    let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    if word(4) != VERSION {
        return Err(PayloadError::Version(word(4)));
    }
    let (sh_degree, time_degree) = (header[16], header[17]);
    if sh_degree > 3 || time_degree > 2 {
        return Err(PayloadError::Degree { sh_degree, time_degree });
    }
    let layout = SplatLayout {
        isotropic: header[18] == 1,
        sh_degree: usize::from(sh_degree),
        time_degree: usize::from(time_degree),
    };
    let (n_static, n_dynamic) = (word(8) as usize, word(12) as usize);
    let (a, b) = bytes_per_splat(layout);
    let expected = HEADER_BYTES as u64 + n_static as u64 * a as u64 + n_dynamic as u64 * b as u64;
    if expected != bytes.len() as u64 {
        return Err(PayloadError::Length { n_static, n_dynamic, expected, found: bytes.len() });
    }
    let mut numbers = [0.0f64; 14];
    for (index, (number, chunk)) in numbers.iter_mut().zip(header[24..].as_chunks::<8>().0).enumerate() {
        *number = f64::from_le_bytes(*chunk);
        if !number.is_finite() {
            return Err(PayloadError::Number { index, value: *number });
        }
    }
    Ok(fill(Splats::zeros(layout, n_static, n_dynamic), &numbers, &bytes[HEADER_BYTES..]))
}

/// Takes the next component of `rows` values of `width` bytes from `rest`.
fn component<'a>(rest: &mut &'a [u8], width: usize, rows: usize) -> impl Fn(usize) -> u32 + use<'a> {
    let (planes, behind) = rest.split_at(width * rows);
    *rest = behind;
    move |row| (0..width).fold(0, |q, k| q | u32::from(planes[k * rows + row]) << (8 * k))
}

fn fill(mut splats: Splats, numbers: &[f64; 14], mut planes: &[u8]) -> Splats {
    let [cx, cy, cz, spread, step, scale_low, scale_step, colour_step, rest @ ..] = *numbers;
    let [time_low, time_step, sd_low, sd_step, velocity_spread, velocity_step] = rest;
    let linear = |low, step| Linear { low, step, top: 0.0 };
    let (layout, n, late) = (splats.layout(), splats.n(), splats.n_dynamic());
    let mut put = |column, offset, value: &dyn Fn(usize) -> f32| {
        for (row, v) in splats.column_mut(column, offset).iter_mut().enumerate() {
            *v = value(row);
        }
    };
    for (k, centre) in [cx, cy, cz].into_iter().enumerate() {
        let (q, sinh) = (component(&mut planes, 3, n), Sinh::mean(centre, spread, step));
        put(Column::Mean, k, &|row| sinh.value(q(row)));
    }
    for k in 0..layout.range(Column::LogScale).len() {
        let (q, code) = (component(&mut planes, 1, n), linear(scale_low, scale_step));
        put(Column::LogScale, k, &|row| code.value(q(row)) as f32);
    }
    if !layout.isotropic {
        let q = component(&mut planes, 4, n);
        for k in 0..4 {
            put(Column::Quat, k, &|row| rotation_value(q(row))[k]);
        }
    }
    let q = component(&mut planes, 1, n);
    put(Column::Opacity, 0, &|row| {
        let opacity = (f64::from(q(row)) / 255.0).clamp(1.0 - OPAQUE, OPAQUE);
        (opacity / (1.0 - opacity)).ln() as f32
    });
    for k in 0..layout.range(Column::Colour).len() {
        let q = component(&mut planes, 2, n);
        put(Column::Colour, k, &|row| (colour_step * (f64::from(q(row)) - super::MIDDLE_16)) as f32);
    }
    let (q, code) = (component(&mut planes, 2, late), linear(time_low, time_step));
    put(Column::TimeMean, 0, &|row| code.value(q(row)) as f32);
    let (q, code) = (component(&mut planes, 1, late), linear(sd_low, sd_step));
    put(Column::LogTimeSd, 0, &|row| code.value(q(row)) as f32);
    for k in 0..3 {
        let (q, sinh) = (component(&mut planes, 2, late), Sinh::velocity(velocity_spread, velocity_step));
        put(Column::Velocity, k, &|row| sinh.value(q(row)));
    }
    splats
}
