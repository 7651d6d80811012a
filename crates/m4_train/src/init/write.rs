//! Writes points into rows of splats.

use crate::init::{
    InitConfig,
    shell::Shell,
    spacing::{spacing, spread},
    voxel::Centroids,
};
use m4_core::{Column, Splats};

/// Value of the constant spherical harmonic.
const Y00: f32 = 0.282_094_8;
/// Grey of splats that take light away; a little above 0, where the gradient of the colour ends.
pub(crate) const DARK: f32 = 0.02;
/// Grey of splats that add light.
pub(crate) const BRIGHT: f32 = 1.0;
/// Opacity of the shell: behind it there is only the background.
const SHELL_OPACITY: f32 = 0.9;
/// Splats of standard deviation 0.75 of their spacing cover each place `2 pi 0.75^2` times.
const COVER: f32 = 3.5;

/// Neighbours, the point itself among them, whose spread gives a splat its axes and its standard deviations: a disc on the
/// surface (our rule; measured: +1 dB on whole held-out views, +0.5 dB inside moving parts over spheres; docs/decisions/0004).
const DISC_NEIGHBOURS: usize = 9;
/// Thickness of a disc: least standard deviation in units of the distance to the three nearest neighbours (docs/decisions/0004).
const DISC_THICKNESS: f32 = 0.05;
/// A disc is at most this much longer than a sphere would be wide.
const MOST_STRETCHED: f32 = 3.0;
/// Least share of a lifetime that is kept where the path bends: splats of neighbouring keyframes must cover the time between them.
const SHORTEST: f32 = 0.5;
/// Largest standard deviation, in voxel edges: an isolated point must not become a cloud (our rule).
const MOST_EDGES: f32 = 3.0;

/// Fills rows one after the other.
pub(crate) struct Writer<'a> {
    pub splats: &'a mut Splats,
    pub config: &'a InitConfig,
    /// The next row.
    pub row: usize,
}

impl Writer<'_> {
    fn put(&mut self, mean: [f32; 3], rgb: [f32; 3], sd: f32, opacity: f32) {
        let row = self.row;
        for k in 0..3 {
            self.splats.column_mut(Column::Mean, k)[row] = mean[k];
            self.splats.column_mut(Column::Colour, k)[row] = (rgb[k] - 0.5) / Y00;
        }
        let isotropic = self.splats.layout().isotropic;
        for k in 0..if isotropic { 1 } else { 3 } {
            self.splats.column_mut(Column::LogScale, k)[row] = sd.ln();
        }
        if !isotropic {
            self.splats.column_mut(Column::Quat, 0)[row] = 1.0;
        }
        self.splats.column_mut(Column::Opacity, 0)[row] = (opacity / (1.0 - opacity)).ln();
        self.row += 1;
    }

    /// Points of a surface: spheres as large as their spacing, or discs as their neighbours are spread.
    pub fn surface(&mut self, points: &Centroids) {
        let config = self.config;
        let first = self.row;
        let size = spacing(&points.xyz, &points.edge);
        let largest = |i: usize| MOST_EDGES * points.edge[i];
        for (i, &p) in points.xyz.iter().enumerate() {
            let sd = (config.scale_factor * size[i]).min(largest(i));
            self.put(p, points.rgb[i], sd, config.opacity);
        }
        if config.isotropic {
            return;
        }
        for (i, spread) in spread(&points.xyz, DISC_NEIGHBOURS).into_iter().enumerate() {
            let thinnest = DISC_THICKNESS * size[i];
            let longest = (MOST_STRETCHED * config.scale_factor * size[i]).max(thinnest);
            for k in 0..3 {
                let sd = (config.scale_factor * spread.sd[k]).clamp(thinnest, longest).min(largest(i));
                self.splats.column_mut(Column::LogScale, k)[first + i] = sd.ln();
            }
            for k in 0..4 {
                self.splats.column_mut(Column::Quat, k)[first + i] = spread.quat[k];
            }
        }
    }

    /// Splats that tint what is behind them; colours of `points` are shares of light.
    pub fn tint(&mut self, points: &Centroids, grey: f32) {
        for (i, &p) in points.xyz.iter().enumerate() {
            let opacity = (points.rgb[i][0] / COVER).clamp(0.01, 0.5);
            self.put(p, [grey; 3], 0.75 * points.edge[i], opacity);
        }
    }

    /// Appends the background sphere.
    pub fn shell(&mut self, shell: &Shell) {
        for (&p, &rgb) in shell.xyz.iter().zip(&shell.rgb) {
            self.put(p, rgb, shell.sd, SHELL_OPACITY);
        }
    }

    /// Middle and logarithm of the standard deviation, frames, of the rows from `first` on.
    pub fn time(&mut self, first: usize, (mean, log_sd): (f32, f32)) {
        let n_static = self.splats.n_static();
        let rows = first - n_static..self.row - n_static;
        self.splats.column_mut(Column::TimeMean, 0)[rows.clone()].fill(mean);
        self.splats.column_mut(Column::LogTimeSd, 0)[rows].fill(log_sd);
    }

    /// Shortens the lifetime of the rows from `first` on: a splat follows a straight line, and within one standard deviation in time
    /// it should leave its path, which bends away by `bend` until the next keyframe, by its own size at most. The deviation grows with
    /// the square of time.
    pub fn shorten(&mut self, first: usize, bend: &[f32]) {
        let n_static = self.splats.n_static();
        let axes = if self.splats.layout().isotropic { 1 } else { 3 };
        for (row, &bend) in (first..).zip(bend) {
            let log_size = (0..axes).map(|k| self.splats.column(Column::LogScale, k)[row]).fold(f32::MIN, f32::max);
            let share = (log_size.exp() / bend.max(f32::MIN_POSITIVE)).sqrt();
            self.splats.column_mut(Column::LogTimeSd, 0)[row - n_static] += share.clamp(SHORTEST, 1.0).ln();
        }
    }

    /// Velocities of the rows from `first` on.
    pub fn velocity(&mut self, first: usize, velocities: &[[f32; 3]]) {
        let n_static = self.splats.n_static();
        for k in 0..3 {
            let column = &mut self.splats.column_mut(Column::Velocity, k)[first - n_static..];
            for (out, v) in column.iter_mut().zip(velocities) {
                *out = v[k];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Column, InitConfig, Splats, Writer};
    use m4_core::SplatLayout;

    #[test]
    fn a_lifetime_is_shortened_until_the_path_leaves_the_line_by_the_size_of_the_splat() {
        let layout = SplatLayout { isotropic: false, sh_degree: 0, time_degree: 0 };
        // one static splat before them; size 0.1, lifetime e^0.5
        let mut splats = Splats::zeros(layout, 1, 6);
        for k in 0..3 {
            splats.column_mut(Column::LogScale, k).fill([0.1f32, 0.05, 0.01][k].ln());
        }
        splats.column_mut(Column::LogTimeSd, 0).fill(0.5);
        let mut writer = Writer { splats: &mut splats, config: &InitConfig::default(), row: 7 };
        writer.shorten(1, &[0.0, 0.1, 0.2, 10.0, f32::NAN]);
        let share: Vec<f32> = splats.column(Column::LogTimeSd, 0).iter().map(|v| (v - 0.5).exp()).collect();
        for (got, want) in share.iter().zip([1.0, 1.0, 0.5f32.sqrt(), 0.5, 1.0, 1.0]) {
            assert!((got - want).abs() < 1e-5, "{share:?}");
        }
    }
}
