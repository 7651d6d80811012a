//! Decodes bound splats and their windows.

use super::super::{Linear, PayloadError, Sinh, decode::component};
use super::{
    ANCHOR_BYTES, FIXED_BYTES, HEADER_BYTES, LIFE_TOP, POSE_BYTES, TABLE_BYTES, TURN_TOP,
    WEIGHT_SUM,
};
use super::{step_value, turn_value};
use m4_core::{Binding, Column, Pose, Splats, Window};
use std::sync::Arc;

/// The part of the header behind that of version 1.
#[derive(Debug, Default)]
pub(in super::super) struct Table {
    /// Bound splats.
    pub bound: usize,
    /// `life_low` to `trend_step`.
    numbers: [f64; 6],
    /// Splats, keys and nodes of each window.
    windows: Vec<[u32; 3]>,
}

impl Table {
    /// Reads it from a payload of version 2 with this number of dynamic splats.
    pub fn read(bytes: &[u8], n_dynamic: usize) -> Result<Self, PayloadError> {
        let fixed = bytes
            .get(HEADER_BYTES..FIXED_BYTES)
            .ok_or(PayloadError::Header(bytes.len()))?;
        let words = fixed.as_chunks::<4>().0;
        let (bound, windows) = (
            u32::from_le_bytes(words[0]) as usize,
            u32::from_le_bytes(words[1]) as usize,
        );
        let mut numbers = [0.0f64; 6];
        for (k, (number, chunk)) in numbers
            .iter_mut()
            .zip(fixed[8..].as_chunks::<8>().0)
            .enumerate()
        {
            *number = f64::from_le_bytes(*chunk);
            if !number.is_finite() {
                return Err(PayloadError::Number {
                    index: 14 + k,
                    value: *number,
                });
            }
        }
        let table = windows
            .checked_mul(TABLE_BYTES)
            .and_then(|length| bytes.get(FIXED_BYTES..)?.get(..length));
        let table = table.ok_or(PayloadError::Header(bytes.len()))?;
        let word = |entry: &[u8; TABLE_BYTES], k: usize| {
            u32::from_le_bytes([
                entry[4 * k],
                entry[4 * k + 1],
                entry[4 * k + 2],
                entry[4 * k + 3],
            ])
        };
        let windows: Vec<[u32; 3]> = table
            .as_chunks::<TABLE_BYTES>()
            .0
            .iter()
            .map(|entry| [0, 1, 2].map(|k| word(entry, k)))
            .collect();
        let carried: u64 = windows.iter().map(|w| u64::from(w[0])).sum();
        if carried != bound as u64 || bound > n_dynamic {
            return Err(PayloadError::Bound {
                bound,
                carried,
                n_dynamic,
            });
        }
        Ok(Self {
            bound,
            numbers,
            windows,
        })
    }

    /// Bytes of the table and of what comes before it, behind the header of version 1.
    pub fn header_bytes(&self) -> usize {
        FIXED_BYTES - HEADER_BYTES + TABLE_BYTES * self.windows.len()
    }

    /// Bytes of the windows behind the splats; more than there can be where that is no number of
    /// bytes.
    pub fn window_bytes(&self) -> u64 {
        let bytes = |&[_, keys, nodes]: &[u32; 3]| {
            let poses = u64::from(keys)
                .saturating_mul(u64::from(nodes))
                .saturating_mul(POSE_BYTES);
            poses
                .saturating_add(4 * u64::from(keys))
                .saturating_add(ANCHOR_BYTES * u64::from(nodes))
        };
        self.windows.iter().map(bytes).fold(0, u64::saturating_add)
    }
}

