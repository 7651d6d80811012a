//! Tracks patches from one image to another.

use m4_core::{Camera, CaptureFrame, DepthMap, Plane};

/// Half the side of a patch, pixels.
const RADIUS: i32 = 3;
/// Values that a patch must have at least: a third of the pixels, in three colours.
const LEAST: usize = 49;
/// Noise of a smoothed image, 0..1: less contrast than this is nothing to track.
const NOISE: f64 = 0.01;
/// A mean difference of this size between a patch and its match halves the trust in it.
const UNLIKE: f64 = 0.05;
/// A patch that wants to go further than this was lost, pixels.
const FARTHEST_PX: f64 = 4.0;
/// Newton steps of a patch.
const STEPS: usize = 4;
/// A match that is this share of its depth off the expected depth is none.
const DEPTH_JUMP: f64 = 0.05;

/// Smoothed image, depth and mask of one frame, all of the size of the image.
#[derive(Debug, Clone)]
pub(crate) struct PatchImage {
    camera: Camera,
    /// Red, green, blue, 0..1.
    rgb: [Plane<f32>; 3],
    depth: DepthMap,
    moves: Plane<bool>,
}

/// One value of a patch: where it is from the middle, in which colour, and how it changes from pixel to pixel.
struct Texel {
    colour: usize,
    d: [f64; 2],
    value: f64,
    slope: [f64; 2],
}

impl PatchImage {
    /// `None` without depth or mask: then nothing moves there.
    pub fn new(frame: &CaptureFrame) -> Option<Self> {
        let (depth, mask) = (frame.depth.as_ref()?, frame.mask.as_ref()?);
        let (w, h) = frame.rgb.size();
        let at =
            |x: usize, y: usize, (sw, sh): (usize, usize)| ((2 * x + 1) * sw / (2 * w), (2 * y + 1) * sh / (2 * h));
        let channel = |c: usize| smooth(&frame.rgb.map(|p| f32::from(p[c]) / 255.0));
        let ((r, g), b) = rayon::join(|| rayon::join(|| channel(0), || channel(1)), || channel(2));
        Some(Self {
            camera: frame.camera,
            rgb: [r, g, b],
            depth: Plane::from_fn(w, h, |x, y| {
                let (x, y) = at(x, y, depth.size());
                depth.at(x, y)
            }),
            moves: Plane::from_fn(w, h, |x, y| {
                let (x, y) = at(x, y, mask.size());
                mask.at(x, y)
            }),
        })
    }

    /// Whether a whole patch around the place, and its slopes, are in the image.
    fn holds(&self, [u, v]: [f64; 2]) -> bool {
        let (w, h) = self.depth.size();
        let r = f64::from(RADIUS) + 1.0;
        u >= r && v >= r && u + r + 1.0 < w as f64 && v + r + 1.0 < h as f64
    }

    /// Bilinear; the image holds the place.
    fn sample(&self, colour: usize, u: f64, v: f64) -> f64 {
        let (a, b) = (u.fract(), v.fract());
        let (x, y) = (u as usize, v as usize);
        let p = |x, y| f64::from(self.rgb[colour][(x, y)]);
        (1.0 - b) * ((1.0 - a) * p(x, y) + a * p(x + 1, y)) + b * ((1.0 - a) * p(x, y + 1) + a * p(x + 1, y + 1))
    }

    /// The moving pixels around a place that the image holds.
    fn patch(&self, [u, v]: [f64; 2]) -> Vec<Texel> {
        let mut out = Vec::new();
        for dy in -RADIUS..=RADIUS {
            for dx in -RADIUS..=RADIUS {
                let d = [f64::from(dx), f64::from(dy)];
                let (x, y) = (u + d[0], v + d[1]);
                if !self.moves[(x.round() as usize, y.round() as usize)] {
                    continue;
                }
                out.extend((0..3).map(|colour| Texel {
                    colour,
                    d,
                    value: self.sample(colour, x, y),
                    slope: [
                        0.5 * (self.sample(colour, x + 1.0, y) - self.sample(colour, x - 1.0, y)),
                        0.5 * (self.sample(colour, x, y + 1.0) - self.sample(colour, x, y - 1.0)),
                    ],
                }));
            }
        }
        out
    }

