//! Small synthetic scenes with known results.

use m4_core::{
    Binding, Camera, Column, CounterRng, Exposure, Intrinsics, Pose, Scene, Se3, SourceFrame,
    SplatLayout, Splats, Window,
    nalgebra::{Matrix3, Vector3, Vector6},
};
use std::sync::Arc;

/// Parameters of a random scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneSpec {
    /// Which columns.
    pub layout: SplatLayout,
    /// Splats without time.
    pub n_static: usize,
    /// Splats with time.
    pub n_dynamic: usize,
    /// Lives are spread over `0..=time_frames - 1`.
    pub time_frames: usize,
    /// Range of the standard deviations on the image, pixels.
    pub sd_px: [f64; 2],
    /// Range of the logits of the opacity.
    pub logit: [f64; 2],
}

impl Default for SceneSpec {
    /// 40 static and 40 dynamic splats of 1 to 6 pixels, one colour each, faint to nearly opaque.
    fn default() -> Self {
        Self {
            layout: SplatLayout {
                isotropic: false,
                sh_degree: 0,
                time_degree: 0,
            },
            n_static: 40,
            n_dynamic: 40,
            time_frames: 10,
            sd_px: [1.0, 6.0],
            logit: [-2.0, 3.0],
        }
    }
}

/// A camera at `centre` that looks at `target`; y points down.
pub fn camera_looking_at(intrinsics: Intrinsics, centre: [f64; 3], target: [f64; 3]) -> Camera {
    let (centre, target) = (Vector3::from(centre), Vector3::from(target));
    let z = (target - centre).normalize();
    let down = if z.y.abs() > 0.99 {
        Vector3::z()
    } else {
        Vector3::y()
    };
    let x = down.cross(&z).normalize();
    let y = z.cross(&x);
    Camera {
        intrinsics,
        c2w: Se3 {
            rotation: Matrix3::from_columns(&[x, y, z]),
            translation: centre,
        },
    }
}

/// A camera at a random pose within a unit of the origin, with unequal focal lengths and a
/// principal point off the middle.
pub fn random_camera(seed: u64, width: usize, height: usize) -> Camera {
    let mut rng = CounterRng::new(seed, 0xca_3e_7a, 0);
    let mut between = |low: f64, high: f64| low + (high - low) * rng.uniform();
    let size = width.max(height) as f64;
    let fx = size * between(0.8, 1.6);
    let intrinsics = Intrinsics {
        width,
        height,
        fx,
        fy: fx * between(0.9, 1.1),
        cx: width as f64 * between(0.4, 0.6),
        cy: height as f64 * between(0.4, 0.6),
    };
    let twist = Vector6::from_fn(|_, _| between(-1.0, 1.0));
    Camera {
        intrinsics,
        c2w: Se3::identity().retract(&twist),
    }
}

/// Splats in front of `camera`, 2 to 6 units away, some past the edges of the image.
pub fn random_splats(seed: u64, camera: &Camera, spec: &SceneSpec) -> Splats {
    let mut splats = Splats::zeros(spec.layout, spec.n_static, spec.n_dynamic);
    let k = &camera.intrinsics;
    for row in 0..splats.n() {
        let mut rng = CounterRng::new(seed, 0x5b1a7, row as u64);
        let mut between = |low: f64, high: f64| low + (high - low) * rng.uniform();
        let z = between(2.0, 6.0);
        let u = between(-0.15, 1.15) * k.width as f64;
        let v = between(-0.15, 1.15) * k.height as f64;
        let mean = camera.unproject(u, v, z);
        let log_scale: [f64; 3] =
            std::array::from_fn(|_| (between(spec.sd_px[0], spec.sd_px[1]) * z / k.fx).ln());
        let quat: [f64; 4] = std::array::from_fn(|_| between(-1.0, 1.0));
        let logit = between(spec.logit[0], spec.logit[1]);
        let life = row.checked_sub(spec.n_static).map(|row| {
            let time_mean = between(0.0, spec.time_frames.saturating_sub(1) as f64);
            let log_sd = between(1.0f64.ln(), 5.0f64.ln());
            let velocity: [f64; 3] = std::array::from_fn(|_| between(-0.05, 0.05));
            (row, time_mean, log_sd, velocity)
        });
        let mut set = |column, values: &[f64], row: usize| {
            for (k, &value) in values.iter().enumerate() {
                splats.column_mut(column, k)[row] = value as f32;
            }
        };
        set(Column::Mean, mean.as_slice(), row);
        set(
            Column::LogScale,
            &log_scale[..spec.layout.range(Column::LogScale).len()],
            row,
        );
        set(
            Column::Quat,
            &quat[..spec.layout.range(Column::Quat).len()],
            row,
        );
        set(Column::Opacity, &[logit], row);
        let colour: Vec<f64> = (0..spec.layout.range(Column::Colour).len())
            .map(|c| rng.normal() * if c < 3 { 0.8 } else { 0.2 })
            .collect();
        set(Column::Colour, &colour, row);
        if let Some((row, time_mean, log_sd, velocity)) = life {
            set(Column::TimeMean, &[time_mean], row);
            set(Column::LogTimeSd, &[log_sd], row);
            set(Column::Velocity, &velocity, row);
        }
    }
    splats
}

