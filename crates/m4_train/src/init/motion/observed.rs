//! What a frame shows of dynamic surfaces, in measures that shading leaves alone.

use m4_core::{
    CaptureFrame, Plane,
    nalgebra::{Matrix3, Vector3},
};

/// Depths of four neighbouring pixels that differ by more than this share are not of one surface
/// (our rule).
const JUMP: f32 = 0.03;
/// Half the side of the square whose mean light a pixel is compared with, widths of the image (our
/// rule).
const AROUND_WIDTHS: f32 = 0.016;
/// Added to sums of light, 0..1, so that the noise of dark pixels does not count as colour (our
/// rule).
const DARK: f32 = 0.1;
/// Contrast counts this much beside the shares of red and green (our rule).
const CONTRAST: f32 = 0.5;

/// A point of a dynamic surface, and its measures.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfacePoint {
    /// World units.
    pub place: Vector3<f32>,
    /// See [`Observed`].
    pub measures: [f32; 3],
}

/// A frame that points are aligned to.
///
/// Three measures of each pixel: red and green as shares of the light, and the light against its
/// mean around. A lamp that dims or a surface that turns away from it changes them little. Static
/// pixels have no part in them.
#[derive(Debug, Clone)]
pub(crate) struct Observed {
    /// Rows of the rotation from world to camera.
    rotation: [[f32; 3]; 3],
    translation: [f32; 3],
    /// Pixels; the centre of the first pixel is 0, 0.
    focal: [f32; 2],
    principal: [f32; 2],
    width: usize,
    height: usize,
    /// Row by row: the measures and z-depth, 0 where unknown.
    pixels: Vec<[f32; 4]>,
    dynamic: Vec<bool>,
}

/// A place of the world in the image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Projected {
    /// Pixels.
    pub at: [f32; 2],
    /// Camera axes.
    pub point: [f32; 3],
}

/// Bilinear values at a place of the image and their slopes along u and v, per pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub measures: [f32; 3],
    pub slopes: [[f32; 2]; 3],
    /// 0 where it is unknown, or where surfaces meet.
    pub depth: f32,
    pub depth_slope: [f32; 2],
}

