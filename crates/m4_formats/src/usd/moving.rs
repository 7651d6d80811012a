//! Splats at any moment, without dropping those that the moment does not see.

use crate::row::sigmoid;
use m4_scene::{Column, Scene, Splats};

/// Opacities below this are not drawn (the cut-off of the renderer).
const LEAST_OPACITY: f64 = 1.0 / 255.0;
/// Splats whose marginal in time is at most this are left out of a frame (section 1.3).
const LEAST_MARGINAL: f64 = 0.05;
/// Standard deviations that an ellipsoid reaches.
const REACH_SD: f64 = 3.0;

/// The rows that some sample sees, and their values at a moment.
pub struct Moving<'a> {
    splats: &'a Splats,
    period_frames: f64,
    /// In order.
    pub rows: Vec<usize>,
    /// Lower and upper corner of what is seen, world units.
    pub extent: [[f64; 3]; 2],
}

impl<'a> Moving<'a> {
    /// `splats` are those of the scene, perhaps turned; `samples` are frames.
    pub fn new(scene: &Scene, splats: &'a Splats, samples: &[f64]) -> Self {
        let mut moving = Self {
            splats,
            period_frames: scene.time_frames as f64,
            rows: Vec::new(),
            extent: [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
        };
        for row in 0..splats.n() {
            let reach = (0..3)
                .map(|k| moving.log_scale(row, k))
                .fold(f64::NEG_INFINITY, f64::max);
            let reach = REACH_SD * reach.exp();
            let mut seen = false;
            let one = &samples[..1];
            let moments = if row < splats.n_static() { one } else { samples };
            for &t in moments {
                if moving.opacity(row, t) == 0.0 {
                    continue;
                }
                seen = true;
                for (k, x) in moving.mean(row, t).into_iter().enumerate() {
                    moving.extent[0][k] = moving.extent[0][k].min(x - reach);
                    moving.extent[1][k] = moving.extent[1][k].max(x + reach);
                }
            }
            if seen {
                moving.rows.push(row);
            }
        }
        moving
    }

    fn at(&self, column: Column, k: usize, row: usize) -> f64 {
        f64::from(self.splats.column(column, k)[row])
    }

    /// Frames since the middle of its life; 0 for a static splat.
    fn dt(&self, row: usize, t: f64) -> f64 {
        match row.checked_sub(self.splats.n_static()) {
            Some(d) => t - self.at(Column::TimeMean, 0, d),
            None => 0.0,
        }
    }

    /// 0..1; 0 where it is not drawn.
    pub fn opacity(&self, row: usize, t: f64) -> f64 {
        let opacity = sigmoid(self.splats.column(Column::Opacity, 0)[row]);
        let seen = match row.checked_sub(self.splats.n_static()) {
            Some(d) => {
                let z = self.dt(row, t) / self.at(Column::LogTimeSd, 0, d).exp();
                let marginal = (-0.5 * z * z).exp();
                if marginal <= LEAST_MARGINAL {
                    0.0
                } else {
                    marginal * opacity
                }
            }
            None => opacity,
        };
        if seen < LEAST_OPACITY { 0.0 } else { seen }
    }

    /// World units.
    pub fn mean(&self, row: usize, t: f64) -> [f64; 3] {
        let dt = self.dt(row, t);
        std::array::from_fn(|k| match row.checked_sub(self.splats.n_static()) {
            Some(d) => self.at(Column::Mean, k, row) + self.at(Column::Velocity, k, d) * dt,
            None => self.at(Column::Mean, k, row),
        })
    }

    pub fn log_scale(&self, row: usize, k: usize) -> f64 {
        let isotropic = self.splats.layout().isotropic;
        self.at(Column::LogScale, if isotropic { 0 } else { k }, row)
    }

    /// `(w, x, y, z)`.
    pub fn quat(&self, row: usize) -> [f32; 4] {
        if self.splats.layout().isotropic {
            return [1.0, 0.0, 0.0, 0.0];
        }
        crate::row::unit(std::array::from_fn(|k| self.splats.column(Column::Quat, k)[row]))
    }

    /// Coefficients of a spatial harmonic, one a channel.
    pub fn harmonic(&self, row: usize, term: usize, t: f64) -> [f64; 3] {
        let layout = self.splats.layout();
        let dt = self.dt(row, t);
        let mut sum = [0.0; 3];
        for n in 0..=layout.time_degree {
            let wave = (std::f64::consts::TAU * n as f64 * dt / self.period_frames).cos();
            for (channel, sum) in sum.iter_mut().enumerate() {
                let c = 3 * (n * layout.sh_terms() + term) + channel;
                *sum += wave * self.at(Column::Colour, c, row);
            }
        }
        sum
    }
}
