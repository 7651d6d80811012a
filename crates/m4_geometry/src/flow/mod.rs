//! Dense optical flow: inverse search on patches, refined by a variational energy, coarse to fine.

mod search;
mod variational;

use crate::resample::rgb_and_grey;
use m4_core::{Flow, RgbImage, bilinear_cell, dispatch};
use search::{Level, pyramid};

/// Bilinear colour at `(x, y)`, clamped to the image.
pub(crate) fn bilinear_rgb(
    width: usize,
    height: usize,
    plane: &[[u8; 3]],
    x: f32,
    y: f32,
) -> [f32; 3] {
    let (i, wx, wy) = bilinear_cell(width, height, x, y);
    std::array::from_fn(|c| {
        let at = |k: usize| f32::from(plane[k][c]);
        let top = at(i) * (1.0 - wx) + at(i + 1) * wx;
        let bottom = at(i + width) * (1.0 - wx) + at(i + width + 1) * wx;
        top * (1.0 - wy) + bottom * wy
    })
}

/// Flow between a frame and the next, both ways.
pub(crate) struct FlowPair {
    pub forward: Flow,
    pub backward: Flow,
    /// `[height][width]`: see [`round_trip_px`].
    pub forward_round_trip: Vec<f32>,
    pub backward_round_trip: Vec<f32>,
}

impl FlowPair {
    /// The flow of frame `i` to the next frame or, not `later`, to the one before, and its round
    /// trip; `None` past the ends.
    pub fn step(flows: &[Self], i: usize, later: bool) -> Option<(&Flow, &[f32])> {
        if later {
            flows
                .get(i)
                .map(|pair| (&pair.forward, pair.forward_round_trip.as_slice()))
        } else {
            flows
                .get(i.checked_sub(1)?)
                .map(|pair| (&pair.backward, pair.backward_round_trip.as_slice()))
        }
    }

    /// Exact flow, both ways.
    #[cfg(test)]
    pub fn exact(forward: Flow, backward: Flow) -> Self {
        let [forward_round_trip, backward_round_trip] =
            [&forward, &backward].map(|flow| vec![0.0; flow.u.len()]);
        Self {
            forward,
            backward,
            forward_round_trip,
            backward_round_trip,
        }
    }

    /// Of flow both ways, of one size.
    pub fn of(forward: Flow, backward: Flow) -> Self {
        Self {
            forward_round_trip: round_trip_px(&forward, &backward),
            backward_round_trip: round_trip_px(&backward, &forward),
            forward,
            backward,
        }
    }

    /// By [`InverseSearch`].
    pub fn between(a: &ScaledFrame, b: &ScaledFrame) -> Self {
        let (forward, backward) = InverseSearch.both(a, b);
        Self::of(forward, backward)
    }
}

fn flow(a: &[Level], b: &[Level]) -> Flow {
    // compiled for each set of vector instructions; the arithmetic is the same on all
    dispatch!(fearless_simd::Level::new(), _s => coarse_to_fine(a, b))
}

#[inline(always)]
fn coarse_to_fine(a: &[Level], b: &[Level]) -> Flow {
    let mut flow: Option<Flow> = None;
    for (a, b) in a.iter().zip(b).rev() {
        let start = match &flow {
            Some(coarse) => coarse.resized(a.width, a.height),
            None => Flow::zero(a.width, a.height),
        };
        let mut fine = search::search(a, b, start);
        variational::refine(a, b, &mut fine);
        flow = Some(fine);
    }
    flow.unwrap_or_default()
}

/// How far a pixel lands from where it started after going there and back, pixels; infinite
/// outside.
pub(crate) fn round_trip_px(forward: &Flow, backward: &Flow) -> Vec<f32> {
    let (w, h) = (forward.width, forward.height);
    let mut out = vec![0.0; w * h];
    for y in 0..h {
        for x in 0..w {
            let i = y * w + x;
            let (qx, qy) = (x as f32 + forward.u[i], y as f32 + forward.v[i]);
            let inside = qx >= 0.0 && qy >= 0.0 && qx <= (w - 1) as f32 && qy <= (h - 1) as f32;
            out[i] = if inside {
                let (u, v) = backward.at(qx, qy);
                let (x, y) = (forward.u[i] + u, forward.v[i] + v);
                (x * x + y * y).sqrt()
            } else {
                f32::INFINITY
            };
        }
    }
    out
}