/// Binds the first `n_bound` dynamic splats to nodes of two windows, with keys at frames 0 to 3 and
/// 3 to 7: small motions, and lives of which some begin or end there. Their colours change. Panics
/// if there are fewer dynamic splats.
pub fn bind_at_random(seed: u64, splats: &mut Splats, n_bound: usize) {
    const NODES: usize = 9;
    let mut rng = CounterRng::new(seed, 0xb1d5, 0);
    let mut between = |low: f32, high: f32| low + (high - low) * rng.uniform() as f32;
    let first = splats.n_static();
    let mut windows = Vec::new();
    for keys in [vec![0.0, 1.0, 2.0, 3.0], vec![3.0, 4.0, 5.5, 7.0]] {
        let anchors: Vec<[f32; 3]> = (0..NODES)
            .map(|node| {
                let near = first + node * n_bound / NODES;
                [0, 1, 2].map(|k| splats.column(Column::Mean, k)[near] + between(-0.1, 0.1))
            })
            .collect();
        let mut poses = Vec::new();
        for _ in &keys {
            for anchor in &anchors {
                let q = [
                    1.0,
                    between(-0.2, 0.2),
                    between(-0.2, 0.2),
                    between(-0.2, 0.2),
                ];
                // some on the other side
                let length = q.iter().map(|v| v * v).sum::<f32>().sqrt()
                    * if between(0.0, 1.0) < 0.3 { -1.0 } else { 1.0 };
                poses.push(Pose {
                    position: anchor.map(|v| v + between(-0.2, 0.2)),
                    rotation: q.map(|v| v / length),
                });
            }
        }
        windows.extend(Window::new(keys, anchors, poses));
    }
    let bindings: Vec<Binding> = (0..n_bound)
        .map(|i| {
            let begin = if i % 5 == 0 {
                f32::NEG_INFINITY
            } else {
                between(-1.0, 4.0)
            };
            let end = if i % 7 == 0 {
                f32::INFINITY
            } else {
                begin.max(0.0) + between(0.5, 4.0)
            };
            Binding {
                window: (i % 2) as u32,
                nodes: [0, 2, 3, 5].map(|k| ((i + k) % NODES) as u16),
                weights: [0.4, 0.3, 0.2, 0.1],
                life: [begin, end],
            }
        })
        .collect();
    for (i, binding) in bindings.iter().enumerate() {
        splats.column_mut(Column::TimeMean, 0)[i] = binding.life[0].max(0.0).round();
        for k in 0..3 {
            splats.column_mut(Column::Trend, k)[i] = between(-0.1, 0.1);
        }
    }
    let bound = splats.bind(Arc::new(windows), bindings);
    assert!(bound.is_ok(), "{bound:?}");
}

