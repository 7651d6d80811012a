//! The synthetic benchmark scenes: a room with six balls, sampled through three nearby cameras, so
//! that a third of the splats is partly occluded, as in a video.

use crate::View;
use m4_core::{
    Camera, Column, CounterRng, Intrinsics, Se3, SplatLayout, Splats,
    nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3},
};

/// Centre and radius, metres.
const BALLS: [[f64; 4]; 6] = [
    [-1.0, 0.6, 3.0, 0.55],
    [0.9, 0.5, 2.6, 0.5],
    [0.1, 0.8, 3.8, 0.45],
    [-0.5, -0.4, 4.4, 0.6],
    [1.3, -0.5, 4.0, 0.5],
    [0.2, -0.2, 2.2, 0.22],
];
/// Inward normal and offset of the walls: `n . x = d`.
const WALLS: [([f64; 3], f64); 5] = [
    ([0.0, 0.0, -1.0], -6.0),
    ([0.0, -1.0, 0.0], -1.3),
    ([0.0, 1.0, 0.0], -1.5),
    ([1.0, 0.0, 0.0], -2.4),
    ([-1.0, 0.0, 0.0], -2.4),
];
const CAMERAS: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [0.35, 0.0, 0.1], [-0.35, 0.1, 0.1]];

/// What the splats of a scene are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SceneKind {
    /// Every splat is there all the time, on walls and balls alike.
    Static,
    /// As training has them: the walls are a fifth of the splats; the rest lies on the balls, each
    /// alive for a frame or two out of 64, so that at any instant most of them are missing.
    FourD,
}

impl SceneKind {
    /// `static` or `4d`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Static => "static",
            Self::FourD => "4d",
        }
    }
}

/// Frames of the clip of [`SceneKind::FourD`].
const FRAMES: usize = 64;
/// Instants at which that clip is timed, evenly spread.
const INSTANTS: usize = 8;
/// Share of its splats that is dynamic.
const DYNAMIC: f64 = 0.8;
/// Standard deviation in time of those, frames: what `init.time_spread` starts from.
const TIME_SD: f64 = 0.5;
/// A splat is alive this many standard deviations to either side ([`crate::slice::MARGINAL_MIN`]).
const REACH: f64 = 2.448;
/// How fast the balls drift, metres per frame (standard deviation an axis).
const SPEED: f64 = 0.004;

/// Where a ray first hits: distance, normal, a number for the surface.
fn cast(
    origin: &Vector3<f64>,
    ray: &Vector3<f64>,
    shift: impl Fn(usize) -> Vector3<f64>,
) -> (f64, Vector3<f64>, usize) {
    let mut best = cast_walls(origin, ray);
    for (id, [x, y, z, r]) in BALLS.iter().enumerate() {
        let to = origin - Vector3::new(*x, *y, *z) - shift(id);
        let (b, c) = (ray.dot(&to), to.norm_squared() - r * r);
        let t = -b - (b * b - c).max(0.0).sqrt();
        if b * b > c && t > 1e-3 && t < best.0 {
            best = (t, (to + ray * t) / *r, BALL + id);
        }
    }
    best
}

/// Number of the first ball among the surfaces.
const BALL: usize = 10;

fn cast_walls(origin: &Vector3<f64>, ray: &Vector3<f64>) -> (f64, Vector3<f64>, usize) {
    let mut best = (f64::INFINITY, Vector3::z(), 0);
    for (id, (normal, offset)) in WALLS.iter().enumerate() {
        let n = Vector3::from(*normal);
        let t = (offset - origin.dot(&n)) / ray.dot(&n);
        if ray.dot(&n) < -1e-6 && t > 1e-3 && t < best.0 {
            best = (t, n, id);
        }
    }
    best
}

/// Which ball a surface is, if any.
fn is_ball(surface: usize) -> Option<usize> {
    surface.checked_sub(BALL)
}

/// Velocity of a ball, metres per frame.
fn velocity(ball: usize) -> Vector3<f64> {
    let mut rng = CounterRng::new(11, 0, ball as u64);
    Vector3::from_fn(|_, _| SPEED * rng.normal())
}

/// Where a ball is at an instant, relative to the middle of the clip.
fn drift(ball: usize, t: f64) -> Vector3<f64> {
    velocity(ball) * (t - 0.5 * FRAMES as f64)
}

fn colour(p: &Vector3<f64>, id: usize) -> [f64; 3] {
    std::array::from_fn(|k| {
        let phase = 3.0 * (p[k] + p[(k + 1) % 3]) + 2.0 * 1.7 * id as f64;
        0.5 + 0.35 * phase.sin()
    })
}

/// The first camera: 60 degrees wide.
fn camera(width: usize, height: usize) -> Camera {
    let focal_px = 0.5 * width as f64 / 30f64.to_radians().tan();
    Camera {
        intrinsics: Intrinsics::centred(width, height, focal_px),
        c2w: Se3::identity(),
    }
}

/// What is drawn: one instant of a static scene, several of a clip.
pub(super) fn views(width: usize, height: usize, kind: SceneKind) -> Vec<View> {
    let count = match kind {
        SceneKind::Static => 1,
        SceneKind::FourD => INSTANTS,
    };
    let view = |i: usize| View {
        camera: camera(width, height),
        t: ((i as f64 + 0.5) * FRAMES as f64 / count as f64).floor(),
        background: [0.0; 3],
        near: 0.05,
        mip: false,
        period: FRAMES as f32,
        with_depth: false,
    };
    (0..count).map(view).collect()
}

