//! The synthetic scene that kernels are timed on: a room with six balls, sampled through three nearby
//! cameras, so that a third of the splats is partly hidden, as in a video.

use m4_math::{
    CounterRng,
    nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3},
};
use m4_scene::{Camera, Column, Intrinsics, SplatLayout, Splats};

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

/// Where a ray first hits: distance, normal, a number for the surface.
fn cast(origin: &Vector3<f64>, ray: &Vector3<f64>) -> (f64, Vector3<f64>, usize) {
    let mut best = (f64::INFINITY, Vector3::z(), 0);
    for (id, (normal, offset)) in WALLS.iter().enumerate() {
        let n = Vector3::from(*normal);
        let t = (offset - origin.dot(&n)) / ray.dot(&n);
        if ray.dot(&n) < -1e-6 && t > 1e-3 && t < best.0 {
            best = (t, n, id);
        }
    }
    for (id, [x, y, z, r]) in BALLS.iter().enumerate() {
        let to = origin - Vector3::new(*x, *y, *z);
        let (b, c) = (ray.dot(&to), to.norm_squared() - r * r);
        let t = -b - (b * b - c).max(0.0).sqrt();
        if b * b > c && t > 1e-3 && t < best.0 {
            best = (t, (to + ray * t) / *r, 10 + id);
        }
    }
    best
}

fn colour(p: &Vector3<f64>, id: usize) -> [f64; 3] {
    std::array::from_fn(|k| {
        let phase = 3.0 * (p[k] + p[(k + 1) % 3]) + 2.0 * 1.7 * id as f64;
        0.5 + 0.35 * phase.sin()
    })
}

/// The first camera: 60 degrees wide.
pub(super) fn camera(width: usize, height: usize) -> Camera {
    let focal_px = 0.5 * width as f64 / 30f64.to_radians().tan();
    Camera {
        intrinsics: Intrinsics::centred(width, height, focal_px),
        c2w: m4_math::Se3::identity(),
    }
}

/// What the first camera sees, 0..1.
pub(super) fn picture(camera: &Camera) -> [Vec<f32>; 3] {
    let k = &camera.intrinsics;
    let mut planes: [Vec<f32>; 3] = Default::default();
    for (x, y) in (0..k.width * k.height).map(|i| (i % k.width, i / k.width)) {
        let ray = camera.unproject(x as f64, y as f64, 1.0).normalize();
        let (t, _, id) = cast(&Vector3::zeros(), &ray);
        for (plane, c) in planes.iter_mut().zip(colour(&(ray * t), id)) {
            plane.push(c.clamp(0.0, 1.0) as f32);
        }
    }
    planes
}

/// `n` flat discs on the surfaces, `n_dynamic` of them with a life around `t`, in no order.
pub(super) fn splats(n: usize, n_dynamic: usize, camera: &Camera, sh_degree: usize, t: f64) -> Splats {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree,
        time_degree: 0,
    };
    let n_static = n - n_dynamic.min(n);
    let mut out = Splats::zeros(layout, n_static, n - n_static);
    let k = camera.intrinsics;
    let spacing_px = (k.width as f64 * k.height as f64 / n.max(1) as f64).sqrt();
    for row in 0..n {
        let mut rng = CounterRng::new(7, 0, row as u64);
        let origin = Vector3::from(CAMERAS[rng.below(3)]);
        let ray = Vector3::new(
            (rng.uniform() - 0.5) * k.width as f64 / k.fx,
            (rng.uniform() - 0.5) * k.height as f64 / k.fy,
            1.0,
        )
        .normalize();
        let (distance, normal, id) = cast(&origin, &ray);
        let p = origin + ray * distance;
        let size = spacing_px * p.z.abs() / k.fx;
        let (a, b) = (size * (0.4 * rng.normal()).exp(), size * (0.4 * rng.normal()).exp());
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
        set(Column::LogScale, &[a.ln(), b.ln(), (0.2 * a.min(b)).ln()], row);
        set(Column::Quat, &[q.w, q.i, q.j, q.k], row);
        set(Column::Opacity, &[(opacity / (1.0 - opacity)).ln()], row);
        let mut coefficients = colour(&p, id).map(|c| (c - 0.5) / crate::shade::C0).to_vec();
        coefficients.extend((3..3 * layout.colour_terms()).map(|_| 0.03 * rng.normal()));
        set(Column::Colour, &coefficients, row);
        if let Some(row) = row.checked_sub(n_static) {
            set(Column::TimeMean, &[t + rng.normal()], row);
            set(Column::LogTimeSd, &[1.0], row);
            let velocity: [f64; 3] = std::array::from_fn(|_| 0.005 * rng.normal());
            set(Column::Velocity, &velocity, row);
        }
    }
    out
}