/// Fills in what bound splats have beside what all have, and binds them: `planes` are those behind
/// the free splats.
pub(in super::super) fn fill(
    splats: &mut Splats,
    table: &Table,
    mean: &[Sinh; 3],
    mut planes: &[u8],
) -> Result<(), PayloadError> {
    let [
        life_low,
        life_step,
        residual_spread,
        residual_step,
        trend_spread,
        trend_step,
    ] = table.numbers;
    let n = table.bound;
    for k in 0..3 {
        let (q, code) = (
            component(&mut planes, 2, n),
            Sinh::velocity(residual_spread, residual_step),
        );
        (0..n).for_each(|i| splats.column_mut(Column::Velocity, k)[i] = code.value(q(i)));
    }
    for k in 0..3 {
        let (q, code) = (
            component(&mut planes, 1, n),
            Sinh::trend(trend_spread, trend_step),
        );
        (0..n).for_each(|i| splats.column_mut(Column::Trend, k)[i] = code.value(q(i)));
    }
    let birth = component(&mut planes, 2, n);
    let life = Linear {
        low: life_low,
        step: life_step,
        top: f64::from(LIFE_TOP),
    };
    let (begin, end) = (component(&mut planes, 2, n), component(&mut planes, 2, n));
    let nodes: [_; 4] = std::array::from_fn(|_| component(&mut planes, 2, n));
    let weights: [_; 3] = std::array::from_fn(|_| component(&mut planes, 1, n));
    let windows = windows(table, mean, planes)?;

    let mut bindings = Vec::with_capacity(n);
    let index = table
        .windows
        .iter()
        .enumerate()
        .flat_map(|(w, count)| (0..count[0]).map(move |_| w));
    for (i, w) in index.enumerate() {
        let keys = windows[w].keys();
        let born = birth(i) as usize;
        let key = *keys.get(born).ok_or(PayloadError::Key {
            splat: i,
            key: born,
            keys: keys.len(),
        })?;
        let codes = [0, 1, 2].map(|k| weights[k](i));
        let rest = WEIGHT_SUM
            .checked_sub(codes.iter().sum())
            .ok_or(PayloadError::Weights { splat: i })?;
        let [a, b, c] = codes;
        let binding = Binding {
            window: w as u32,
            nodes: [0, 1, 2, 3].map(|k| nodes[k](i) as u16),
            weights: [a, b, c, rest].map(|q| q as f32 / WEIGHT_SUM as f32),
            life: [
                if begin(i) == 0 {
                    f32::NEG_INFINITY
                } else {
                    life.value(begin(i)) as f32
                },
                if end(i) == LIFE_TOP {
                    f32::INFINITY
                } else {
                    life.value(end(i)) as f32
                },
            ],
        };
        let (first, last) = (keys[0], keys[keys.len() - 1]);
        let length = binding.life[1].min(last) - binding.life[0].max(first);
        splats.column_mut(Column::TimeMean, 0)[i] = key;
        splats.column_mut(Column::LogTimeSd, 0)[i] = (0.5 * length).max(f32::EPSILON).ln();
        bindings.push(binding);
    }
    splats
        .bind(Arc::new(windows), bindings)
        .map_err(PayloadError::Windows)
}

fn windows(
    table: &Table,
    mean: &[Sinh; 3],
    mut planes: &[u8],
) -> Result<Vec<Window>, PayloadError> {
    let sizes = || {
        table
            .windows
            .iter()
            .map(|&[_, keys, nodes]| (keys as usize, nodes as usize))
    };
    let all_keys: usize = sizes().map(|(keys, _)| keys).sum();
    let poses: usize = sizes().map(|(keys, nodes)| keys * nodes).sum();
    let places: usize = sizes().map(|(keys, nodes)| (keys + 1) * nodes).sum();
    let (keys, rest) = planes.split_at(4 * all_keys);
    planes = rest;
    let keys: Vec<f32> = keys
        .as_chunks::<4>()
        .0
        .iter()
        .map(|chunk| f32::from_le_bytes(*chunk))
        .collect();
    if let Some((index, value)) = keys.iter().enumerate().find(|(_, key)| !key.is_finite()) {
        return Err(PayloadError::Time {
            index,
            value: *value,
        });
    }
    let place: [Vec<u32>; 3] = std::array::from_fn(|_| {
        let q = component(&mut planes, 3, places);
        codes(
            sizes().map(|(keys, nodes)| (keys + 1, nodes)),
            (1 << 24) - 1,
            q,
        )
    });
    let left_out = component(&mut planes, 1, poses);
    let turn: [Vec<u32>; 3] =
        std::array::from_fn(|_| codes(sizes(), TURN_TOP, component(&mut planes, 2, poses)));
    let position = |i: usize| [0, 1, 2].map(|k| mean[k].value(place[k][i]));
    let (mut at_key, mut at_place, mut at_pose) = (0, 0, 0);
    let mut out = Vec::with_capacity(table.windows.len());
    for (count, nodes) in sizes() {
        let anchors = (at_place..at_place + nodes).map(position).collect();
        let mut poses = Vec::with_capacity(count * nodes);
        for i in 0..count * nodes {
            let largest = left_out(at_pose + i);
            if largest > 3 {
                return Err(PayloadError::Turn {
                    pose: at_pose + i,
                    component: largest,
                });
            }
            let rotation = turn_value(largest, [0, 1, 2].map(|k| turn[k][at_pose + i]));
            poses.push(Pose {
                position: position(at_place + nodes + i),
                rotation,
            });
        }
        out.push(
            Window::new(keys[at_key..at_key + count].to_vec(), anchors, poses)
                .map_err(PayloadError::Windows)?,
        );
        (at_key, at_place, at_pose) = (
            at_key + count,
            at_place + (count + 1) * nodes,
            at_pose + count * nodes,
        );
    }
    Ok(out)
}

/// Codes from their differences; `sizes` are rows and nodes of each window.
fn codes(
    sizes: impl Iterator<Item = (usize, usize)>,
    top: u32,
    step: impl Fn(usize) -> u32,
) -> Vec<u32> {
    let mut out: Vec<u32> = Vec::new();
    for (rows, nodes) in sizes {
        let first = out.len();
        for i in 0..rows * nodes {
            let before = if i < nodes { 0 } else { out[first + i - nodes] };
            out.push(step_value(before, step(first + i), top));
        }
    }
    out
}
