//! A synthetic scene with ground truth: boxes that rotate and move behind a pillar and out of the
//! image.

use m4_core::{
    Camera, DepthMap, Intrinsics, Mask, Plane, RgbImage, Se3,
    nalgebra::{Rotation3, Vector3},
};

/// Intersection of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// 0 the wall, 1 the pillar, 2 the box that passes behind it, 3 the box that leaves the image.
    pub body: usize,
    /// Where on the body, in the body's own axes.
    pub local: Vector3<f64>,
    /// z-depth, world units.
    pub depth: f64,
}

/// A textured wall at depth 6, a pillar at depth 2.2, and two textured boxes: one turns by 0.6 rad
/// on its way behind the pillar, the other, nearer to the side, leaves the image. The camera walks
/// slowly.
#[derive(Debug, Clone)]
pub struct BoxScene {
    /// One per frame.
    pub cameras: Vec<Camera>,
    hits: Vec<Vec<Hit>>,
}

/// Bodies from this one on move.
const FIRST_MOVING: usize = 2;
/// Half the sides of each body.
const HALF: [[f64; 3]; 4] = [
    [12.0, 9.0, 0.1],
    [0.11, 3.0, 0.1],
    [0.42, 0.35, 0.3],
    [0.26, 0.22, 0.2],
];

impl BoxScene {
    /// A clip of this many images of `width` x `height` pixels.
    pub fn new(width: usize, height: usize, frames: usize) -> Self {
        let camera = |t: usize| {
            let u = part(t, frames);
            Camera {
                intrinsics: Intrinsics::centred(width, height, width as f64),
                c2w: Se3 {
                    rotation: *Rotation3::from_scaled_axis(Vector3::new(0.0, 0.03 - 0.06 * u, 0.0))
                        .matrix(),
                    translation: Vector3::new(-0.1 + 0.2 * u, 0.02 * u, 0.0),
                },
            }
        };
        let mut out = Self {
            cameras: (0..frames).map(camera).collect(),
            hits: Vec::new(),
        };
        out.hits = (0..frames)
            .map(|t| {
                let pixel = |i: usize| out.cast(t, (i % width) as f64, (i / width) as f64);
                (0..width * height).map(pixel).collect()
            })
            .collect();
        out
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.cameras.len()
    }

    /// Whether a body moves.
    pub fn moves(body: usize) -> bool {
        body >= FIRST_MOVING
    }

    fn pose(&self, body: usize, t: usize) -> Se3<f64> {
        let u = part(t, self.frames());
        let (axis, centre) = match body {
            0 => ([0.0; 3], [0.0, 0.0, 6.1]),
            1 => ([0.0; 3], [0.05, 0.0, 2.2]),
            2 => (
                [0.0, 0.2 + 0.6 * u, 0.1 * u],
                [-0.75 + 1.5 * u, 0.15, 3.2 + 0.15 * (3.0 * u).sin()],
            ),
            _ => ([0.1 + 0.2 * u, 0.0, 0.5 * u], [0.65 + 1.5 * u, -0.6, 2.8]),
        };
        Se3 {
            rotation: *Rotation3::from_scaled_axis(Vector3::from(axis)).matrix(),
            translation: Vector3::from(centre),
        }
    }