impl Observed {
    /// `None` without depth or mask: then nothing is dynamic there.
    pub fn new(frame: &CaptureFrame) -> Option<Self> {
        let (depth, mask) = (frame.depth.as_ref()?, frame.mask.as_ref()?);
        let size = frame.rgb.size();
        let (width, height) = size;
        let inside = Plane::from_fn(width, height, |x, y| {
            f32::from(u8::from(mask.covers((x, y), size)))
        });
        let measures = measures(frame, &inside);
        let pixel = |i: usize| {
            let (x, y) = (i % width, i / width);
            let [a, b, c] = [0, 1, 2].map(|k| measures[k][(x, y)]);
            [a, b, c, depth.covering((x, y), size)]
        };
        let (w2c, k) = (frame.camera.w2c(), &frame.camera.intrinsics);
        Some(Self {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| w2c.rotation[(i, j)] as f32)),
            translation: std::array::from_fn(|i| w2c.translation[i] as f32),
            focal: [k.fx as f32, k.fy as f32],
            principal: [(k.cx - 0.5) as f32, (k.cy - 0.5) as f32],
            width,
            height,
            pixels: (0..width * height).map(pixel).collect(),
            dynamic: inside.data().iter().map(|&v| v > 0.0).collect(),
        })
    }

    /// Rows: right, down and ahead, in world axes.
    pub fn axes(&self) -> Matrix3<f32> {
        Matrix3::from_fn(|i, j| self.rotation[i][j])
    }

    /// Columns of the image.
    pub fn width(&self) -> usize {
        self.width
    }

    /// World units that a pixel spans at z-depth `z`.
    pub fn pixel(&self, z: f32) -> f32 {
        2.0 * z / (self.focal[0] + self.focal[1])
    }

    /// `None` behind the camera.
    #[inline]
    pub fn project(&self, p: &Vector3<f32>) -> Option<Projected> {
        let point: [f32; 3] = std::array::from_fn(|i| {
            let r = &self.rotation[i];
            r[0] * p.x + r[1] * p.y + r[2] * p.z + self.translation[i]
        });
        let [x, y, z] = point;
        let at = [
            self.focal[0] * x / z + self.principal[0],
            self.focal[1] * y / z + self.principal[1],
        ];
        (z > f32::EPSILON).then_some(Projected { at, point })
    }

    /// How u, v and z of a place change with the place, world axes.
    #[inline]
    pub fn jacobian(&self, projected: &Projected) -> [Vector3<f32>; 3] {
        let [x, y, z] = projected.point;
        let [right, down, ahead] = self.rotation.map(Vector3::from);
        let du = (right - ahead * (x / z)) * (self.focal[0] / z);
        let dv = (down - ahead * (y / z)) * (self.focal[1] / z);
        [du, dv, ahead]
    }

    /// `None` at the border of the image and where no pixel around is dynamic.
    #[inline]
    pub fn sample(&self, [u, v]: [f32; 2]) -> Option<Sample> {
        let inside =
            u >= 0.0 && v >= 0.0 && u < (self.width - 1) as f32 && v < (self.height - 1) as f32;
        if !inside {
            return None;
        }
        let (i, a, b) = (v as usize * self.width + u as usize, u.fract(), v.fract());
        let corners = [i, i + 1, i + self.width, i + self.width + 1];
        let dynamic = corners.map(|k| self.dynamic[k]);
        if dynamic == [false; 4] {
            return None;
        }
        let [p, q, r, s] = corners.map(|k| &self.pixels[k]);
        let blend = |k: usize| {
            let (above, below) = (p[k] + a * (q[k] - p[k]), r[k] + a * (s[k] - r[k]));
            let along = (1.0 - b) * (q[k] - p[k]) + b * (s[k] - r[k]);
            (above + b * (below - above), [along, below - above])
        };
        let values = [0, 1, 2].map(blend);
        let depths = [p[3], q[3], r[3], s[3]];
        let (low, high) = depths.iter().fold((f32::MAX, 0.0f32), |(low, high), &d| {
            (low.min(d), high.max(d))
        });
        let smooth = dynamic == [true; 4] && low > 0.0 && high - low < JUMP * high;
        let (depth, depth_slope) = if smooth { blend(3) } else { (0.0, [0.0; 2]) };
        Some(Sample {
            measures: values.map(|v| v.0),
            slopes: values.map(|v| v.1),
            depth,
            depth_slope,
        })
    }

    /// z-depth of a dynamic pixel.
    pub fn dynamic_depth(&self, (x, y): (usize, usize)) -> Option<f32> {
        let i = y * self.width + x;
        (self.dynamic[i] && self.pixels[i][3] > 0.0).then(|| self.pixels[i][3])
    }

    /// z-depth of the nearest pixel, 0 where unknown; `None` outside the image.
    pub fn depth(&self, [u, v]: [f32; 2]) -> Option<f32> {
        let (x, y) = (u.round(), v.round());
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside.then(|| self.pixels[y as usize * self.width + x as usize][3])
    }

    /// Dynamic pixels with depth, every `step`-th of every `step`-th row.
    pub fn points(&self, step: usize) -> Vec<SurfacePoint> {
        let rows = (step / 2..self.height).step_by(step);
        let places = rows.flat_map(|y| (step / 2..self.width).step_by(step).map(move |x| (x, y)));
        let point = |(x, y): (usize, usize)| {
            let i = y * self.width + x;
            let [a, b, c, z] = self.pixels[i];
            let place = || self.unproject([x as f32, y as f32], z);
            (self.dynamic[i] && z > 0.0).then(|| SurfacePoint {
                place: place(),
                measures: [a, b, c],
            })
        };
        places.filter_map(point).collect()
    }

    fn unproject(&self, [u, v]: [f32; 2], z: f32) -> Vector3<f32> {
        let p = [
            (u - self.principal[0]) / self.focal[0] * z,
            (v - self.principal[1]) / self.focal[1] * z,
            z,
        ];
        let p: [f32; 3] = std::array::from_fn(|i| p[i] - self.translation[i]);
        let r = &self.rotation;
        Vector3::from_fn(|j, _| (0..3).map(|i| r[i][j] * p[i]).sum())
    }
}

