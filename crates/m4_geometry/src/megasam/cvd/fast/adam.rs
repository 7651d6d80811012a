//! One row of Adam. The definition is `reference::Adam`.

use crate::megasam::cvd::reference::DECAY;

/// What all variables of a step share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rate {
    /// Learning rate over the correction of the first moment.
    pub rate: f64,
    /// One over the root of the correction of the second moment.
    pub root: f64,
    pub epsilon: f64,
}

impl Rate {
    /// Of step `step`, from 1.
    pub fn new(learning_rate: f64, step: usize, epsilon: f64) -> Self {
        let step = i32::try_from(step).unwrap_or(i32::MAX);
        let [first, second] = DECAY.map(|beta| 1.0 - beta.powi(step));
        Self {
            rate: learning_rate / first,
            root: 1.0 / second.sqrt(),
            epsilon,
        }
    }

    /// One variable in double precision.
    pub fn step(&self, x: &mut f64, moments: &mut [f64; 2], gradient: f64) {
        let g = if gradient.is_nan() { 0.0 } else { gradient };
        let [m, v] = moments;
        *m = DECAY[0] * *m + (1.0 - DECAY[0]) * g;
        *v = DECAY[1] * *v + (1.0 - DECAY[1]) * g * g;
        *x -= self.rate * *m / (v.sqrt() * self.root + self.epsilon);
    }

    /// A row; all slices have one length. What is not a number in `g` counts as 0.
    #[inline(always)]
    pub fn row(&self, x: &mut [f32], m: &mut [f32], v: &mut [f32], g: &[f32]) {
        let n = x.len();
        let (m, v, g) = (&mut m[..n], &mut v[..n], &g[..n]);
        let [b1, b2] = DECAY.map(|b| b as f32);
        let [c1, c2] = DECAY.map(|b| (1.0 - b) as f32);
        let (rate, root, epsilon) = (self.rate as f32, self.root as f32, self.epsilon as f32);
        for i in 0..n {
            let g = if g[i].is_nan() { 0.0 } else { g[i] };
            m[i] = b1 * m[i] + c1 * g;
            v[i] = b2 * v[i] + c2 * g * g;
            x[i] -= rate * m[i] / (v[i].sqrt() * root + epsilon);
        }
    }
}
