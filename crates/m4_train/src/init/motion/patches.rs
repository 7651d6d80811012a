//! Tracks patches from one image to another.

use m4_core::{Camera, CaptureFrame, DepthMap, Plane};

/// Half the side of a patch, pixels.
const RADIUS: usize = 3;
/// Values that a patch must have at least: a third of the pixels, in three colours.
const LEAST: f64 = 49.0;
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

/// Pixels along the side of a patch.
const SIDE: usize = 2 * RADIUS + 1;
/// Pixels of a patch.
const AREA: usize = SIDE * SIDE;

/// Smoothed image, depth and mask of one frame, all of the size of the image.
#[derive(Debug, Clone)]
pub(crate) struct PatchImage {
    camera: Camera,
    /// Red, green, blue, 0..1.
    rgb: [Plane<f32>; 3],
    depth: DepthMap,
    dynamic: Plane<bool>,
}

/// The dynamic pixels around a place of a [`PatchImage`], to be found in another one.
pub(crate) struct Patch {
    /// Of each colour and pixel: its value and how it changes along u and v, 0..1 per pixel; 0 for static pixels.
    values: [[f32; AREA]; 3],
    slopes: [[[f32; AREA]; 2]; 3],
    /// 1 for dynamic pixels, 0 for static ones.
    weight: [f32; AREA],
    /// Number of values.
    count: f64,
    /// Sums of the products of slopes: uu, uv, vv.
    products: [f64; 3],
}

impl PatchImage {
    /// `None` without depth or mask: then nothing is dynamic there.
    pub fn new(frame: &CaptureFrame) -> Option<Self> {
        let (depth, mask) = (frame.depth.as_ref()?, frame.mask.as_ref()?);
        let (w, h) = frame.rgb.size();
        let channel = |c: usize| smooth(&frame.rgb.map(|p| f32::from(p[c]) / 255.0));
        let ((r, g), b) = rayon::join(|| rayon::join(|| channel(0), || channel(1)), || channel(2));
        Some(Self {
            camera: frame.camera,
            rgb: [r, g, b],
            depth: Plane::from_fn(w, h, |x, y| depth.covering((x, y), (w, h))),
            dynamic: Plane::from_fn(w, h, |x, y| mask.covers((x, y), (w, h))),
        })
    }

    /// Whether a whole patch around the place, and its slopes, are in the image.
    fn holds(&self, [u, v]: [f64; 2]) -> bool {
        let (w, h) = self.depth.size();
        let r = (RADIUS + 1) as f64;
        u >= r && v >= r && u + r + 1.0 < w as f64 && v + r + 1.0 < h as f64
    }

    /// The `N` x `N` values around a place, bilinear, row by row; the image holds it.
    fn samples<const N: usize>(&self, colour: usize, [u, v]: [f64; 2]) -> [[f32; N]; N] {
        let (a, b) = (u.fract() as f32, v.fract() as f32);
        let (x, y) = (u as usize - N / 2, v as usize - N / 2);
        let image = &self.rgb[colour];
        let width = image.width();
        let along = |row: usize| -> [f32; N] {
            let row = &image.data()[(y + row) * width + x..][..N + 1];
            std::array::from_fn(|k| (1.0 - a) * row[k] + a * row[k + 1])
        };
        let mut above = along(0);
        std::array::from_fn(|row| {
            let below = along(row + 1);
            let out = std::array::from_fn(|k| (1.0 - b) * above[k] + b * below[k]);
            above = below;
            out
        })
    }

    /// The patch around `p`, a point that this frame sees, world units. `None` where the image ends or too few pixels are dynamic.
    pub fn patch(&self, p: [f32; 3]) -> Option<Patch> {
        let (centre, z) = self.camera.project(&p.map(f64::from).into());
        if z <= 0.0 || !self.holds(centre) {
            return None;
        }
        let (x, y) = (centre[0].round() as usize - RADIUS, centre[1].round() as usize - RADIUS);
        let weight: [f32; AREA] = std::array::from_fn(|k| f32::from(self.dynamic[(x + k % SIDE, y + k / SIDE)]));
        let count = 3.0 * f64::from(weight.iter().sum::<f32>());
        if count < LEAST {
            return None;
        }
        let mut patch =
            Patch { values: [[0.0; AREA]; 3], slopes: [[[0.0; AREA]; 2]; 3], weight, count, products: [0.0; 3] };
        for colour in 0..3 {
            let around = self.samples::<{ SIDE + 2 }>(colour, centre);
            let [du, dv] = &mut patch.slopes[colour];
            for k in 0..AREA {
                let (x, y) = (k % SIDE + 1, k / SIDE + 1);
                patch.values[colour][k] = weight[k] * around[y][x];
                du[k] = weight[k] * 0.5 * (around[y][x + 1] - around[y][x - 1]);
                dv[k] = weight[k] * 0.5 * (around[y + 1][x] - around[y - 1][x]);
            }
            for (sum, [a, b]) in patch.products.iter_mut().zip([[&*du, &*du], [&*du, &*dv], [&*dv, &*dv]]) {
                *sum += f64::from(dot(a, b));
            }
        }
        Some(patch)
    }

