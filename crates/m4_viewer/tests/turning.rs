//! A scene with bound splats, for the tests of the payload and of the page.

use m4_core::{
    Binding, Column, CounterRng, Exposure, Intrinsics, Pose, Scene, SourceFrame, SplatLayout,
    Window,
    nalgebra::{UnitQuaternion, Vector3},
};
use m4_testkit::{SceneSpec, camera_looking_at, random_splats};
use std::sync::Arc;

pub const FRAMES: usize = 10;
/// Of the middle of the object that turns.
pub const DISTANCE: f64 = 4.0;
const NODES: usize = 9;
/// Radians a frame.
const TURN: f32 = 0.25;

/// Keys of the windows, frames; the gaps of the second are unequal.
const KEYS: [&[f32]; 2] = [&[0.0, 1.0, 2.0, 3.0, 4.0], &[5.0, 6.0, 7.5, 9.0]];

/// Splats that stay, splats of an object that turns about an axis while it goes aside, in two
/// windows, and splats that come and go.
pub fn turning(layout: SplatLayout, n_static: usize, n_bound: usize, n_free: usize) -> Scene {
    let camera = camera_looking_at(
        Intrinsics::centred(160, 120, 140.0),
        [0.1, 0.0, 0.0],
        [0.0, 0.0, DISTANCE],
    );
    let spec = SceneSpec {
        layout,
        n_static,
        n_dynamic: n_bound + n_free,
        time_frames: FRAMES,
        sd_px: [0.7, 5.0],
        logit: [-2.0, 4.0],
    };
    let mut splats = random_splats(3, &camera, &spec);
    let mut rng = CounterRng::new(17, 0, 0);
    let windows: Vec<Window> = KEYS.iter().map(|keys| window(keys, &mut rng)).collect();
    let mut bindings = Vec::new();
    for i in 0..n_bound {
        let index = i % 2;
        let (window, mut between) = (&windows[index], |low: f64, high: f64| {
            low + (high - low) * rng.uniform()
        });
        let keys = window.keys();
        let own: [f32; 3] = std::array::from_fn(|k| (middle(keys)[k] + between(-0.9, 0.9)) as f32);
        let born = between(0.0, keys.len() as f64) as usize;
        // some were born between two keys
        let time_mean = keys[born] + if i % 5 == 0 { 0.3 } else { 0.0 };
        let length = between(0.5, 3.5) as f32;
        let life = match i % 7 {
            0 => [f32::NEG_INFINITY, f32::INFINITY],
            1 => [keys[born] - length, f32::INFINITY],
            2 => [f32::NEG_INFINITY, keys[born] + length],
            _ => [keys[born] - length, keys[born] + length],
        };
        let (nodes, weights) = nearest(window, &own);
        bindings.push(Binding {
            window: index as u32,
            nodes,
            weights,
            life,
        });
        for k in 0..3 {
            splats.column_mut(Column::Mean, k)[n_static + i] = own[k];
            splats.column_mut(Column::Velocity, k)[i] = between(-0.01, 0.01) as f32;
            splats.column_mut(Column::Trend, k)[i] = between(-0.08, 0.08) as f32;
        }
        splats.column_mut(Column::TimeMean, 0)[i] = time_mean;
        splats.column_mut(Column::LogTimeSd, 0)[i] = length.ln();
    }
    splats.bind(Arc::new(windows), bindings).unwrap();
    let source = (0..FRAMES).map(|i| SourceFrame {
        camera,
        t: i as f64,
        exposure: Exposure::IDENTITY,
        distance_sigma: None,
    });
    Scene {
        splats,
        background: [0.1, 0.2, 0.3],
        time_frames: FRAMES,
        duration_s: Some(1.0),
        mip: true,
        near: 0.2,
        source: source.collect(),
    }
}

/// The object's middle when it has not moved.
fn middle(keys: &[f32]) -> [f64; 3] {
    [0.08 * f64::from(keys[keys.len() / 2]) - 0.4, 0.1, DISTANCE]
}

fn window(keys: &[f32], rng: &mut CounterRng) -> Window {
    let mut number = |size: f64| (size * (2.0 * rng.uniform() - 1.0)) as f32;
    let still = keys[keys.len() / 2];
    let centre = Vector3::from(middle(keys).map(|v| v as f32));
    let anchors: Vec<[f32; 3]> = (0..NODES)
        .map(|_| [0, 1, 2].map(|k| centre[k] + number(1.0)))
        .collect();
    let mut poses = Vec::new();
    for key in keys {
        for anchor in &anchors {
            let turn = Vector3::new(0.2, 1.0, 0.1).normalize() * (TURN * (key - still));
            let own = Vector3::from_fn(|_, _| number(0.02)) * (key - still).abs().min(1.0);
            let q = UnitQuaternion::from_scaled_axis(turn + own);
            let aside = Vector3::new(0.08, 0.0, 0.02) * (key - still);
            let position = centre + q * (Vector3::from(*anchor) - centre) + aside;
            // either sign is the same rotation
            let sign = if number(1.0) < 0.0 { -1.0 } else { 1.0 };
            let rotation = [q.w, q.i, q.j, q.k].map(|v| sign * v);
            poses.push(Pose {
                position: position.into(),
                rotation,
            });
        }
    }
    Window::new(keys.to_vec(), anchors, poses).unwrap()
}

/// The four nodes next to a place, and their weights.
fn nearest(window: &Window, place: &[f32; 3]) -> ([u16; 4], [f32; 4]) {
    let square = |a: &[f32; 3]| (0..3).map(|k| (a[k] - place[k]).powi(2)).sum::<f32>();
    let mut order: Vec<(f32, u16)> = window.anchors().iter().map(square).zip(0..).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let near: [(f32, u16); 4] = std::array::from_fn(|k| order[k]);
    let raw = near.map(|(square, _)| (-2.0 * square).exp());
    (
        near.map(|(_, node)| node),
        raw.map(|w| w / raw.iter().sum::<f32>()),
    )
}