    /// Where `p`, a point that this frame sees, is in the frame `to`, which is expected to see it at `guess`; and
    /// how much that can be trusted, 0..1. World units. `None` where it is not seen or has nothing to track.
    ///
    /// The patch around `p` is tracked by the method of Lucas and Kanade (1981) in its inverse form, moving pixels
    /// alone, all three colours; the depth map of `to` says how far away it is.
    pub fn track(&self, to: &Self, p: [f32; 3], guess: [f32; 3]) -> Option<([f32; 3], f32)> {
        let (centre, z) = self.camera.project(&p.map(f64::from).into());
        let (start, expected) = to.camera.project(&guess.map(f64::from).into());
        if z <= 0.0 || expected <= 0.0 || !self.holds(centre) || !to.holds(start) {
            return None;
        }
        let patch = self.patch(centre);
        if patch.len() < LEAST {
            return None;
        }
        let n = patch.len() as f64;
        let sum = |f: &dyn Fn(&Texel) -> f64| patch.iter().map(f).sum::<f64>();
        let [xx, xy, yy] =
            [sum(&|t| t.slope[0] * t.slope[0]), sum(&|t| t.slope[0] * t.slope[1]), sum(&|t| t.slope[1] * t.slope[1])];
        let damping = n * NOISE * NOISE;
        let (a, d) = (xx + damping, yy + damping);
        let determinant = a * d - xy * xy;
        let (mut at, mut rest) = (start, 0.0);
        for _ in 0..STEPS {
            let (mut b, mut squares) = ([0.0; 2], 0.0);
            for t in &patch {
                let e = t.value - to.sample(t.colour, at[0] + t.d[0], at[1] + t.d[1]);
                b = [b[0] + t.slope[0] * e, b[1] + t.slope[1] * e];
                squares += e * e;
            }
            rest = squares / n;
            at[0] += (d * b[0] - xy * b[1]) / determinant;
            at[1] += (a * b[1] - xy * b[0]) / determinant;
            if (at[0] - start[0]).hypot(at[1] - start[1]) > FARTHEST_PX || !to.holds(at) {
                return None;
            }
        }
        let pixel = (at[0].round() as usize, at[1].round() as usize);
        let depth = f64::from(to.depth[pixel]);
        if !to.moves[pixel] || (depth - expected).abs() > DEPTH_JUMP * expected {
            return None;
        }
        // contrast across the weakest direction: the smaller eigenvalue
        let least = 0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        let trust = least.max(0.0) / (least.max(0.0) + damping) / (1.0 + rest / (UNLIKE * UNLIKE));
        let q = to.camera.unproject(at[0], at[1], depth);
        Some(([q.x as f32, q.y as f32, q.z as f32], trust as f32))
    }
}

/// `[1 4 6 4 1] / 16` along both axes; edges repeat.
fn smooth(plane: &Plane<f32>) -> Plane<f32> {
    const TAPS: [f32; 5] = [1.0 / 16.0, 0.25, 0.375, 0.25, 1.0 / 16.0];
    let (w, h) = plane.size();
    let near = |x: usize, k: usize, n: usize| (x + k).saturating_sub(2).min(n - 1);
    let sum = |f: &dyn Fn(usize) -> f32| (0..5).map(|k| TAPS[k] * f(k)).sum::<f32>();
    let rows = Plane::from_fn(w, h, |x, y| sum(&|k| plane[(near(x, k, w), y)]));
    Plane::from_fn(w, h, |x, y| sum(&|k| rows[(x, near(y, k, h))]))
}

#[cfg(test)]
mod tests {
    use super::PatchImage;
    use m4_core::{Camera, CaptureFrame, CompactMask, Intrinsics, Plane, Se3};

    /// A textured wall at depth 2 that moves by `shift` pixels; the left third is static.
    fn frame(shift: [f64; 2], flat: bool) -> CaptureFrame {
        let texture = |x: f64, y: f64| match flat {
            true => 0.5,
            false => 0.5 + 0.2 * (0.6 * x).sin() + 0.2 * (0.5 * y + 0.2 * x).cos(),
        };
        CaptureFrame {
            name: String::new(),
            camera: Camera { intrinsics: Intrinsics::centred(60, 40, 50.0), c2w: Se3::identity() },
            t: 0.0,
            rgb: Plane::from_fn(60, 40, |x, y| {
                let v = texture(x as f64 - shift[0], y as f64 - shift[1]);
                [v, 0.8 * v, 1.0 - v].map(|v| (255.0 * v).round() as u8)
            }),
            depth: Some(Plane::filled(60, 40, 2.0).into()),
            mask: Some(CompactMask::from_fn(60, 40, |x, _| x >= 20)),
            motion: None,
            instances: None,
            camera_index: None,
        }
    }

    #[test]
    fn a_patch_is_tracked_to_a_tenth_of_a_pixel() {
        let (a, b) = (frame([0.0; 2], false), frame([1.3, -0.7], false));
        let (from, to) = (PatchImage::new(&a).unwrap(), PatchImage::new(&b).unwrap());
        let place = |x: f64, y: f64| {
            let p = a.camera.unproject(x, y, 2.0);
            [p.x as f32, p.y as f32, p.z as f32]
        };
        for (x, y) in [(30.0, 20.0), (41.0, 15.0), (36.5, 25.0)] {
            let (q, trust) = from.track(&to, place(x, y), place(x, y)).unwrap();
            let ([u, v], z) = b.camera.project(&q.map(f64::from).into());
            assert!((u - x - 1.3).hypot(v - y + 0.7) < 0.1, "({x}, {y}) went to ({u}, {v})");
            assert!((z - 2.0).abs() < 1e-5 && trust > 0.5);
        }
        assert!(from.track(&to, place(10.0, 20.0), place(10.0, 20.0)).is_none(), "a static pixel");
        assert!(from.track(&to, place(1.0, 20.0), place(1.0, 20.0)).is_none(), "at the border");
        assert!(from.track(&to, place(30.0, 20.0), place(90.0, 20.0)).is_none(), "outside");
        assert!(from.track(&to, place(30.0, 20.0), [0.0, 0.0, -1.0]).is_none(), "behind");
    }

    #[test]
    fn a_flat_wall_is_not_trusted() {
        let a = PatchImage::new(&frame([0.0; 2], true)).unwrap();
        let p = a.camera.unproject(40.0, 20.0, 2.0);
        let p = [p.x as f32, p.y as f32, p.z as f32];
        assert!(a.track(&a, p, p).unwrap().1 < 1e-3);
        let without = CaptureFrame { mask: None, ..frame([0.0; 2], true) };
        assert!(PatchImage::new(&without).is_none());
    }
}
