use super::{FADE, Posed};
use crate::{
    Gradients,
    pose::reference::{self, Carried, Node, Splat},
};
use m4_core::{
    Binding, Column, CounterRng, Pose, SplatLayout, Splats, Window,
    nalgebra::{Vector3, Vector4},
};
use std::sync::Arc;

const BOUND: usize = 60;
const NODES: usize = 7;

/// Two static splats, bound ones in two windows, and a dynamic one.
fn scene(rng: &mut CounterRng) -> Splats {
    let mut window = |start: f32| {
        let keys: Vec<f32> = (0..5).map(|k| start + k as f32).collect();
        let mut numbers = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.normal() as f32).collect() };
        let anchors = (0..NODES).map(|_| numbers(3).try_into().unwrap()).collect();
        let poses = (0..5 * NODES).map(|_| {
            let q = Vector4::from_vec(numbers(4)).normalize();
            Pose {
                position: numbers(3).try_into().unwrap(),
                rotation: q.into(),
            }
        });
        Window::new(keys, anchors, poses.collect()).unwrap()
    };
    let windows = vec![window(0.0), window(5.0)];
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 1,
        time_degree: 0,
    };
    let mut splats = Splats::zeros(layout, 2, BOUND + 1);
    splats
        .columns_mut()
        .for_each(|column| column.fill_with(|| rng.normal() as f32));
    splats
        .column_mut(Column::TimeMean, 0)
        .fill_with(|| (10.0 * rng.uniform()) as f32);
    let bindings = (0..BOUND).map(|i| {
        let begin = (8.0 * rng.uniform()) as f32;
        Binding {
            window: (i % 2) as u32,
            nodes: [0, 1, 2, 3].map(|k| ((i + 2 * k) % NODES) as u16),
            weights: [0.4, 0.3, 0.2, 0.1],
            life: [begin, begin + 3.0],
        }
    });
    splats.bind(Arc::new(windows), bindings.collect()).unwrap();
    splats
}

fn of_reference(splats: &Splats, i: usize, t: f32) -> (Vec<Node<f64>>, Splat<f64>, f64, f64) {
    let binding = &splats.bindings()[i];
    let window = &splats.windows()[binding.window as usize];
    let wide = |v: [f32; 3]| Vector3::from(v.map(f64::from));
    let nodes = binding
        .nodes
        .iter()
        .zip(binding.weights)
        .map(|(&node, weight)| {
            let pose = window.pose(usize::from(node), t);
            Node {
                anchor: wide(window.anchors()[usize::from(node)]),
                position: wide(pose.position),
                rotation: Vector4::from(pose.rotation.map(f64::from)),
                weight: f64::from(weight),
            }
        });
    let row = splats.n_static() + i;
    let get = |column, k, at: usize| f64::from(splats.column(column, k)[at]);
    let three = |column, at: usize| Vector3::from_fn(|k, _| get(column, k, at));
    let splat = Splat {
        mean: three(Column::Mean, row),
        velocity: three(Column::Velocity, i),
        quat: Vector4::from_fn(|k, _| get(Column::Quat, k, row)),
        logit: get(Column::Opacity, 0, row),
        rgb: three(Column::Colour, row),
        trend: three(Column::Trend, i),
    };
    let presence = reference::presence(
        f64::from(t),
        binding.life.map(f64::from),
        f64::from(FADE) * f64::from(window.gap()),
    );
    (
        nodes.collect(),
        splat,
        f64::from(t) - get(Column::TimeMean, 0, i),
        presence,
    )
}

#[test]
fn the_fast_version_agrees_with_the_reference() {
    let mut rng = CounterRng::new(8, 0, 0);
    let splats = scene(&mut rng);
    let layout = splats.layout();
    let close = |got: f32, want: f64, what: &str| {
        assert!(
            (f64::from(got) - want).abs() < 2e-4 * (1.0 + want.abs()),
            "{what}: {got} for {want}"
        );
    };
    let mut alive = 0;
    for t in [3.0f32, 4.5, 6.0] {
        let mut posed = Posed::default();
        posed.pose(&splats, t);
        let mut gradients = Gradients::default();
        gradients.reset(&splats);
        gradients
            .columns
            .iter_mut()
            .for_each(|column| column.fill_with(|| rng.normal() as f32));
        gradients.touched[splats.bound()].fill(1);
        let upstream = gradients.clone();
        posed.backward(&splats, &mut gradients);
        let mut nodes = vec![vec![[0.0f64; 6]; NODES]; 2];
        for i in 0..BOUND {
            let row = splats.n_static() + i;
            let (carriers, splat, dt, presence) = of_reference(&splats, i, t);
            if presence < 2e-3 {
                assert!(posed.opacity[row] < -20.0 || presence > 5e-4);
                continue;
            }
            alive += 1;
            let want = reference::carry(&carriers, &splat, dt, presence);
            let get = |column, k: usize, at: usize| {
                f64::from(upstream.columns[layout.column(column) + k][at])
            };
            let g = Carried {
                mean: Vector3::from_fn(|k, _| get(Column::Mean, k, row)),
                quat: Vector4::from_fn(|k, _| get(Column::Quat, k, row)),
                logit: get(Column::Opacity, 0, row),
                rgb: Vector3::from_fn(|k, _| get(Column::Colour, k, row)),
            };
            let back = reference::backward(&carriers, &splat, dt, presence, &g);
            let got =
                |column, k: usize, at: usize| gradients.columns[layout.column(column) + k][at];
            for k in 0..3 {
                close(posed.mean[k][row], want.mean[k], "mean");
                close(posed.colour[k][row], want.rgb[k], "colour");
                close(
                    got(Column::Mean, k, row),
                    back.splat.mean[k],
                    "gradient of the mean",
                );
                close(
                    got(Column::Velocity, k, i),
                    back.splat.velocity[k],
                    "gradient of the velocity",
                );
                close(
                    got(Column::Trend, k, i),
                    back.splat.trend[k],
                    "gradient of the trend",
                );
                close(
                    got(Column::Colour, k, row),
                    back.splat.rgb[k],
                    "gradient of the colour",
                );
            }
            for k in 0..4 {
                close(posed.quat[k][row], want.quat[k], "quaternion");
                close(
                    got(Column::Quat, k, row),
                    back.splat.quat[k],
                    "gradient of the quaternion",
                );
            }
            close(posed.opacity[row], want.logit, "opacity");
            close(
                got(Column::Opacity, 0, row),
                back.splat.logit,
                "gradient of the opacity",
            );
            let binding = &splats.bindings()[i];
            for (&node, [place, turn]) in binding.nodes.iter().zip(&back.nodes) {
                let sum = &mut nodes[binding.window as usize][usize::from(node)];
                (0..3).for_each(|k| sum[k] += place[k]);
                (0..3).for_each(|k| sum[3 + k] += turn[k]);
            }
        }
        for gradient in &gradients.nodes {
            for (got, want) in gradient
                .nodes
                .iter()
                .flatten()
                .zip(nodes[gradient.window].iter().flatten())
            {
                close(*got, *want, "gradient of a node");
            }
        }
        assert_eq!(gradients.nodes.len(), usize::from(t.fract() == 0.0));
    }
    assert!(alive > BOUND / 2, "{alive}");
}