/// A scene of these splats with a black background and without cameras, duration or Mip filter.
pub fn bare_scene(splats: Splats, time_frames: usize) -> Scene {
    Scene {
        splats,
        background: [0.0; 3],
        time_frames,
        duration_s: None,
        mip: false,
        near: 0.01,
        source: Vec::new(),
    }
}

/// A clip of random splats with a camera a frame that walks past, for what writes and reads scenes:
/// none of its facts is a default. Images of 64 x 48 pixels, `spec.time_frames` of them in 1.25
/// seconds, Mip filter.
pub fn random_scene(spec: &SceneSpec) -> Scene {
    let frame = |i: usize| SourceFrame {
        camera: camera_looking_at(
            Intrinsics::centred(64, 48, 50.0),
            [0.1 * i as f64, -0.2, -3.0],
            [0.0, 0.1, 1.0],
        ),
        t: i as f64,
        exposure: Exposure::IDENTITY,
        distance_sigma: None,
    };
    Scene {
        splats: random_splats(5, &random_camera(3, 64, 48), spec),
        background: [0.1, 0.25, 0.7],
        time_frames: spec.time_frames,
        duration_s: Some(1.25),
        mip: true,
        near: 0.02,
        source: (0..spec.time_frames).map(frame).collect(),
    }
}

/// Frames between the keys of the windows of [`bound_scene`].
const GAP: f32 = 1.0;
/// Nodes of each of its windows.
const NODES: usize = 6;

/// [`random_scene`] whose first half of the dynamic splats is bound to nodes that drift and turn:
/// in two windows that share the clip, each splat for some frames around the middle of its life,
/// some from before the clip until after it.
pub fn bound_scene(spec: &SceneSpec) -> Scene {
    let mut scene = random_scene(spec);
    let last = spec.time_frames.saturating_sub(1) as f32;
    let window = |start: f32, seed: u64| {
        let mut rng = CounterRng::new(9, 0xb0_0d, seed);
        let keys: Vec<f32> = (0..)
            .map(|k| start + GAP * k as f32)
            .take_while(|&t| t <= start + 0.5 * last)
            .collect();
        let mut between = |low: f64, high: f64| low + (high - low) * rng.uniform();
        let anchors: Vec<[f32; 3]> = (0..NODES)
            .map(|_| std::array::from_fn(|_| between(-1.0, 1.0) as f32))
            .collect();
        let ways: Vec<[f32; 4]> = anchors
            .iter()
            .map(|_| std::array::from_fn(|_| between(-0.1, 0.1) as f32))
            .collect();
        let pose = |key: &f32, node: usize| {
            let (dt, way) = (key - start, ways[node]);
            let position =
                std::array::from_fn(|k| anchors[node][k] + way[k] * dt * (1.0 + 0.1 * dt));
            let (sin, cos) = (0.5 * dt * way[3]).sin_cos();
            Pose {
                position,
                rotation: [cos, 0.6 * sin, 0.0, 0.8 * sin],
            }
        };
        let poses = keys
            .iter()
            .flat_map(|key| (0..NODES).map(move |node| (key, node)));
        let poses: Vec<Pose> = poses.map(|(key, node)| pose(key, node)).collect();
        Window::new(keys, anchors, poses).unwrap_or_else(|e| panic!("a window: {e}"))
    };
    let windows = vec![window(0.0, 0), window(0.5 * last, 1)];
    let splats = &mut scene.splats;
    let bindings: Vec<Binding> = (0..splats.n_dynamic() / 2)
        .map(|i| {
            let middle = splats.column(Column::TimeMean, 0)[i];
            let whole = i % 5 == 0;
            Binding {
                window: u32::from(middle > 0.5 * last),
                nodes: [0, 1, 2, 4].map(|k| ((i + k) % NODES) as u16),
                weights: [0.5, 0.25, 0.125, 0.125],
                life: [
                    if whole {
                        f32::NEG_INFINITY
                    } else {
                        middle - 2.0
                    },
                    if whole { f32::INFINITY } else { middle + 1.5 },
                ],
            }
        })
        .collect();
    for i in 0..bindings.len() {
        for k in 0..3 {
            splats.column_mut(Column::Trend, k)[i] = 0.01 * (k as f32 - 1.0) * (i % 7) as f32;
        }
    }
    splats
        .bind(Arc::new(windows), bindings)
        .unwrap_or_else(|e| panic!("bindings: {e}"));
    scene
}

