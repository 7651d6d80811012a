//! Lengths as sines and cosines of sixteen frequencies.
//!
//! `[x, sin(2^k x), sin(2^k x + pi / 2)]` for k = -2 to 13, frequency by frequency, in each the
//! dimensions of `x`. Angles go into the ten thousands, where sines of 32 bits from a library or a
//! GPU are slow or wrong: here an angle is reduced in turns, of which doubling loses nothing.

use crate::ops::tensor;
use burn_core::tensor::{DType, Device, Tensor};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// The exponent of the lowest frequency.
const LOWEST: i32 = -2;
/// How many frequencies there are, each twice the one before.
const FREQUENCIES: usize = 16;
/// Rows of one task.
const ROWS: usize = 256;

/// Numbers that `dimensions` lengths become.
pub const fn width(dimensions: usize) -> usize {
    dimensions * (1 + 2 * FREQUENCIES)
}

/// The encoding of each of `lengths`, `[n, width(D)]` in numbers of the type `dtype`.
pub fn encoded<const D: usize>(lengths: &[[f32; D]], device: &Device, dtype: DType) -> Tensor<2> {
    if *device == Device::flex() {
        let rows = on_processor(lengths);
        tensor(rows, [lengths.len(), width(D)], device).cast(dtype)
    } else {
        by_tensors(lengths, device).cast(dtype)
    }
}

/// `sin(2 pi t)` for `t` in [-1/4, 1/4], within 1e-7.
fn sine_of_turns(t: f32) -> f32 {
    const C: [f64; 7] = [
        1.0,
        -1.0 / 6.0,
        1.0 / 120.0,
        -1.0 / 5040.0,
        1.0 / 362_880.0,
        -1.0 / 39_916_800.0,
        1.0 / 6_227_020_800.0,
    ];
    let x = t * std::f32::consts::TAU;
    let square = x * x;
    let mut p = C[6] as f32;
    for c in C[..6].iter().rev() {
        p = p * square + *c as f32;
    }
    p * x
}

fn on_processor<const D: usize>(lengths: &[[f32; D]]) -> Vec<f32> {
    // adding 1.5 * 2^52 rounds to whole numbers
    const MAGIC: f64 = 6_755_399_441_055_744.0;
    let mut out = vec![0.0; lengths.len() * width(D)];
    out.par_chunks_mut(ROWS * width(D))
        .zip(lengths.par_chunks(ROWS))
        .for_each(|(out, lengths)| {
            for (row, x) in out.chunks_exact_mut(width(D)).zip(lengths) {
                let (same, waves) = row.split_at_mut(D);
                same.copy_from_slice(x);
                let (sines, cosines) = waves.split_at_mut(D * FREQUENCIES);
                let turns = x.map(|x| f64::from(x) / TAU);
                let mut scale = 2f64.powi(LOWEST);
                for (sines, cosines) in sines.chunks_exact_mut(D).zip(cosines.chunks_exact_mut(D)) {
                    for d in 0..D {
                        let turn = turns[d] * scale;
                        let part = (turn - ((turn + MAGIC) - MAGIC)) as f32;
                        let distance = part.abs();
                        // to the quarter beside 0 with the same sine
                        let folded = distance.min(0.5 - distance).copysign(part);
                        sines[d] = sine_of_turns(folded);
                        cosines[d] = sine_of_turns(0.25 - distance);
                    }
                    scale *= 2.0;
                }
            }
        });
    out
}

/// The same by operations that every device has: turns come as two numbers of 32 bits.
fn by_tensors<const D: usize>(lengths: &[[f32; D]], device: &Device) -> Tensor<2> {
    let n = lengths.len();
    let turns: Vec<f64> = lengths
        .as_flattened()
        .iter()
        .map(|&x| f64::from(x) / TAU)
        .collect();
    let high: Vec<f32> = turns.iter().map(|&t| t as f32).collect();
    let low: Vec<f32> = turns
        .iter()
        .zip(&high)
        .map(|(t, &h)| (t - f64::from(h)) as f32)
        .collect();
    let scales = (0..FREQUENCIES as i32)
        .map(|k| 2f32.powi(LOWEST + k))
        .collect();
    let scales: Tensor<3> = tensor(scales, [1, FREQUENCIES, 1], device);
    let [high, low] = [high, low].map(|part| tensor(part, [n, 1, D], device) * scales.clone());
    let nearest = |x: Tensor<3>| x.clone() - x.round();
    let turn = nearest(nearest(high) + low);
    let sine = |turn: Tensor<3>| {
        let wave = turn.mul_scalar(TAU as f32).sin();
        wave.reshape([n, FREQUENCIES * D])
    };
    let same = tensor(lengths.as_flattened().to_vec(), [n, D], device);
    Tensor::cat(
        vec![
            same,
            sine(turn.clone()),
            sine(nearest(turn.add_scalar(0.25))),
        ],
        1,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu;
    use std::f64::consts::PI;

    #[test]
    fn agrees_with_its_definition_and_with_tensors() {
        let lengths: Vec<[f32; 3]> = (0..700)
            .map(|i| [0.37, -1.91, 0.013].map(|f: f32| f * (i as f32 - 300.0)))
            .chain([[0.0, -0.0, 1e-6], [0.25, 500.0, -500.0]])
            .collect();
        let got = on_processor(&lengths);
        for (row, x) in got.chunks_exact(width(3)).zip(&lengths) {
            assert_eq!(row[..3], *x);
            for k in 0..FREQUENCIES {
                for d in 0..3 {
                    let angle = f64::from(x[d]) * 2f64.powi(LOWEST + k as i32);
                    let (sine, cosine) = (row[3 + 3 * k + d], row[3 + 3 * (FREQUENCIES + k) + d]);
                    assert!(
                        (f64::from(sine) - angle.sin()).abs() < 4e-7,
                        "sin {angle}: {sine}"
                    );
                    assert!(
                        (f64::from(cosine) - (angle + PI / 2.0).sin()).abs() < 4e-7,
                        "cos {angle}: {cosine}"
                    );
                }
            }
        }
        let tensors: Vec<f32> = by_tensors(&lengths, &cpu()).try_into_vec_as().unwrap();
        assert_eq!(tensors.len(), got.len());
        for (a, b) in got.iter().zip(tensors) {
            assert!((a - b).abs() < 2e-6, "{a} and {b}");
        }
    }
}
