//! The definition of compositing, forward and backward, generic over the [`Cutoff`].

use crate::ellipse::reference::{CHANNELS, Cutoff, Ellipse, reach};
use m4_core::{Real, nalgebra::Vector2};

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
        visit(Contribution {
            index,
            d,
            falloff,
            alpha,
            slope,
            transmittance,
        });
        transmittance = behind;
    }
    transmittance
}

fn dot<T: Real>(a: &[T; CHANNELS], b: &[T; CHANNELS]) -> T {
    (0..CHANNELS).fold(T::zero(), |sum, c| sum + a[c] * b[c])
}

/// The background as channels: depth and alpha have none.
fn behind_all<T: Real>(background: &[T; 3]) -> [T; CHANNELS] {
    [
        background[0],
        background[1],
        background[2],
        T::zero(),
        T::zero(),
    ]
}

/// The image of `splats`, which are in order of depth.
pub fn blend<T: Real, C: Cutoff>(
    splats: &[Ellipse<T>],
    width: usize,
    height: usize,
    background: &[T; 3],
) -> Image<T> {
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

/// Adds what one contribution passes on, given the gradients with respect to its `alpha`
/// (`d_alpha`) and to the pixel (`g`).
fn accumulate<T: Real>(
    out: &mut Ellipse<T>,
    splat: &Ellipse<T>,
    c: &Contribution<T>,
    d_alpha: T,
    g: &[T; CHANNELS],
) {
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
/// [`Image::pixels`], back to front. The twins go front to back from the final image and one scalar
/// per pixel (docs/spec/optimiser.md 1.7), which is the same gradient.
pub fn blend_vjp<T: Real, C: Cutoff>(
    splats: &[Ellipse<T>],
    width: usize,
    height: usize,
    background: &[T; 3],
    g: &[[T; CHANNELS]],
) -> BlendGradient<T> {
    let mut out = BlendGradient {
        splats: vec![Ellipse::zero(); splats.len()],
        background: [T::zero(); 3],
    };
    let background = behind_all(background);
    for (pixel, g) in g.iter().enumerate().take(width * height) {
        let mut contributions = Vec::new();
        let last = walk::<T, C>(splats, pixel % width, pixel / width, |c| {
            contributions.push(c)
        });
        add_background(&mut out.background, last, g);
        // colour behind the splat at hand, already weighted with its transmittance
        let mut suffix = background.map(|b| b * last);
        for c in contributions.iter().rev() {
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