/// What the first camera sees in the middle of the clip, as a photograph.
pub(super) fn image(width: usize, height: usize) -> [Vec<u8>; 3] {
    let camera = camera(width, height);
    let mut planes: [Vec<u8>; 3] = Default::default();
    for (x, y) in (0..width * height).map(|i| (i % width, i / width)) {
        let ray = camera.unproject(x as f64, y as f64, 1.0).normalize();
        let (t, _, id) = cast(&Vector3::zeros(), &ray, |_| Vector3::zeros());
        for (plane, c) in planes.iter_mut().zip(colour(&(ray * t), id)) {
            plane.push((255.0 * c.clamp(0.0, 1.0)).round() as u8);
        }
    }
    planes
}

/// A direction through the image, and the camera it starts from.
fn draw_ray(rng: &mut CounterRng, k: &Intrinsics) -> (Vector3<f64>, Vector3<f64>) {
    let origin = Vector3::from(CAMERAS[rng.below(3)]);
    let ray = Vector3::new(
        (rng.uniform() - 0.5) * k.width as f64 / k.fx,
        (rng.uniform() - 0.5) * k.height as f64 / k.fy,
        1.0,
    );
    (origin, ray.normalize())
}

/// Share of the image that balls cover, sampled.
fn share_of_balls(k: &Intrinsics) -> f64 {
    const SAMPLES: usize = 4096;
    let mut rng = CounterRng::new(13, 0, 0);
    let hits = (0..SAMPLES).filter(|_| {
        let (origin, ray) = draw_ray(&mut rng, k);
        is_ball(cast(&origin, &ray, |_| Vector3::zeros()).2).is_some()
    });
    hits.count() as f64 / SAMPLES as f64
}

/// `n` flat discs on the surfaces, in no order.
pub(super) fn splats(n: usize, (width, height): (usize, usize), kind: SceneKind) -> Splats {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 0,
        time_degree: 0,
    };
    let k = camera(width, height).intrinsics;
    let n_static = match kind {
        SceneKind::Static => n,
        SceneKind::FourD => n - (n as f64 * DYNAMIC) as usize,
    };
    let pixels = (width * height) as f64;
    // so that what is there at an instant covers the image as densely as a static scene does
    let alive = (n - n_static) as f64 * 2.0 * REACH * TIME_SD / FRAMES as f64;
    let spacing_static = (pixels / n_static.max(1) as f64).sqrt();
    let spacing_dynamic = (pixels * share_of_balls(&k) / alive.max(1.0)).sqrt();
    let mut out = Splats::zeros(layout, n_static, n - n_static);
    for row in 0..n {
        let mut rng = CounterRng::new(7, 0, row as u64);
        let dynamic = row >= n_static;
        let time = rng.below(FRAMES) as f64;
        let (mut origin, mut ray) = draw_ray(&mut rng, &k);
        let mut hit = match kind {
            SceneKind::Static => cast(&origin, &ray, |_| Vector3::zeros()),
            SceneKind::FourD => cast_walls(&origin, &ray),
        };
        // a ray that meets no ball in this many attempts stays on the wall
        for _ in 0..if dynamic { 100 } else { 0 } {
            hit = cast(&origin, &ray, |ball| drift(ball, time));
            if is_ball(hit.2).is_some() {
                break;
            }
            (origin, ray) = draw_ray(&mut rng, &k);
        }
        let (distance, normal, id) = hit;
        let p = origin + ray * distance;
        let spacing_px = if dynamic {
            spacing_dynamic
        } else {
            spacing_static
        };
        let size = spacing_px * p.z.abs() / k.fx;
        let (a, b) = (
            size * (0.4 * rng.normal()).exp(),
            size * (0.4 * rng.normal()).exp(),
        );
        let up = if normal.y.abs() < 0.9 {
            Vector3::y()
        } else {
            Vector3::x()
        };
        let x = up.cross(&normal).normalize();
        let turn = Rotation3::from_scaled_axis(normal * (std::f64::consts::TAU * rng.uniform()));
        let x = turn * x;
        let axes = Matrix3::from_columns(&[x, normal.cross(&x), normal]);
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        // half faint, half strong
        let opacity: f64 = if rng.uniform() < 0.5 { 0.25 } else { 0.75 };
        let opacity = (opacity + 0.15 * rng.normal()).clamp(0.01, 0.99);
        let mut set = |column, values: &[f64], row: usize| {
            for (k, &v) in values.iter().enumerate() {
                out.column_mut(column, k)[row] = v as f32;
            }
        };
        set(Column::Mean, p.as_slice(), row);
        set(
            Column::LogScale,
            &[a.ln(), b.ln(), (0.2 * a.min(b)).ln()],
            row,
        );
        set(Column::Quat, &[q.w, q.i, q.j, q.k], row);
        set(Column::Opacity, &[(opacity / (1.0 - opacity)).ln()], row);
        set(
            Column::Colour,
            &colour(&p, id).map(|c| (c - 0.5) / crate::shade::C0),
            row,
        );
        if dynamic {
            let row = row - n_static;
            let ball = is_ball(id);
            set(Column::TimeMean, &[time + 0.1 * rng.normal()], row);
            set(Column::LogTimeSd, &[TIME_SD.ln() + 0.2 * rng.normal()], row);
            set(
                Column::Velocity,
                ball.map_or(Vector3::zeros(), velocity).as_slice(),
                row,
            );
        }
    }
    out
}
