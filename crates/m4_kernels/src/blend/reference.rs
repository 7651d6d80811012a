//! The definition of compositing, forward and backward.
//!
//! Generic over the [`Cutoff`] too: the product keeps the [`Hard`] step at [`ALPHA_MIN`], which makes
//! the image discontinuous in its parameters, so that central differences disagree with the gradient
//! for a few entries however small the step. Tests of gradients therefore run with [`Smooth`].

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
        Self { centre: Vector2::zeros(), conic: Matrix2::zeros(), opacity: T::zero(), channels: [T::zero(); CHANNELS] }
    }
}

/// Composited channels, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<T: Real> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Per pixel: red, green, blue (background included), sum of weight times z-depth, alpha.
    pub pixels: Vec<[T; CHANNELS]>,
    /// Per pixel: light that passes every splat.
    pub transmittance: Vec<T>,
}

/// The gradient of a loss with respect to the input of [`blend()`].
#[derive(Debug, Clone, PartialEq)]
pub struct BlendGradient<T: Real> {
    /// One per splat, in the order given.
    pub splats: Vec<Ellipse<T>>,
    /// With respect to the background colour.
    pub background: [T; 3],
}

/// One splat composited on one pixel.
#[derive(Debug, Clone, Copy)]
pub struct Contribution<T: Real> {
    /// Which splat, in the order given.
    pub index: usize,
    /// From pixel to centre, pixels.
    pub d: Vector2<T>,
    /// `e^q`.
    pub falloff: T,
    /// What is blended.
    pub alpha: T,
    /// Derivative of `alpha` with respect to `opacity e^q`.
    pub slope: T,
    /// Transmittance in front of the splat.
    pub transmittance: T,
}

/// `(d, e^q, alpha, slope)` of one splat at one pixel, whatever lies in front; `None` where skipped.
pub fn reach<T: Real, C: Cutoff>(splat: &Ellipse<T>, x: usize, y: usize) -> Option<(Vector2<T>, T, T, T)> {
    let d = splat.centre - Vector2::new(T::of(x as f64), T::of(y as f64));
    let a = &splat.conic;
    let q = T::of(-0.5) * (a[(0, 0)] * d.x * d.x + a[(1, 1)] * d.y * d.y) - a[(0, 1)] * d.x * d.y;
    if q > T::zero() {
        return None;
    }
    let falloff = q.exp();
    C::alpha(splat.opacity * falloff).map(|(alpha, slope)| (d, falloff, alpha, slope))
}

/// Visits the splats that one pixel is composited from, near to far; returns the transmittance
/// behind the last one. `splats` are in order of depth.
pub fn walk<T: Real, C: Cutoff>(
    splats: &[Ellipse<T>],
    x: usize,
    y: usize,
    mut visit: impl FnMut(Contribution<T>),
) -> T {
    let mut transmittance = T::one();
    for (index, splat) in splats.iter().enumerate() {
        let Some((d, falloff, alpha, slope)) = reach::<T, C>(splat, x, y) else {
            continue;
        };
        let behind = transmittance * (T::one() - alpha);
        if behind < C::t_min() {
            break;
        }
        visit(Contribution { index, d, falloff, alpha, slope, transmittance });
        transmittance = behind;
    }
    transmittance
}

fn dot<T: Real>(a: &[T; CHANNELS], b: &[T; CHANNELS]) -> T {
    (0..CHANNELS).fold(T::zero(), |sum, c| sum + a[c] * b[c])
}

/// The background as channels: depth and alpha have none.
fn behind_all<T: Real>(background: &[T; 3]) -> [T; CHANNELS] {
    [background[0], background[1], background[2], T::zero(), T::zero()]
}

/// The image of `splats`, which are in order of depth.
pub fn blend<T: Real, C: Cutoff>(splats: &[Ellipse<T>], width: usize, height: usize, background: &[T; 3]) -> Image<T> {
    let mut image = Image {
        width,
        height,
        pixels: Vec::with_capacity(width * height),
        transmittance: Vec::with_capacity(width * height),
    };
    let background = behind_all(background);
    for (x, y) in (0..width * height).map(|i| (i % width, i / width)) {
        let mut out = [T::zero(); CHANNELS];
        let transmittance = walk::<T, C>(splats, x, y, |c| {
            for k in 0..CHANNELS {
                out[k] += c.transmittance * c.alpha * splats[c.index].channels[k];
            }
        });
        for k in 0..CHANNELS {
            out[k] += transmittance * background[k];
        }
        image.pixels.push(out);
        image.transmittance.push(transmittance);
    }
    image
}

/// Adds what one contribution passes on, given the gradients with respect to its `alpha` (`d_alpha`)
/// and to the pixel (`g`).
fn accumulate<T: Real>(out: &mut Ellipse<T>, splat: &Ellipse<T>, c: &Contribution<T>, d_alpha: T, g: &[T; CHANNELS]) {
    for k in 0..CHANNELS {
        out.channels[k] += g[k] * c.transmittance * c.alpha;
    }
    let d_raw = d_alpha * c.slope;
    out.opacity += d_raw * c.falloff;
    let d_q = d_raw * splat.opacity * c.falloff;
    out.centre -= splat.conic * c.d * d_q;
    out.conic -= c.d * c.d.transpose() * (T::of(0.5) * d_q);
}

fn add_background<T: Real>(out: &mut [T; 3], transmittance: T, g: &[T; CHANNELS]) {
    for k in 0..3 {
        out[k] += g[k] * transmittance;
    }
}

/// Gradient with respect to splats and background, given `g`, `[height * width]`, with respect to
/// [`Image::pixels`], back to front. The twins go front to back from the final image and one scalar per pixel
/// (docs/spec/optimiser.md 1.7), which is the same gradient.
pub fn blend_vjp<T: Real, C: Cutoff>(
    splats: &[Ellipse<T>],
    width: usize,
    height: usize,
    background: &[T; 3],
    g: &[[T; CHANNELS]],
) -> BlendGradient<T> {
    let mut out = BlendGradient { splats: vec![Ellipse::zero(); splats.len()], background: [T::zero(); 3] };
    let background = behind_all(background);
    for (pixel, g) in g.iter().enumerate().take(width * height) {
        let mut seen = Vec::new();
        let last = walk::<T, C>(splats, pixel % width, pixel / width, |c| seen.push(c));
        add_background(&mut out.background, last, g);
        // colour behind the splat at hand, already weighted with its transmittance
        let mut suffix = background.map(|b| b * last);
        for c in seen.iter().rev() {
            let splat = &splats[c.index];
            let direct = c.transmittance * dot(&splat.channels, g);
            let d_alpha = direct - dot(&suffix, g) / (T::one() - c.alpha);
            accumulate(&mut out.splats[c.index], splat, c, d_alpha, g);
            for k in 0..CHANNELS {
                suffix[k] += c.transmittance * c.alpha * splat.channels[k];
            }
        }
    }
    out
}