    /// Casts a ray from the camera of frame `t` through pixel coordinates `(u, v)` (centre of the
    /// first pixel: 0, 0).
    pub fn cast(&self, t: usize, u: f64, v: f64) -> Hit {
        let camera = &self.cameras[t];
        let (origin, ray) = (
            camera.centre(),
            camera.unproject(u, v, 1.0) - camera.centre(),
        );
        let mut nearest: Option<Hit> = None;
        for body in 0..HALF.len() {
            let to_body = self.pose(body, t).inverse();
            let (o, d) = (to_body.transform(&origin), to_body.rotation * ray);
            let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
            for k in 0..3 {
                let (a, b) = (
                    (-HALF[body][k] - o[k]) / d[k],
                    (HALF[body][k] - o[k]) / d[k],
                );
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
            let depth = enter;
            if depth > 0.0 && enter < leave && nearest.is_none_or(|n| depth < n.depth) {
                nearest = Some(Hit {
                    body,
                    local: o + depth * d,
                    depth,
                });
            }
        }
        nearest.expect("the wall fills the view")
    }

    /// Casts a ray through a pixel of frame `t`.
    pub fn hit(&self, t: usize, x: usize, y: usize) -> Hit {
        self.hits[t][y * self.cameras[t].intrinsics.width + x]
    }

    /// Where a point of a body is in frame `t`.
    pub fn place(&self, body: usize, local: &Vector3<f64>, t: usize) -> Vector3<f64> {
        self.pose(body, t).transform(local)
    }

    /// The point of a body that is at `place` in frame `t`.
    pub fn local(&self, body: usize, place: &Vector3<f64>, t: usize) -> Vector3<f64> {
        self.pose(body, t).inverse().transform(place)
    }

    /// Distance of a point from the surface of a box in frame `t`, inside or outside, world units.
    pub fn surface_distance(&self, body: usize, place: &Vector3<f64>, t: usize) -> f64 {
        let local = self.local(body, place, t);
        let off = Vector3::from_fn(|k, _| local[k].abs() - HALF[body][k]);
        let outside = off.map(|v| v.max(0.0)).norm();
        (outside + off.max().min(0.0)).abs()
    }

    /// Whether frame `t` sees a point of a body.
    pub fn sees(&self, body: usize, local: &Vector3<f64>, t: usize) -> bool {
        let ([u, v], z) = self.cameras[t].project(&self.place(body, local, t));
        let k = &self.cameras[t].intrinsics;
        let inside = z > 0.0
            && u > -0.5
            && v > -0.5
            && u < k.width as f64 - 0.5
            && v < k.height as f64 - 0.5;
        inside && {
            let hit = self.cast(t, u, v);
            hit.body == body && (hit.local - local).norm() < 0.01 * z
        }
    }

    fn plane<T>(&self, t: usize, f: impl Fn(&Hit) -> T) -> Plane<T> {
        let k = &self.cameras[t].intrinsics;
        Plane::from_fn(k.width, k.height, |x, y| f(&self.hit(t, x, y)))
    }

    /// The image of frame `t`.
    pub fn rgb(&self, t: usize) -> RgbImage {
        self.plane(t, |hit| texture(hit.body, &hit.local))
    }

    /// z-depth of frame `t`.
    pub fn depth(&self, t: usize) -> DepthMap {
        self.plane(t, |hit| hit.depth as f32)
    }

    /// The dynamic part in frame `t`.
    pub fn mask(&self, t: usize) -> Mask {
        self.plane(t, |hit| if Self::moves(hit.body) { 255 } else { 0 })
    }

    /// True displacement, pixels, of what each pixel of frame `from` shows, to frame `to`, whether
    /// it is seen there or not: to the right and downwards, `[height][width]`.
    pub fn flow(&self, from: usize, to: usize) -> (Vec<f32>, Vec<f32>) {
        let width = self.cameras[from].intrinsics.width;
        let one = |(i, hit): (usize, &Hit)| {
            let ([u, v], _) = self.cameras[to].project(&self.place(hit.body, &hit.local, to));
            (
                (u - (i % width) as f64) as f32,
                (v - (i / width) as f64) as f32,
            )
        };
        self.hits[from].iter().enumerate().map(one).unzip()
    }
}

fn part(t: usize, frames: usize) -> f64 {
    t as f64 / frames.saturating_sub(1).max(1) as f64
}

/// A colour that tells places of a body apart, with waves of a few pixels and more.
fn texture(body: usize, p: &Vector3<f64>) -> [u8; 3] {
    let scale = if body == 0 { 0.5 } else { 1.0 };
    let waves = [
        Vector3::new(17.0, 9.0, 13.0),
        Vector3::new(-12.0, 21.0, 7.0),
        Vector3::new(33.0, -27.0, 25.0),
        Vector3::new(29.0, 38.0, -31.0),
    ];
    std::array::from_fn(|c| {
        let phase = 1.7 * c as f64 + 2.3 * body as f64;
        let sum: f64 = (0..4)
            .map(|i| {
                (scale * waves[i].dot(p) + phase * (i + 1) as f64).sin()
                    * if i < 2 { 34.0 } else { 24.0 }
            })
            .sum();
        (128.0 + sum).clamp(0.0, 255.0).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::BoxScene;
    use m4_core::nalgebra::Vector3;

    #[test]
    fn one_box_is_hidden_in_part_and_the_other_leaves() {
        let scene = BoxScene::new(96, 72, 12);
        let count = |t: usize, body: usize| {
            (0..96 * 72)
                .filter(|i| scene.hit(t, i % 96, i / 96).body == body)
                .count()
        };
        assert!(count(0, 3) > 50 && count(11, 3) == 0);
        assert!((0..12).all(|t| count(t, 2) > 100));
        assert!(
            count(6, 2) * 5 < count(0, 2) * 4,
            "{} {}",
            count(6, 2),
            count(0, 2)
        );
        // a point of the front face goes behind the pillar and comes back
        let hit = (0..96 * 72)
            .map(|i| scene.hit(0, i % 96, i / 96))
            .filter(|h| h.body == 2)
            .nth(150)
            .unwrap();
        let visible: Vec<bool> = (0..12).map(|t| scene.sees(2, &hit.local, t)).collect();
        assert!(
            visible[0] && visible[11] && visible.contains(&false),
            "{visible:?}"
        );
        let place = scene.place(2, &hit.local, 5);
        assert!((scene.local(2, &place, 5) - hit.local).norm() < 1e-12);
        assert!(scene.surface_distance(2, &place, 5) < 1e-9);
        let off = scene.surface_distance(
            2,
            &scene.place(2, &Vector3::new(0.42, 0.1, 0.0).scale(1.5), 5),
            5,
        );
        assert!((off - 0.21).abs() < 1e-9, "{off}");
    }

    #[test]
    fn flow_leads_to_the_same_point() {
        let scene = BoxScene::new(96, 72, 12);
        let (u, v) = scene.flow(3, 4);
        let mut checked = 0;
        for i in 0..96 * 72 {
            let hit = scene.hit(3, i % 96, i / 96);
            if scene.sees(hit.body, &hit.local, 4) {
                let target = scene.cast(
                    4,
                    (i % 96) as f64 + f64::from(u[i]),
                    (i / 96) as f64 + f64::from(v[i]),
                );
                if target.body == hit.body {
                    let off: Vector3<f64> = target.local - hit.local;
                    assert!(off.norm() < 1e-3 * hit.depth, "{i}: {off}");
                    checked += 1;
                }
            }
        }
        assert!(checked > 5000, "{checked}");
    }
}