/// A wall, a ball that crosses in front of it, and a camera that drifts.
#[derive(Debug, Clone)]
pub struct MovingScene {
    /// The wall (static rows) and the ball (dynamic rows).
    pub splats: Splats,
    /// One per frame; frame `i` is at `t = i`.
    pub cameras: Vec<Camera>,
    /// Of the ball, world units per frame.
    pub velocity: [f32; 3],
    /// Of the ball at `t = 0`.
    pub start: [f32; 3],
    /// Of the ball, world units.
    pub radius: f32,
}

/// A scene of `frames` frames: a patterned wall at depth 4 behind a ball of radius 0.4 at depth 2.5
/// that moves 1.2 units to the right while the camera moves 0.3 to the left.
pub fn moving_scene(intrinsics: Intrinsics, frames: usize) -> MovingScene {
    const WALL: usize = 24;
    const BALL: usize = 60;
    let layout = SplatLayout {
        isotropic: true,
        sh_degree: 0,
        time_degree: 0,
    };
    let last = frames.saturating_sub(1).max(1) as f32;
    let (start, velocity, radius) = ([-0.6, 0.1, 2.5], [1.2 / last, 0.0, 0.0], 0.4f32);
    let mut splats = Splats::zeros(layout, WALL * WALL, BALL);
    let mut put = |row: usize, mean: [f32; 3], sd: f32, logit: f32, rgb: [f32; 3]| {
        for k in 0..3 {
            splats.column_mut(Column::Mean, k)[row] = mean[k];
            splats.column_mut(Column::Colour, k)[row] = (rgb[k] - 0.5) / 0.282_094_8;
        }
        splats.column_mut(Column::LogScale, 0)[row] = sd.ln();
        splats.column_mut(Column::Opacity, 0)[row] = logit;
    };
    let spacing = 6.0 / WALL as f32;
    for row in 0..WALL * WALL {
        let (i, j) = ((row % WALL) as f32, (row / WALL) as f32);
        let mean = [(i + 0.5) * spacing - 3.0, (j + 0.5) * spacing - 3.0, 4.0];
        let rgb = [
            0.5 + 0.4 * (1.3 * i).sin(),
            0.5 + 0.4 * (0.9 * j + 1.0).sin(),
            0.5 + 0.4 * (0.7 * (i + j)).cos(),
        ];
        put(row, mean, 0.7 * spacing, 3.0, rgb);
    }
    for k in 0..BALL {
        // a Fibonacci sphere: even spacing without chance
        let y = 1.0 - 2.0 * (k as f32 + 0.5) / BALL as f32;
        let (ring, angle) = ((1.0 - y * y).sqrt(), 2.399_963 * k as f32);
        let unit = [ring * angle.cos(), y, ring * angle.sin()];
        let mean = std::array::from_fn(|a| start[a] + radius * unit[a] + velocity[a] * 0.5 * last);
        let rgb = [0.85, 0.45 + 0.35 * unit[0], 0.15 + 0.1 * unit[1]];
        put(WALL * WALL + k, mean, 0.12, 3.0, rgb);
    }
    splats.column_mut(Column::TimeMean, 0).fill(0.5 * last);
    // long enough to be there in every frame
    splats
        .column_mut(Column::LogTimeSd, 0)
        .fill((10.0 * last).ln());
    for k in 0..3 {
        splats.column_mut(Column::Velocity, k).fill(velocity[k]);
    }
    let cameras = (0..frames)
        .map(|i| {
            let x = 0.15 - 0.3 * i as f64 / f64::from(last);
            camera_looking_at(intrinsics, [x, 0.0, 0.0], [0.0, 0.0, 3.5])
        })
        .collect();
    MovingScene {
        splats,
        cameras,
        velocity,
        start,
        radius,
    }
}