/// An image at another size, not larger than its own, as flow is measured on it.
#[derive(Debug, Clone)]
pub struct ScaledFrame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height][width][3]`, sRGB 0..255.
    pub rgb: Vec<[u8; 3]>,
    /// `[height][width]`: luma 0..255, not rounded.
    pub grey: Vec<f32>,
}

impl ScaledFrame {
    /// The image at `width` x `height` pixels, by areas.
    pub fn new(image: &RgbImage, (width, height): (usize, usize)) -> Self {
        let (rgb, grey) = rgb_and_grey(image, width, height);
        Self {
            width,
            height,
            rgb,
            grey,
        }
    }
}

/// Inverse search with variational refinement (Kroeger et al. 2016): no weights, and the default.
#[derive(Debug, Clone, Copy)]
pub struct InverseSearch;

impl InverseSearch {
    /// The flow from `a` to `b` and that from `b` to `a`; both images are of one size.
    pub fn both(self, a: &ScaledFrame, b: &ScaledFrame) -> (Flow, Flow) {
        let [a, b] = [a, b].map(|p| pyramid(p.width, p.height, &p.grey));
        (flow(&a, &b), flow(&b, &a))
    }
}

#[cfg(test)]
mod tests {
    use super::{flow, pyramid, round_trip_px};

    const W: usize = 96;
    const H: usize = 72;

    /// Waves of every length from 100 px down to 9 px, the longer the stronger, as images have.
    fn texture(x: f32, y: f32) -> f32 {
        let wave = |k: u32| {
            let (length, turn) = (100.0 * 0.8f32.powi(k as i32), 2.4 * k as f32);
            let phase = (x * turn.cos() + y * turn.sin()) * std::f32::consts::TAU / length;
            length.sqrt() * (phase + 1.7 * k as f32).sin()
        };
        128.0 + 3.0 * (0..12).map(wave).sum::<f32>()
    }

    /// `b` shows at `p + motion(p)` what `a` shows at `p`; `inverse` undoes `p + motion(p)`.
    fn error_px(
        motion: impl Fn(f32, f32) -> (f32, f32),
        inverse: impl Fn(f32, f32) -> (f32, f32),
        gain: f32,
    ) -> (f32, f32) {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        for i in 0..W * H {
            let (x, y) = ((i % W) as f32, (i / W) as f32);
            let (bx, by) = inverse(x, y);
            a.push(texture(x, y));
            b.push(gain * texture(bx, by));
        }
        let (a, b) = (pyramid(W, H, &a), pyramid(W, H, &b));
        let (forward, backward) = (flow(&a, &b), flow(&b, &a));
        let trip = round_trip_px(&forward, &backward);
        let (mut sum, mut trips, mut count) = (0.0, 0.0, 0.0);
        for y in 12..H - 12 {
            for x in 12..W - 12 {
                let (u, v) = motion(x as f32, y as f32);
                sum += (forward.u[y * W + x] - u).hypot(forward.v[y * W + x] - v);
                trips += trip[y * W + x];
                count += 1.0;
            }
        }
        (sum / count, trips / count)
    }

    #[test]
    fn shifts_and_zooms_are_found() {
        let (cx, cy, s) = (48.0, 36.0, 1.06);
        let shift =
            |u: f32, v: f32, gain: f32| error_px(|_, _| (u, v), |x, y| (x - u, y - v), gain);
        let zoom = |x: f32, y: f32| ((s - 1.0) * (x - cx), (s - 1.0) * (y - cy));
        let zoomed = error_px(zoom, |x, y| (cx + (x - cx) / s, cy + (y - cy) / s), 1.0);
        for (what, (error, trip), most, most_trip) in [
            ("a shift", shift(3.4, -2.3, 1.0), 0.1, 0.1),
            (
                "a large shift with another exposure",
                shift(-9.6, 4.2, 1.05),
                0.25,
                f32::INFINITY,
            ),
            ("a zoom", zoomed, 0.1, f32::INFINITY),
        ] {
            assert!(error < most && trip < most_trip, "{what}: {error} {trip}");
        }
    }

    #[test]
    fn images_smaller_than_a_patch_have_flow() {
        let (w, h) = (6, 5);
        let image = |shift: f32| -> Vec<f32> {
            (0..w * h)
                .map(|i| texture((i % w) as f32 - shift, (i / w) as f32))
                .collect()
        };
        let actual = flow(&pyramid(w, h, &image(0.0)), &pyramid(w, h, &image(0.3)));
        assert_eq!((actual.width, actual.height), (w, h));
        assert!(actual.u.iter().chain(&actual.v).all(|v| v.is_finite()));
    }

    #[test]
    fn flow_of_flat_images_is_zero() {
        let flat = pyramid(W, H, &vec![77.0; W * H]);
        let actual = flow(&flat, &flat);
        assert!(actual.u.iter().chain(&actual.v).all(|v| v.abs() < 1e-3));
    }
}
