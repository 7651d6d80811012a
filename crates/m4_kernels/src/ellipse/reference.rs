//! The definition of a splat's alpha at a pixel.
//!
//! Generic over the [`Cutoff`] too: the product keeps the [`Hard`] step at [`ALPHA_MIN`], which
//! makes the image discontinuous in its parameters, so that central differences disagree with the
//! gradient for a few entries however small the step. Tests of gradients therefore run with
//! [`Smooth`].

use super::{ALPHA_MAX, ALPHA_MIN, T_MIN};
use m4_core::{
    Real,
    nalgebra::{Matrix2, Vector2},
};

/// Red, green, blue, z-depth and 1.
pub const CHANNELS: usize = 5;

/// How `alpha` starts, ends, and ends a pixel.
pub trait Cutoff {
    /// `alpha` of `opacity e^q` and its derivative; `None` where the splat is skipped.
    fn alpha<T: Real>(raw: T) -> Option<(T, T)>;
    /// The pixel stops before its transmittance would fall under this.
    fn t_min<T: Real>() -> T;
}

/// What the product does: steps at [`ALPHA_MIN`], [`ALPHA_MAX`] and [`T_MIN`].
#[derive(Debug, Clone, Copy)]
pub struct Hard;

impl Cutoff for Hard {
    fn alpha<T: Real>(raw: T) -> Option<(T, T)> {
        if raw >= T::of(ALPHA_MAX) {
            return Some((T::of(ALPHA_MAX), T::zero()));
        }
        (raw >= T::of(ALPHA_MIN)).then(|| (raw, T::one()))
    }

    fn t_min<T: Real>() -> T {
        T::of(T_MIN)
    }
}

/// Once continuously differentiable, for finite differences: rises from 0 at [`ALPHA_MIN`] to `raw`
/// at three times that, bends to [`ALPHA_MAX`] above 0.95, never ends a pixel.
#[derive(Debug, Clone, Copy)]
pub struct Smooth;

impl Cutoff for Smooth {
    fn alpha<T: Real>(raw: T) -> Option<(T, T)> {
        let low = T::of(ALPHA_MIN);
        if raw <= low {
            return None;
        }
        let width = T::of(2.0 * ALPHA_MIN);
        let (two, three, six) = (T::of(2.0), T::of(3.0), T::of(6.0));
        let x = (raw - low) / width;
        if x < T::one() {
            let step = x * x * (three - two * x);
            let slope = six * x * (T::one() - x) / width;
            return Some((raw * step, step + raw * slope));
        }
        // from slope 1 to slope 0 over a width that ends at ALPHA_MAX
        let bend = T::of(0.95);
        let width = two * (T::of(ALPHA_MAX) - bend);
        let s = raw - bend;
        Some(if s <= T::zero() {
            (raw, T::one())
        } else if s < width {
            (raw - s * s / (two * width), T::one() - s / width)
        } else {
            (T::of(ALPHA_MAX), T::zero())
        })
    }

    fn t_min<T: Real>() -> T {
        T::zero()
    }
}

/// A splat on the image; also the gradient with respect to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse<T: Real> {
    /// Pixels; the centre of the first pixel is at (0, 0).
    pub centre: Vector2<T>,
    /// Symmetric, 1 / pixels squared.
    pub conic: Matrix2<T>,
    /// With marginal and compensation, 0..1.
    pub opacity: T,
    /// Red, green, blue, z-depth, 1.
    pub channels: [T; CHANNELS],
}

impl<T: Real> Ellipse<T> {
    /// All 0: where a gradient starts.
    pub fn zero() -> Self {
        Self {
            centre: Vector2::zeros(),
            conic: Matrix2::zeros(),
            opacity: T::zero(),
            channels: [T::zero(); CHANNELS],
        }
    }
}

/// `(d, e^q, alpha, slope)` of one splat at one pixel, whatever lies in front; `None` where
/// skipped.
pub fn reach<T: Real, C: Cutoff>(
    splat: &Ellipse<T>,
    x: usize,
    y: usize,
) -> Option<(Vector2<T>, T, T, T)> {
    let d = splat.centre - Vector2::new(T::of(x as f64), T::of(y as f64));
    let a = &splat.conic;
    let q = T::of(-0.5) * (a[(0, 0)] * d.x * d.x + a[(1, 1)] * d.y * d.y) - a[(0, 1)] * d.x * d.y;
    if q > T::zero() {
        return None;
    }
    let falloff = q.exp();
    C::alpha(splat.opacity * falloff).map(|(alpha, slope)| (d, falloff, alpha, slope))
}
