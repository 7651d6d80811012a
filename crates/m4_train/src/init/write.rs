//! Writes points as splats, sized and oriented by the spacing of their neighbours.

use crate::init::{InitConfig, shell::Shell, voxel::Centroids};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::{
    Column, Splats,
    nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3},
};
use rayon::prelude::*;
use std::num::NonZero;

/// Value of the constant spherical harmonic.
pub(crate) const Y00: f32 = 0.282_094_8;
/// Grey of splats that take light away; a little above 0, where the gradient of the colour ends.
pub(crate) const DARK: f32 = 0.02;
/// Grey of splats that add light.
pub(crate) const BRIGHT: f32 = 1.0;
/// Opacity of the shell: behind it there is only the background.
const SHELL_OPACITY: f32 = 0.9;
/// Splats of standard deviation 0.75 of their spacing cover each place `2 pi 0.75^2` times.
const COVER: f32 = 3.5;

/// Neighbours, the point itself among them, whose spread gives a splat its axes and its standard
/// deviations: a disc on the surface (our rule; measured: +1 dB on whole held-out views, +0.5 dB
/// inside dynamic parts over spheres; docs/decisions/0004).
const DISC_NEIGHBOURS: usize = 9;
/// Thickness of a disc: least standard deviation in units of the distance to the three nearest
/// neighbours (docs/decisions/0004).
const DISC_THICKNESS: f32 = 0.05;
/// A disc is at most this much longer than a sphere would be wide.
const MOST_STRETCHED: f32 = 3.0;
/// Least share of a lifetime that is kept where the path bends: splats of neighbouring keyframes
/// must cover the time between them.
const SHORTEST: f32 = 0.5;
/// Largest standard deviation, in voxel edges: an isolated point must not become a cloud (our
/// rule).
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

    /// Points of a surface: spheres as large as their spacing, or discs as their neighbours are
    /// spread.
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
                let sd = (config.scale_factor * spread.sd[k])
                    .clamp(thinnest, longest)
                    .min(largest(i));
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

    /// Shortens the lifetime of the rows from `first` on: a splat follows a straight line, and
    /// within one standard deviation in time it should leave its path, which bends away by `bend`
    /// until the next keyframe, by its own size at most. The deviation grows with the square of
    /// time.
    pub fn shorten(&mut self, first: usize, bend: &[f32]) {
        let n_static = self.splats.n_static();
        let axes = if self.splats.layout().isotropic { 1 } else { 3 };
        for (row, &bend) in (first..).zip(bend) {
            let log_size = (0..axes)
                .map(|k| self.splats.column(Column::LogScale, k)[row])
                .fold(f32::MIN, f32::max);
            let share = (log_size.exp() / bend.max(f32::MIN_POSITIVE)).sqrt();
            self.splats.column_mut(Column::LogTimeSd, 0)[row - n_static] +=
                share.clamp(SHORTEST, 1.0).ln();
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

/// Smallest squared distance that counts: coincident points still get a size (Inria's reference).
const LEAST_SQUARED: f32 = 1e-7;

/// Root of the mean squared distance to the three nearest other points, world units, `[n]`.
/// Fewer than two points have no neighbour: `fallback` is returned for them.
pub(crate) fn spacing(points: &[[f32; 3]], fallback: &[f32]) -> Vec<f32> {
    const FOUR: NonZero<usize> = NonZero::new(4).unwrap();
    let tree = match ImmutableKdTree::<f32, 3>::new_from_slice(points) {
        Ok(tree) if points.len() > 1 => tree,
        _ => return fallback.to_vec(),
    };
    points
        .par_iter()
        .enumerate()
        .map(|(i, p)| {
            let near = tree
                .query(p)
                .nearest_n::<SquaredEuclidean<f32>>(FOUR)
                .execute();
            // One of the four is the point itself, whichever of its duplicates is named first.
            let own = near.iter().position(|n| n.item as usize == i).unwrap_or(0);
            let others = near
                .iter()
                .enumerate()
                .filter(|(k, _)| *k != own)
                .map(|(_, n)| n.distance);
            let (sum, count) = others.fold((0.0f32, 0.0f32), |(s, c), d| (s + d, c + 1.0));
            (sum / count.max(1.0)).max(LEAST_SQUARED).sqrt()
        })
        .collect()
}

/// How the neighbourhood of a point is spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Spread {
    /// Root mean square distance of the neighbours along each axis, world units.
    pub sd: [f32; 3],
    /// Rotation of the axes into the world, quaternion `(w, x, y, z)`.
    pub quat: [f32; 4],
}

/// Principal axes of the `count` nearest points, the point itself among them, around each point.
pub(crate) fn spread(points: &[[f32; 3]], count: usize) -> Vec<Spread> {
    let nothing = Spread {
        sd: [0.0; 3],
        quat: [1.0, 0.0, 0.0, 0.0],
    };
    let (Ok(tree), Some(count)) = (
        ImmutableKdTree::<f32, 3>::new_from_slice(points),
        NonZero::new(count.min(points.len())),
    ) else {
        return vec![nothing; points.len()];
    };
    points
        .par_iter()
        .map(|p| {
            let near = tree
                .query(p)
                .nearest_n::<SquaredEuclidean<f32>>(count)
                .execute();
            let mut second = Matrix3::<f64>::zeros();
            for n in &near {
                let q = points[n.item as usize];
                let d = Vector3::from([0, 1, 2].map(|k| f64::from(q[k]) - f64::from(p[k])));
                second += d * d.transpose();
            }
            second /= (near.len().max(2) - 1) as f64;
            let Some(eigen) = second.try_symmetric_eigen(f64::EPSILON, 100) else {
                return nothing;
            };
            let mut axes = eigen.eigenvectors;
            if axes.determinant() < 0.0 {
                axes.column_mut(2).neg_mut();
            }
            let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
            Spread {
                sd: [0, 1, 2].map(|k| eigen.eigenvalues[k].max(0.0).sqrt() as f32),
                quat: [q.w, q.i, q.j, q.k].map(|v| v as f32),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{Column, InitConfig, Splats, Writer, spacing, spread};
    use m4_core::{
        SplatLayout,
        nalgebra::{Quaternion, UnitQuaternion, Vector3},
    };

    #[test]
    fn a_lifetime_is_shortened_until_the_path_leaves_the_line_by_the_size_of_the_splat() {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        };
        // one static splat before them; size 0.1, lifetime e^0.5
        let mut splats = Splats::zeros(layout, 1, 6);
        for k in 0..3 {
            splats
                .column_mut(Column::LogScale, k)
                .fill([0.1f32, 0.05, 0.01][k].ln());
        }
        splats.column_mut(Column::LogTimeSd, 0).fill(0.5);
        let mut writer = Writer {
            splats: &mut splats,
            config: &InitConfig::default(),
            row: 7,
        };
        writer.shorten(1, &[0.0, 0.1, 0.2, 10.0, f32::NAN]);
        let share: Vec<f32> = splats
            .column(Column::LogTimeSd, 0)
            .iter()
            .map(|v| (v - 0.5).exp())
            .collect();
        for (got, want) in share.iter().zip([1.0, 1.0, 0.5f32.sqrt(), 0.5, 1.0, 1.0]) {
            assert!((got - want).abs() < 1e-5, "{share:?}");
        }
    }

    #[test]
    fn a_lattice_has_its_own_spacing() {
        let points: Vec<[f32; 3]> = (0..64)
            .map(|i| [(i % 8) as f32 * 0.5, (i / 8) as f32 * 0.5, 1.0])
            .collect();
        let got = spacing(&points, &[1.0; 64]);
        assert!(
            (got[27] - 0.5).abs() < 1e-6,
            "an inner point has four neighbours at 0.5"
        );
        // a corner: two at 0.5 and one at the diagonal
        assert!((got[0] - ((0.25 + 0.25 + 0.5) / 3.0f32).sqrt()).abs() < 1e-6);
    }

    #[test]
    fn duplicates_and_lone_points_get_a_size() {
        assert_eq!(spacing(&[[1.0, 2.0, 3.0]], &[0.7]), [0.7]);
        assert!(spacing(&[], &[]).is_empty());
        let many = spacing(&[[1.0, 1.0, 1.0]; 200], &[1.0; 200]);
        assert!(many.iter().all(|&s| s > 0.0 && s < 1e-3));
    }

    /// A lattice of 0.5 by 0.25 in a tilted plane: a disc twice as long as wide, flat across the
    /// plane.
    #[test]
    fn a_tilted_lattice_is_spread_along_its_axes() {
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(0.7f32, -0.4, 0.2));
        let points: Vec<[f32; 3]> = (0..81)
            .map(|i| (tilt * Vector3::new((i % 9) as f32 * 0.5, (i / 9) as f32 * 0.25, 0.0)).into())
            .collect();
        let got = spread(&points, 9)[40];
        let q = UnitQuaternion::from_quaternion(Quaternion::new(
            got.quat[0],
            got.quat[1],
            got.quat[2],
            got.quat[3],
        ));
        let flat = (0..3)
            .min_by(|&a, &b| got.sd[a].total_cmp(&got.sd[b]))
            .unwrap();
        assert!(got.sd[flat] < 1e-3, "{got:?}");
        let normal = q * Vector3::ith(flat, 1.0);
        assert!(normal.dot(&(tilt * Vector3::z())).abs() > 0.9999);
        let long = (0..3)
            .max_by(|&a, &b| got.sd[a].total_cmp(&got.sd[b]))
            .unwrap();
        // nearest nine: one row of three, two of the next, and the far ones of the short axis
        assert!(got.sd[long] > 0.2 && got.sd[long] < 0.6, "{got:?}");
    }

    #[test]
    fn too_few_points_have_no_axes() {
        assert_eq!(spread(&[[1.0; 3]], 9)[0].sd, [0.0; 3]);
        assert_eq!(spread(&[[1.0; 3]; 2], 0)[1].quat, [1.0, 0.0, 0.0, 0.0]);
        assert!(spread(&[[f32::NAN; 3]; 4], 3).len() == 4);
        assert!(spread(&[], 9).is_empty());
    }
}
