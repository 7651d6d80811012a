//! The whole chain of kernels in one precision: splats and a camera to an image, and back.
//!
//! Strings the reference kernels together without tiles, threads or SIMD: each pixel looks at every
//! splat. This is what the twins are checked against; nothing outside tests calls it.

use crate::{
    blend::reference::{BlendGradient, Image, blend, blend_vjp, walk},
    ellipse::{
        ALPHA_MIN,
        reference::{CHANNELS, Cutoff, Ellipse},
    },
    project::reference::{PinholeGradient, Projected, project, project_vjp},
    score::reference::score,
    shade::reference::{Sight, shade, shade_vjp},
    slice::{
        MARGINAL_MIN,
        reference::{Sliced, slice, slice_rotor, slice_rotor_vjp, slice_vjp},
    },
    tile_binning::reference::depth_order,
};
use m4_core::{Real, nalgebra::Vector2};
pub use types::{Geometry, SceneGradient, Setup, Splat, splats_of};

mod types;

/// What was computed for one splat that is in the frame.
#[derive(Debug, Clone)]
struct Drawn<T: Real> {
    row: usize,
    sliced: Sliced<T>,
    projected: Projected<T>,
    sight: Sight<T>,
}

/// A frame and what its gradient needs.
#[derive(Debug, Clone)]
pub struct Rendered<T: Real> {
    /// The composited channels.
    pub image: Image<T>,
    /// The splats in the frame, near to far.
    pub ellipses: Vec<Ellipse<T>>,
    /// The rows of [`Self::ellipses`] among the splats given.
    pub rows: Vec<usize>,
    drawn: Vec<Drawn<T>>,
}

fn sigmoid<T: Real>(x: T) -> T {
    T::one() / (T::one() + (-x).exp())
}

/// One splat in the frame, or `None` where the contracts leave it out.
fn draw<T: Real>(row: usize, splat: &Splat<T>, setup: &Setup<T>) -> Option<(Drawn<T>, Ellipse<T>)> {
    let (sliced, dt) = match &splat.geometry {
        Geometry::Gaussian(g) => (
            slice(g, setup.t),
            g.life.map_or(T::zero(), |life| setup.t - life.time_mean),
        ),
        Geometry::Rotor(g) => (slice_rotor(g, setup.t), setup.t - g.time_mean),
    };
    if sliced.marginal <= T::of(MARGINAL_MIN) {
        return None;
    }
    let projected = project(
        &sliced.mean,
        &sliced.covariance,
        &setup.camera,
        setup.near,
        setup.mip,
    )?;
    let opacity = sigmoid(splat.opacity) * sliced.marginal * projected.compensation;
    let (centre, conic) = (&projected.centre, &projected.conic);
    let mut numbers = centre
        .iter()
        .chain(conic.iter())
        .chain([&projected.depth, &opacity]);
    if numbers.any(|v| !v.is_finite()) || opacity < T::of(ALPHA_MIN) {
        return None;
    }
    let sight = Sight {
        offset: sliced.mean - setup.camera.centre(),
        dt,
        period: setup.period,
        sh_terms: splat.sh_terms,
    };
    let [r, g, b] = shade(&splat.coefficients, &sight);
    let ellipse = Ellipse {
        centre: projected.centre,
        conic: projected.conic,
        opacity,
        channels: [r, g, b, projected.depth, T::one()],
    };
    let drawn = Drawn {
        row,
        sliced,
        projected,
        sight,
    };
    Some((drawn, ellipse))
}

/// The splats in the frame, near to far.
fn draw_all<T: Real>(splats: &[Splat<T>], setup: &Setup<T>) -> (Vec<Drawn<T>>, Vec<Ellipse<T>>) {
    let all: Vec<_> = splats
        .iter()
        .enumerate()
        .filter_map(|(row, splat)| draw(row, splat, setup))
        .collect();
    let depths: Vec<T> = all.iter().map(|(drawn, _)| drawn.projected.depth).collect();
    depth_order(&depths)
        .into_iter()
        .map(|i| all[i].clone())
        .unzip()
}

/// The ellipses of the splats in the frame, near to far.
pub(crate) fn ellipses<T: Real>(splats: &[Splat<T>], setup: &Setup<T>) -> Vec<Ellipse<T>> {
    draw_all(splats, setup).1
}

/// The image of `splats`.
pub fn render<T: Real, C: Cutoff>(splats: &[Splat<T>], setup: &Setup<T>) -> Rendered<T> {
    let (drawn, ellipses) = draw_all(splats, setup);
    let image = blend::<T, C>(&ellipses, setup.width, setup.height, &setup.background);
    Rendered {
        image,
        rows: drawn.iter().map(|d| d.row).collect(),
        ellipses,
        drawn,
    }
}

