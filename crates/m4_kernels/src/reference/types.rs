//! Splats one by one, in the precision of the reference.

use crate::{
    View,
    project::{
        NEAR_MIN,
        reference::{Pinhole, PinholeGradient},
    },
    slice::reference::{Gaussian, Life, RotorGaussian, Shape},
};
use m4_core::{
    Column, Real, SplatLayout, Splats,
    nalgebra::{Vector2, Vector3, Vector4},
};

/// Where a splat is, in either form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Geometry<T: Real> {
    /// Velocity form, static included: what [`Splats`] hold.
    Gaussian(Gaussian<T>),
    /// Rotor pair.
    Rotor(RotorGaussian<T>),
}

/// One splat; also the gradient with respect to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Splat<T: Real> {
    /// Mean, shape, life.
    pub geometry: Geometry<T>,
    /// Logit of the opacity.
    pub opacity: T,
    /// Colour coefficients, temporal index major.
    pub coefficients: Vec<[T; 3]>,
    /// Spatial harmonics a temporal one.
    pub sh_terms: usize,
}

/// [`View`] in the precision of the reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setup<T: Real> {
    /// Lens and pose.
    pub camera: Pinhole<T>,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Frames.
    pub t: T,
    /// Colour behind everything.
    pub background: [T; 3],
    /// Splats with a z-depth of at most this are skipped.
    pub near: T,
    /// Opacity-compensated 2D filter.
    pub mip: bool,
    /// Period of the first temporal harmonic of the colour, frames.
    pub period: T,
}

impl<T: Real> Setup<T> {
    /// `view`, rounded to `T`.
    pub fn new(view: &View) -> Self {
        Self {
            camera: Pinhole::new(&view.camera),
            width: view.camera.intrinsics.width,
            height: view.camera.intrinsics.height,
            t: T::of(view.t),
            background: view.background.map(|c| T::of(f64::from(c))),
            near: T::of(f64::from(view.near).max(NEAR_MIN)),
            mip: view.mip,
            period: T::of(f64::from(view.period)),
        }
    }
}

/// The gradient of a loss with respect to everything.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneGradient<T: Real> {
    /// One per splat; 0 for splats that are not in the frame.
    pub splats: Vec<Splat<T>>,
    /// Whether the splat is composited on at least one pixel.
    pub touched: Vec<bool>,
    /// With respect to the projected centre, pixels.
    pub means2d: Vec<Vector2<T>>,
    /// With respect to the camera.
    pub camera: PinholeGradient<T>,
    /// With respect to the background colour.
    pub background: [T; 3],
}

impl<T: Real> Splat<T> {
    /// Every parameter 0, same form.
    pub fn zero_like(&self) -> Self {
        let geometry = match &self.geometry {
            Geometry::Gaussian(g) => Geometry::Gaussian(Gaussian {
                mean: Vector3::zeros(),
                shape: match g.shape {
                    Shape::Isotropic { .. } => Shape::Isotropic {
                        log_scale: T::zero(),
                    },
                    Shape::Anisotropic { .. } => Shape::Anisotropic {
                        log_scale: Vector3::zeros(),
                        quat: Vector4::zeros(),
                    },
                },
                life: g.life.map(|_| Life {
                    time_mean: T::zero(),
                    log_time_sd: T::zero(),
                    velocity: Vector3::zeros(),
                }),
            }),
            Geometry::Rotor(_) => Geometry::Rotor(RotorGaussian {
                mean: Vector3::zeros(),
                time_mean: T::zero(),
                log_scale: Vector4::zeros(),
                left: Vector4::zeros(),
                right: Vector4::zeros(),
            }),
        };
        Self {
            geometry,
            opacity: T::zero(),
            coefficients: vec![[T::zero(); 3]; self.coefficients.len()],
            sh_terms: self.sh_terms,
        }
    }

    /// Every parameter in the order of [`Splats::columns`]; the time columns only of dynamic
    /// splats. Empty for the rotor form, which has no columns.
    pub fn parameters(&self) -> Vec<T> {
        let Geometry::Gaussian(g) = &self.geometry else {
            return Vec::new();
        };
        let mut out: Vec<T> = g.mean.iter().copied().collect();
        match &g.shape {
            Shape::Isotropic { log_scale } => out.push(*log_scale),
            Shape::Anisotropic { log_scale, quat } => {
                out.extend(log_scale.iter().chain(quat.iter()))
            }
        }
        out.push(self.opacity);
        out.extend(self.coefficients.iter().flatten());
        if let Some(life) = &g.life {
            out.extend([life.time_mean, life.log_time_sd]);
            out.extend(life.velocity.iter());
        }
        out
    }
}

impl<T: Real> SceneGradient<T> {
    /// As the columns of [`Splats`] with `n_static` static splats first; for the velocity form.
    pub fn columns(&self, layout: SplatLayout, n_static: usize) -> Vec<Vec<T>> {
        let mut columns = vec![Vec::new(); layout.columns()];
        for (row, splat) in self.splats.iter().enumerate() {
            let values = splat.parameters();
            let used = if row < n_static {
                layout.shared_columns()
            } else {
                columns.len()
            };
            for (column, value) in columns.iter_mut().zip(values).take(used) {
                column.push(value);
            }
        }
        columns
    }
}

/// The rows of `splats`, one by one.
pub fn splats_of<T: Real>(splats: &Splats) -> Vec<Splat<T>> {
    let layout = splats.layout();
    let at = |column: Column, offset: usize, row: usize| {
        T::of(f64::from(splats.column(column, offset)[row]))
    };
    let vector = |column, row| Vector3::from_fn(|k, _| at(column, k, row));
    let one = |row: usize| Splat {
        geometry: Geometry::Gaussian(Gaussian {
            mean: vector(Column::Mean, row),
            shape: if layout.isotropic {
                Shape::Isotropic {
                    log_scale: at(Column::LogScale, 0, row),
                }
            } else {
                Shape::Anisotropic {
                    log_scale: vector(Column::LogScale, row),
                    quat: Vector4::from_fn(|k, _| at(Column::Quat, k, row)),
                }
            },
            life: row.checked_sub(splats.n_static()).map(|row| Life {
                time_mean: at(Column::TimeMean, 0, row),
                log_time_sd: at(Column::LogTimeSd, 0, row),
                velocity: vector(Column::Velocity, row),
            }),
        }),
        opacity: at(Column::Opacity, 0, row),
        coefficients: (0..layout.colour_terms())
            .map(|term| std::array::from_fn(|c| at(Column::Colour, 3 * term + c, row)))
            .collect(),
        sh_terms: layout.sh_terms(),
    };
    (0..splats.n()).map(one).collect()
}