    /// Where this frame sees the `patch` of another frame, which is expected at `guess`; and how much that can be trusted,
    /// 0..1. World units. `None` where it is not seen or has nothing to track.
    ///
    /// The patch is tracked by the method of Lucas and Kanade (1981) in its inverse form, dynamic pixels alone, all three
    /// colours; the depth map says how far away it is.
    pub fn find(&self, patch: &Patch, guess: [f32; 3]) -> Option<([f32; 3], f32)> {
        let (start, expected) = self.camera.project(&guess.map(f64::from).into());
        if expected <= 0.0 || !self.holds(start) {
            return None;
        }
        let [uu, uv, vv] = patch.products;
        let damping = patch.count * NOISE * NOISE;
        let (a, d) = (uu + damping, vv + damping);
        let determinant = a * d - uv * uv;
        let (mut at, mut rest) = (start, 0.0);
        for _ in 0..STEPS {
            let (mut b, mut squares) = ([0.0; 2], 0.0);
            for (colour, [du, dv]) in patch.slopes.iter().enumerate() {
                let here = self.samples::<SIDE>(colour, at);
                let here = here.as_flattened();
                let off: [f32; AREA] = std::array::from_fn(|k| patch.values[colour][k] - patch.weight[k] * here[k]);
                b = [b[0] + f64::from(dot(du, &off)), b[1] + f64::from(dot(dv, &off))];
                squares += f64::from(dot(&off, &off));
            }
            rest = squares / patch.count;
            at[0] += (d * b[0] - uv * b[1]) / determinant;
            at[1] += (a * b[1] - uv * b[0]) / determinant;
            if (at[0] - start[0]).hypot(at[1] - start[1]) > FARTHEST_PX || !self.holds(at) {
                return None;
            }
        }
        let pixel = (at[0].round() as usize, at[1].round() as usize);
        let depth = f64::from(self.depth[pixel]);
        if !self.dynamic[pixel] || (depth - expected).abs() > DEPTH_JUMP * expected {
            return None;
        }
        // contrast across the weakest direction: the smaller eigenvalue
        let least = 0.5 * (uu + vv) - (0.25 * (uu - vv).powi(2) + uv * uv).sqrt();
        let trust = least.max(0.0) / (least.max(0.0) + damping) / (1.0 + rest / (UNLIKE * UNLIKE));
        let q = self.camera.unproject(at[0], at[1], depth);
        Some(([q.x as f32, q.y as f32, q.z as f32], trust as f32))
    }
}

/// The sum of the products, in eight partial sums that the compiler adds at a time.
fn dot(a: &[f32; AREA], b: &[f32; AREA]) -> f32 {
    let mut sums = [0.0f32; 8];
    let (a, a_rest) = a.as_chunks::<8>();
    let (b, b_rest) = b.as_chunks::<8>();
    for (a, b) in a.iter().zip(b) {
        for k in 0..8 {
            sums[k] += a[k] * b[k];
        }
    }
    sums.iter().sum::<f32>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f32>()
}

/// `[1 4 6 4 1] / 16` along both axes; edges repeat.
fn smooth(plane: &Plane<f32>) -> Plane<f32> {
    let (w, h) = plane.size();
    let taps = |v: [f32; 5]| (v[0] + v[4]) / 16.0 + (v[1] + v[3]) * 0.25 + v[2] * 0.375;
    let near = |x: usize, k: usize, n: usize| (x + k).saturating_sub(2).min(n - 1);
    let mut rows = Plane::filled(w, h, 0.0f32);
    for (row, out) in plane.data().chunks_exact(w.max(1)).zip(rows.data_mut().chunks_exact_mut(w.max(1))) {
        for (x, out) in out.iter_mut().enumerate() {
            *out = taps(std::array::from_fn(|k| row[near(x, k, w)]));
        }
    }
    let mut out = Plane::filled(w, h, 0.0f32);
    for (y, out) in out.data_mut().chunks_exact_mut(w.max(1)).enumerate() {
        let rows: [&[f32]; 5] = std::array::from_fn(|k| &rows.data()[near(y, k, h) * w..][..w]);
        for (x, out) in out.iter_mut().enumerate() {
            *out = taps(rows.map(|row| row[x]));
        }
    }
    out
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
            let (q, trust) = to.find(&from.patch(place(x, y)).unwrap(), place(x, y)).unwrap();
            let ([u, v], z) = b.camera.project(&q.map(f64::from).into());
            assert!((u - x - 1.3).hypot(v - y + 0.7) < 0.1, "({x}, {y}) went to ({u}, {v})");
            assert!((z - 2.0).abs() < 1e-5 && trust > 0.5);
        }
        assert!(from.patch(place(10.0, 20.0)).is_none(), "a static pixel");
        assert!(from.patch(place(1.0, 20.0)).is_none(), "at the border");
        let patch = from.patch(place(30.0, 20.0)).unwrap();
        assert!(to.find(&patch, place(90.0, 20.0)).is_none(), "outside");
        assert!(to.find(&patch, [0.0, 0.0, -1.0]).is_none(), "behind");
    }

    #[test]
    fn a_flat_wall_is_not_trusted() {
        let a = PatchImage::new(&frame([0.0; 2], true)).unwrap();
        let p = a.camera.unproject(40.0, 20.0, 2.0);
        let p = [p.x as f32, p.y as f32, p.z as f32];
        assert!(a.find(&a.patch(p).unwrap(), p).unwrap().1 < 1e-3);
        let without = CaptureFrame { mask: None, ..frame([0.0; 2], true) };
        assert!(PatchImage::new(&without).is_none());
    }
}