/// Gradient of a loss with respect to splats, camera and background, given `g`, `[height * width]`,
/// with respect to the pixels of `rendered`, which is [`render`] of the same splats and setup.
pub fn backward<T: Real, C: Cutoff>(
    splats: &[Splat<T>],
    setup: &Setup<T>,
    rendered: &Rendered<T>,
    g: &[[T; CHANNELS]],
) -> SceneGradient<T> {
    let BlendGradient {
        splats: ellipses,
        background,
    } = blend_vjp::<T, C>(
        &rendered.ellipses,
        setup.width,
        setup.height,
        &setup.background,
        g,
    );
    let mut out = SceneGradient {
        splats: splats.iter().map(Splat::zero_like).collect(),
        touched: touched::<T, C>(splats.len(), rendered),
        means2d: vec![Vector2::zeros(); splats.len()],
        camera: PinholeGradient::zero(),
        background,
    };
    for (drawn, d) in rendered.drawn.iter().zip(&ellipses) {
        let splat = &splats[drawn.row];
        let grad = &mut out.splats[drawn.row];
        let [r, green, b, depth, _] = d.channels;
        let shade = shade_vjp(&splat.coefficients, &drawn.sight, &[r, green, b]);

        let (peak, p, rho) = (
            sigmoid(splat.opacity),
            drawn.sliced.marginal,
            drawn.projected.compensation,
        );
        let d_projected = Projected {
            centre: d.centre,
            conic: d.conic,
            depth,
            compensation: d.opacity * peak * p,
        };
        let (mean, covariance) = (&drawn.sliced.mean, &drawn.sliced.covariance);
        let d_project = project_vjp(mean, covariance, &setup.camera, setup.mip, &d_projected);
        let d_sliced = Sliced {
            mean: d_project.mean + shade.offset,
            covariance: d_project.covariance,
            marginal: d.opacity * peak * rho,
        };

        grad.geometry = geometry_vjp(&splat.geometry, setup.t, &d_sliced, shade.time_mean);
        grad.opacity = d.opacity * p * rho * peak * (T::one() - peak);
        grad.coefficients = shade.coefficients;
        out.means2d[drawn.row] = d.centre;
        out.camera.add(&d_project.camera);
        // the camera's centre moves by -W^T tau, so the offset by +W^T tau; a turn leaves it in
        // place
        out.camera.tau += setup.camera.w2c.rotation * shade.offset;
    }
    out
}

/// Through the slice; `d_time` is what the colour adds to the gradient of `time_mean`.
fn geometry_vjp<T: Real>(geometry: &Geometry<T>, t: T, g: &Sliced<T>, d_time: T) -> Geometry<T> {
    match geometry {
        Geometry::Gaussian(splat) => {
            let mut d = slice_vjp(splat, t, g);
            if let Some(life) = &mut d.life {
                life.time_mean += d_time;
            }
            Geometry::Gaussian(d)
        }
        Geometry::Rotor(splat) => {
            let mut d = slice_rotor_vjp(splat, t, g);
            d.time_mean += d_time;
            Geometry::Rotor(d)
        }
    }
}

/// Which of `n` splats are composited on at least one pixel.
fn touched<T: Real, C: Cutoff>(n: usize, rendered: &Rendered<T>) -> Vec<bool> {
    let mut out = vec![false; n];
    let (width, height) = (rendered.image.width, rendered.image.height);
    for (x, y) in (0..width * height).map(|i| (i % width, i / width)) {
        walk::<T, C>(&rendered.ellipses, x, y, |c| {
            out[rendered.rows[c.index]] = true
        });
    }
    out
}

/// The score of each of `n` splats in a frame (docs/spec/optimiser.md 4); `weight` is
/// `[height][width]`.
pub fn score_splats<T: Real>(n: usize, rendered: &Rendered<T>, weight: &[T]) -> Vec<T> {
    let marginals: Vec<T> = rendered.drawn.iter().map(|d| d.sliced.marginal).collect();
    let scores = score(&rendered.ellipses, &marginals, rendered.image.width, weight);
    let mut out = vec![T::zero(); n];
    for (&row, score) in rendered.rows.iter().zip(scores) {
        out[row] = score;
    }
    out
}

/// `c' = M c + b` for the colours of every pixel, `[M | b]` row by row
/// (docs/spec/optimiser.md 8.4).
pub fn expose<T: Real>(pixels: &[[T; CHANNELS]], exposure: &[[T; 4]; 3]) -> Vec<[T; 3]> {
    pixels
        .iter()
        .map(|p| exposure.map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]))
        .collect()
}

/// Gradients with respect to the colours of every pixel and the exposure, given `g` with respect to
/// [`expose`].
pub fn expose_vjp<T: Real>(
    pixels: &[[T; CHANNELS]],
    exposure: &[[T; 4]; 3],
    g: &[[T; 3]],
) -> (Vec<[T; 3]>, [[T; 4]; 3]) {
    let mut d_exposure = [[T::zero(); 4]; 3];
    let d_pixels = pixels.iter().zip(g).map(|(p, g)| {
        for (row, &g) in d_exposure.iter_mut().zip(g) {
            for k in 0..3 {
                row[k] += g * p[k];
            }
            row[3] += g;
        }
        std::array::from_fn(|k| {
            exposure[0][k] * g[0] + exposure[1][k] * g[1] + exposure[2][k] * g[2]
        })
    });
    (d_pixels.collect(), d_exposure)
}
