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
}

impl FlowPair {
    /// By [`InverseSearch`].
    pub fn between(a: &ScaledFrame, b: &ScaledFrame) -> Self {
        let (forward, backward) = InverseSearch.both(a, b);
        Self { forward, backward }
    }

    /// The flow of frame `i` to the next frame or, not `later`, to the one before; `None` past the
    /// ends.
    pub fn step(flows: &[Self], i: usize, later: bool) -> Option<Way<'_>> {
        if later {
            flows.get(i).map(Self::there)
        } else {
            flows.get(i.checked_sub(1)?).map(Self::back)
        }
    }

    /// The same on images of another size, columns and rows.
    pub fn resized(self, (width, height): (usize, usize)) -> Self {
        if (self.forward.width, self.forward.height) == (width, height) {
            return self;
        }
        Self {
            forward: self.forward.resized(width, height),
            backward: self.backward.resized(width, height),
        }
    }

    /// From the first frame to the second.
    pub fn there(&self) -> Way<'_> {
        Way {
            flow: &self.forward,
            back: &self.backward,
        }
    }

    /// From the second frame to the first.
    pub fn back(&self) -> Way<'_> {
        Way {
            flow: &self.backward,
            back: &self.forward,
        }
    }
}

/// Flow of a frame to another, and back from there.
#[derive(Clone, Copy)]
pub(crate) struct Way<'a> {
    pub flow: &'a Flow,
    back: &'a Flow,
}

impl Way<'_> {
    /// How far pixel `i` lands from where it started after going there and back, pixels; infinite
    /// where it leaves the image.
    pub fn round_trip_px(&self, i: usize) -> f32 {
        let Flow { width, height, .. } = *self.flow;
        let (u, v) = (self.flow.u[i], self.flow.v[i]);
        // 32 bits are divided several times faster than 64.
        let (column, row) = (i as u32 % width as u32, i as u32 / width as u32);
        let (x, y) = (column as f32 + u, row as f32 + v);
        let inside =
            (0.0..=(width - 1) as f32).contains(&x) && (0.0..=(height - 1) as f32).contains(&y);
        if !inside {
            return f32::INFINITY;
        }
        let (back_u, back_v) = self.back.at(x, y);
        let (x, y) = (u + back_u, v + back_v);
        (x * x + y * y).sqrt()
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
    use super::{Flow, FlowPair, flow, pyramid};

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
        let pair = FlowPair {
            forward: flow(&a, &b),
            backward: flow(&b, &a),
        };
        let forward = &pair.forward;
        let (mut sum, mut trips, mut count) = (0.0, 0.0, 0.0);
        for y in 12..H - 12 {
            for x in 12..W - 12 {
                let (u, v) = motion(x as f32, y as f32);
                sum += (forward.u[y * W + x] - u).hypot(forward.v[y * W + x] - v);
                trips += pair.there().round_trip_px(y * W + x);
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
    fn a_round_trip_misses_by_what_both_ways_differ_and_is_infinite_outside() {
        let even = |u: f32, v: f32| Flow {
            width: 4,
            height: 3,
            u: vec![u; 12],
            v: vec![v; 12],
        };
        let pair = FlowPair {
            forward: even(2.0, 0.0),
            backward: even(1.0, -4.0),
        };
        assert_eq!(pair.there().round_trip_px(1), 5.0);
        assert_eq!(pair.there().round_trip_px(2), f32::INFINITY);
        assert_eq!(pair.back().round_trip_px(0), f32::INFINITY);
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
