//! Decodes bytes to splats.

use super::bound::{self, Table};
use super::{HEADER_BYTES, MAGIC, VERSION, VERSION_BOUND, bytes_per_bound_splat, bytes_per_splat};
use super::{Linear, Sinh, rotation_value};
use m4_core::{Column, ShapeError, SplatLayout, Splats};

/// Why bytes are not the splats of a page.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PayloadError {
    /// Too short for a header, or another first word.
    #[error("these {0} bytes do not begin with the header of a minute4d page")]
    Header(usize),
    /// A later layout.
    #[error(
        "the splats are of version {0}, this program reads versions {VERSION} and {VERSION_BOUND}; write the page again"
    )]
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
    /// Bound splats that are not those of the windows, or more than there are.
    #[error(
        "{bound} bound splats are named, {carried} belong to windows, and there are {n_dynamic} dynamic splats; write the page again"
    )]
    Bound {
        /// From the header.
        bound: usize,
        /// The sum over the windows.
        carried: u64,
        /// From the header.
        n_dynamic: usize,
    },
    /// A bound splat that is born at a key that its window does not have.
    #[error(
        "bound splat {splat} is born at key {key}, its window has {keys}; write the page again"
    )]
    Key {
        /// Counted from 0.
        splat: usize,
        /// The value in the file.
        key: usize,
        /// Keys of the window.
        keys: usize,
    },
    /// Weights of more than 1.
    #[error("the weights of bound splat {splat} sum to more than 1; write the page again")]
    Weights {
        /// Counted from 0.
        splat: usize,
    },
    /// A time of a window that is not finite.
    #[error("key {index} of the windows is {value}; it must be finite")]
    Time {
        /// Counted from 0 over all windows.
        index: usize,
        /// The value in the file.
        value: f32,
    },
    /// A rotation of a node that leaves out a component that does not exist.
    #[error("pose {pose} of the nodes leaves out component {component}; the last is 3")]
    Turn {
        /// Counted from 0 over all windows.
        pose: usize,
        /// The value in the file.
        component: u32,
    },
    /// Keys that do not rise, or a node that its window does not have.
    #[error("the windows of the bound splats do not fit together: {0}; write the page again")]
    Windows(ShapeError),
}

/// The most opaque a splat comes back: its logit must be finite.
const OPAQUE: f64 = 1.0 - 1.0 / 2048.0;

/// The splats, as a renderer takes them.
pub fn decode(bytes: &[u8]) -> Result<Splats, PayloadError> {
    let header = bytes
        .first_chunk::<HEADER_BYTES>()
        .filter(|h| h.starts_with(MAGIC));
    let header = header.ok_or(PayloadError::Header(bytes.len()))?;
    let word = |at: usize| {
        u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
    };
    if word(4) != VERSION && word(4) != VERSION_BOUND {
        return Err(PayloadError::Version(word(4)));
    }
    let (sh_degree, time_degree) = (header[16], header[17]);
    if sh_degree > 3 || time_degree > 2 {
        return Err(PayloadError::Degree {
            sh_degree,
            time_degree,
        });
    }
    let layout = SplatLayout {
        isotropic: header[18] == 1,
        sh_degree: usize::from(sh_degree),
        time_degree: usize::from(time_degree),
    };
    let (n_static, n_dynamic) = (word(8) as usize, word(12) as usize);
    let table = if word(4) == VERSION {
        None
    } else {
        Some(Table::read(bytes, n_dynamic)?)
    };
    let (n_bound, behind) = table
        .as_ref()
        .map_or((0, 0), |table| (table.bound, table.header_bytes()));
    let (a, b) = bytes_per_splat(layout);
    let rows = [
        (n_static, a),
        (n_bound, bytes_per_bound_splat(layout)),
        (n_dynamic - n_bound, b),
    ];
    let rows: u64 = rows
        .iter()
        .map(|&(rows, bytes)| rows as u64 * bytes as u64)
        .sum();
    let windows = table.as_ref().map_or(0, Table::window_bytes);
    let expected = (HEADER_BYTES as u64 + behind as u64 + rows).saturating_add(windows);
    if expected != bytes.len() as u64 {
        return Err(PayloadError::Length {
            n_static,
            n_dynamic,
            expected,
            found: bytes.len(),
        });
    }
    let mut numbers = [0.0f64; 14];
    for (index, (number, chunk)) in numbers
        .iter_mut()
        .zip(header[24..].as_chunks::<8>().0)
        .enumerate()
    {
        *number = f64::from_le_bytes(*chunk);
        if !number.is_finite() {
            return Err(PayloadError::Number {
                index,
                value: *number,
            });
        }
    }
    let mut splats = Splats::zeros(layout, n_static, n_dynamic);
    let rest = fill(
        &mut splats,
        n_bound,
        &numbers,
        &bytes[HEADER_BYTES + behind..],
    );
    if let Some(table) = table {
        bound::fill(&mut splats, &table, &means(&numbers), rest)?;
    }
    Ok(splats)
}

/// How coordinates are stored.
fn means(numbers: &[f64; 14]) -> [Sinh; 3] {
    let [x, y, z, spread, step, ..] = *numbers;
    [x, y, z].map(|centre| Sinh::mean(centre, spread, step))
}

/// Takes the next component of `rows` values of `width` bytes from `rest`.
pub(super) fn component<'a>(
    rest: &mut &'a [u8],
    width: usize,
    rows: usize,
) -> impl Fn(usize) -> u32 + use<'a> {
    let (planes, behind) = rest.split_at(width * rows);
    *rest = behind;
    move |row| (0..width).fold(0, |q, k| q | u32::from(planes[k * rows + row]) << (8 * k))
}

/// Fills in what all splats have, and the rest of the free ones, which follow `n_bound` bound ones;
/// what is behind that.
fn fill<'a>(
    splats: &mut Splats,
    n_bound: usize,
    numbers: &[f64; 14],
    mut planes: &'a [u8],
) -> &'a [u8] {
    let [_, _, _, _, _, scale_low, scale_step, colour_step, rest @ ..] = *numbers;
    let [
        time_low,
        time_step,
        sd_low,
        sd_step,
        velocity_spread,
        velocity_step,
    ] = rest;
    let linear = |low, step| Linear {
        low,
        step,
        top: 0.0,
    };
    let (layout, n, late) = (splats.layout(), splats.n(), splats.n_dynamic() - n_bound);
    let shared = layout.shared_columns();
    let mut put = |column, offset, value: &dyn Fn(usize) -> f32| {
        let first = if layout.column(column) < shared {
            0
        } else {
            n_bound
        };
        for (row, v) in splats.column_mut(column, offset)[first..]
            .iter_mut()
            .enumerate()
        {
            *v = value(row);
        }
    };
    for (k, sinh) in means(numbers).into_iter().enumerate() {
        let q = component(&mut planes, 3, n);
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
        put(Column::Colour, k, &|row| {
            (colour_step * (f64::from(q(row)) - super::MIDDLE_16)) as f32
        });
    }
    let (q, code) = (component(&mut planes, 2, late), linear(time_low, time_step));
    put(Column::TimeMean, 0, &|row| code.value(q(row)) as f32);
    let (q, code) = (component(&mut planes, 1, late), linear(sd_low, sd_step));
    put(Column::LogTimeSd, 0, &|row| code.value(q(row)) as f32);
    for k in 0..3 {
        let (q, sinh) = (
            component(&mut planes, 2, late),
            Sinh::velocity(velocity_spread, velocity_step),
        );
        put(Column::Velocity, k, &|row| sinh.value(q(row)));
    }
    planes
}