/// The measures of every pixel within two of a dynamic one; `inside` is 1 for dynamic pixels, 0 for
/// static ones.
fn measures(frame: &CaptureFrame, inside: &Plane<f32>) -> [Plane<f32>; 3] {
    let (width, height) = inside.size();
    let share = smooth(inside);
    let channel = |c: usize| {
        let own = |x, y| f32::from(frame.rgb[(x, y)][c]) / 255.0 * inside[(x, y)];
        let sum = smooth(&Plane::from_fn(width, height, own));
        Plane::from_fn(width, height, |x, y| sum[(x, y)] / share[(x, y)].max(1e-3))
    };
    let ((r, g), b) = rayon::join(|| rayon::join(|| channel(0), || channel(1)), || channel(2));
    let light = Plane::from_fn(width, height, |x, y| {
        (r[(x, y)] + g[(x, y)] + b[(x, y)]) / 3.0
    });
    let half = (AROUND_WIDTHS * width as f32).round().max(2.0) as usize;
    let lit = Plane::from_fn(width, height, |x, y| light[(x, y)] * inside[(x, y)]);
    let (sums, counts) = rayon::join(|| square_sums(&lit, half), || square_sums(inside, half));
    let of = |x: usize, y: usize, value: &dyn Fn(f32) -> f32| match share[(x, y)] {
        0.0 => 0.0,
        _ => value(light[(x, y)]),
    };
    let colour = |c: &Plane<f32>| {
        Plane::from_fn(width, height, |x, y| {
            of(x, y, &|light| c[(x, y)] / (3.0 * light + DARK))
        })
    };
    let contrast = Plane::from_fn(width, height, |x, y| {
        let mean = sums[(x, y)] / counts[(x, y)].max(1.0);
        of(x, y, &|light| CONTRAST * (light - mean) / (mean + DARK))
    });
    [colour(&r), colour(&g), contrast]
}

/// The sums over squares of side `2 half + 1`, cut at the border.
fn square_sums(plane: &Plane<f32>, half: usize) -> Plane<f32> {
    let (width, height) = plane.size();
    // sums of everything above and to the left; a row and a column of zeros first
    let stride = width + 1;
    let mut sums = vec![0.0f64; stride * (height + 1)];
    for y in 0..height {
        let mut row = 0.0;
        for x in 0..width {
            row += f64::from(plane[(x, y)]);
            sums[(y + 1) * stride + x + 1] = sums[y * stride + x + 1] + row;
        }
    }
    Plane::from_fn(width, height, |x, y| {
        let (left, top) = (x.saturating_sub(half), y.saturating_sub(half));
        let (right, bottom) = ((x + half + 1).min(width), (y + half + 1).min(height));
        let at = |x: usize, y: usize| sums[y * stride + x];
        (at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top)) as f32
    })
}

/// `[1 4 6 4 1] / 16` along both axes; edges repeat.
fn smooth(plane: &Plane<f32>) -> Plane<f32> {
    let (w, h) = plane.size();
    let taps = |v: [f32; 5]| (v[0] + v[4]) / 16.0 + (v[1] + v[3]) * 0.25 + v[2] * 0.375;
    let near = |x: usize, k: usize, n: usize| (x + k).saturating_sub(2).min(n - 1);
    let mut rows = Plane::filled(w, h, 0.0f32);
    for (row, out) in plane
        .data()
        .chunks_exact(w.max(1))
        .zip(rows.data_mut().chunks_exact_mut(w.max(1)))
    {
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
