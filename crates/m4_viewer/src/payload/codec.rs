//! Converts numbers to unsigned integers and back.

use super::{MIDDLE_16, MIDDLE_24};

/// Where the planes of a parameter go.
pub(super) struct Planes {
    bytes: Vec<u8>,
}

impl Planes {
    /// Starts behind a header.
    pub fn after(header: Vec<u8>) -> Self {
        Self { bytes: header }
    }

    /// The planes of one component: `rows` values of `width` bytes.
    pub fn push(&mut self, width: usize, values: &[u32]) {
        for k in 0..width {
            self.bytes.extend(values.iter().map(|q| (q >> (8 * k)) as u8));
        }
    }

    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

/// `centre + spread sinh(step (q - middle))`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sinh {
    pub centre: f64,
    pub spread: f64,
    pub step: f64,
    pub middle: f64,
}

impl Sinh {
    pub fn mean(centre: f64, spread: f64, step: f64) -> Self {
        Self { centre, spread, step, middle: MIDDLE_24 }
    }

    pub fn velocity(spread: f64, step: f64) -> Self {
        Self { centre: 0.0, spread, step, middle: MIDDLE_16 }
    }

    /// The nearest `q`; the last one where the value lies beyond.
    pub fn code(&self, value: f32) -> u32 {
        let x = (f64::from(value) - self.centre) / self.spread;
        // `asinh` of the standard library takes three times as long for the same bits that count here
        let y = (x.abs() + (x * x + 1.0).sqrt()).ln().copysign(x);
        (y / self.step + self.middle).round().clamp(0.0, 2.0 * self.middle - 1.0) as u32
    }

    pub fn value(&self, q: u32) -> f32 {
        (self.centre + self.spread * (self.step * (f64::from(q) - self.middle)).sinh()) as f32
    }
}

/// `low + step q` with `q <= top`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Linear {
    pub low: f64,
    pub step: f64,
    pub top: f64,
}

impl Linear {
    /// From the smallest to the largest of `values`, with steps of at most `coarsest`: where that is not
    /// enough the smallest values are raised.
    pub fn over(values: impl Iterator<Item = f32>, top: f64, coarsest: f64) -> Self {
        let (low, high) = values
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(f64::from(v)), high.max(f64::from(v))));
        if low > high {
            return Self { low: 0.0, step: 1.0, top };
        }
        let step = ((high - low) / top).min(coarsest);
        Self { low: high - top * step, step, top }
    }

    /// The nearest `q`.
    pub fn code(&self, value: f32) -> u32 {
        if self.step > 0.0 {
            ((f64::from(value) - self.low) / self.step).round().clamp(0.0, self.top) as u32
        } else {
            0
        }
    }

    pub fn value(&self, q: u32) -> f64 {
        self.low + self.step * f64::from(q)
    }
}

/// A quaternion of any length but 0 as 32 bits; that of no rotation where it has no direction.
pub(super) fn rotation_code(quat: [f32; 4]) -> u32 {
    let length = quat.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
    if !(length.is_finite() && length > 0.0) {
        return rotation_code([1.0, 0.0, 0.0, 0.0]);
    }
    let largest = (1..4).fold(0, |best, k| if quat[k].abs() > quat[best].abs() { k } else { best });
    let sign = f64::from(quat[largest]).signum();
    (0..3).fold((largest as u32) << 30, |bits, k| {
        let v = sign * f64::from(quat[(largest + k + 1) % 4]) / length;
        let q = ((v * std::f64::consts::SQRT_2 + 1.0) / 2.0 * 1023.0).round().clamp(0.0, 1023.0) as u32;
        bits | q << (10 * k)
    })
}

/// The unit quaternion of [`rotation_code`].
pub(super) fn rotation_value(bits: u32) -> [f32; 4] {
    let largest = (bits >> 30) as usize;
    let (mut quat, mut rest) = ([0.0f64; 4], 1.0);
    for k in 0..3 {
        let q = f64::from((bits >> (10 * k)) & 1023);
        let v = (q / 1023.0 * 2.0 - 1.0) * std::f64::consts::FRAC_1_SQRT_2;
        quat[(largest + k + 1) % 4] = v;
        rest -= v * v;
    }
    quat[largest] = rest.max(0.0).sqrt();
    let length = quat.iter().map(|v| v * v).sum::<f64>().sqrt();
    quat.map(|v| (v / length) as f32)
}
