//! Bound splats through the payload.

use crate::turning::{DISTANCE, FRAMES, turning};
use m4_core::{
    Column, Scene, SplatLayout, Splats,
    nalgebra::{Vector3, Vector4},
};
use m4_kernels::pose::{
    FADE, LEAST_PRESENCE,
    reference::{self, Carried, Node, Splat},
};
use m4_viewer::payload::{
    HEADER_BYTES, Payload, PayloadError, VERSION, VERSION_BOUND, bytes_per_bound_splat,
    bytes_per_splat, decode, encode,
};

const LAYOUT: SplatLayout = SplatLayout {
    isotropic: false,
    sh_degree: 1,
    time_degree: 1,
};
const STATIC: usize = 20;
const BOUND: usize = 140;
const FREE: usize = 30;
/// Size of a pixel at the distance of the object, world units.
const PX: f64 = DISTANCE / 140.0;

fn scene() -> Scene {
    turning(LAYOUT, STATIC, BOUND, FREE)
}

/// Bound splat `i` as the definition of the renderer carries it to `t`; `None` where it is not
/// there.
pub fn carried(splats: &Splats, i: usize, t: f64) -> Option<Carried<f64>> {
    let binding = &splats.bindings()[i];
    let window = &splats.windows()[binding.window as usize];
    // far beyond its keys a window carries nothing
    let (keys, far) = (window.keys(), f64::from((1.0 + 2.0 * FADE) * window.gap()));
    if t < f64::from(keys[0]) - far || t > f64::from(keys[keys.len() - 1]) + far {
        return None;
    }
    let wide = |v: [f32; 3]| Vector3::from(v.map(f64::from));
    let nodes: Vec<Node<f64>> = binding
        .nodes
        .iter()
        .zip(binding.weights)
        .map(|(&node, weight)| {
            let pose = window.pose(usize::from(node), t as f32);
            Node {
                anchor: wide(window.anchors()[usize::from(node)]),
                position: wide(pose.position),
                rotation: Vector4::from(pose.rotation.map(f64::from)),
                weight: f64::from(weight),
            }
        })
        .collect();
    let row = splats.n_static() + i;
    let get = |column, k, at: usize| f64::from(splats.column(column, k)[at]);
    let quat = match splats.layout().isotropic {
        true => Vector4::new(1.0, 0.0, 0.0, 0.0),
        false => Vector4::from_fn(|k, _| get(Column::Quat, k, row)),
    };
    let splat = Splat {
        mean: Vector3::from_fn(|k, _| get(Column::Mean, k, row)),
        velocity: Vector3::from_fn(|k, _| get(Column::Velocity, k, i)),
        quat,
        logit: get(Column::Opacity, 0, row),
        rgb: Vector3::from_fn(|k, _| get(Column::Colour, k, row)),
        trend: Vector3::from_fn(|k, _| get(Column::Trend, k, i)),
    };
    let presence = share(splats, i, t);
    let dt = t - get(Column::TimeMean, 0, i);
    (presence >= f64::from(LEAST_PRESENCE)).then(|| reference::carry(&nodes, &splat, dt, presence))
}

/// How much of bound splat `i` is there.
fn share(splats: &Splats, i: usize, t: f64) -> f64 {
    let binding = &splats.bindings()[i];
    let gap = splats.windows()[binding.window as usize].gap();
    reference::presence(t, binding.life.map(f64::from), f64::from(FADE * gap))
}

/// The order in which the payload has the bound splats.
fn order(splats: &Splats) -> Vec<usize> {
    let mut order: Vec<usize> = (0..splats.bindings().len()).collect();
    order.sort_by_key(|&i| (splats.bindings()[i].window, splats.bindings()[i].nodes));
    order
}

#[test]
fn a_bound_splat_is_carried_to_the_same_place_after_the_payload() {
    let scene = scene();
    let payload = encode(&scene, DISTANCE);
    assert_eq!(
        (payload.n_static, payload.n_dynamic, payload.n_bound),
        (STATIC, BOUND + FREE, BOUND)
    );
    assert_eq!(
        payload.bytes,
        encode(&scene, DISTANCE).bytes,
        "the same bytes each time"
    );
    let back = decode(&payload.bytes).unwrap();
    let order = order(&scene.splats);
    let get = |column, at: usize| f64::from(scene.splats.column(column, 0)[at]);
    let opacity = |logit: f64| 1.0 / (1.0 + (-logit).exp());
    let mut present = 0;
    for t in [0.0, 0.5, 2.0, 3.25, 4.6, 5.0, 6.9, 8.0, 9.0] {
        for (i, &from) in order.iter().enumerate() {
            let (Some(a), Some(b)) = (carried(&scene.splats, from, t), carried(&back, i, t)) else {
                continue;
            };
            present += 1;
            let off = (a.mean - b.mean).norm() / PX;
            assert!(off < 0.07, "splat {from} at {t}: {off} pixels");
            let turn = a
                .quat
                .normalize()
                .dot(&b.quat.normalize())
                .abs()
                .min(1.0)
                .acos();
            assert!(turn < 0.003, "splat {from} at {t}: {turn} radians");
            // half a step before it fades
            let (own, f) = (
                opacity(get(Column::Opacity, STATIC + from)),
                share(&scene.splats, from, t),
            );
            let faded = |o: f64, f: f64| 1.0 - (1.0 - o.clamp(0.0, 1.0)).powf(f.clamp(0.0, 1.0));
            let range = faded(own - 0.002, f - 0.01)..faded(own + 0.002, f + 0.01);
            assert!(
                range.contains(&opacity(b.logit)),
                "splat {from} at {t}: {} of {range:?}",
                opacity(b.logit)
            );
            // a quarter of a step of eight bits, and a fortieth of the change since birth
            let change = 0.025 * (t - get(Column::TimeMean, from)).abs() * 0.08;
            assert!(
                (a.rgb - b.rgb).amax() < 0.014 + change,
                "splat {from} at {t}: {}",
                (a.rgb - b.rgb).amax()
            );
        }
    }
    assert!(present > 4 * BOUND, "{present}");
    for (i, &from) in order.iter().enumerate() {
        let (a, b) = (&scene.splats.bindings()[from], &back.bindings()[i]);
        assert_eq!((a.window, a.nodes), (b.window, b.nodes));
        assert!((b.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        assert!(
            back.windows()[b.window as usize]
                .key_at(back.column(Column::TimeMean, 0)[i])
                .is_some()
        );
    }
}

/// What is near half a step of a node, which is stated where the layout is described.
#[test]
fn nodes_are_off_by_a_hundredth_of_a_pixel() {
    let scene = scene();
    let back = decode(&encode(&scene, DISTANCE).bytes).unwrap();
    for (a, b) in scene.splats.windows().iter().zip(back.windows().iter()) {
        assert_eq!(a.keys(), b.keys());
        let near =
            |a: &[f32; 3], b: &[f32; 3]| (0..3).all(|k| f64::from((a[k] - b[k]).abs()) < PX / 50.0);
        assert!(a.anchors().iter().zip(b.anchors()).all(|(a, b)| near(a, b)));
        for key in 0..a.keys().len() {
            for (a, b) in a.poses(key).iter().zip(b.poses(key)) {
                assert!(near(&a.position, &b.position));
                let dot = Vector4::from(a.rotation)
                    .dot(&Vector4::from(b.rotation))
                    .abs();
                assert!((1.0 - f64::from(dot)) < 1e-6, "{dot}");
            }
        }
    }
}

fn of_free(scene: &Scene) -> Payload {
    let rows: Vec<u32> = (0..scene.splats.n() as u32)
        .filter(|&r| !scene.splats.bound().contains(&(r as usize)))
        .collect();
    encode(
        &Scene {
            splats: scene.splats.gather(&rows).unwrap(),
            ..scene.clone()
        },
        DISTANCE,
    )
}

#[test]
fn only_scenes_with_bound_splats_have_the_later_version() {
    let scene = scene();
    let (a, b) = bytes_per_splat(LAYOUT);
    let free = of_free(&scene);
    assert_eq!(free.bytes[4..8], VERSION.to_le_bytes());
    assert_eq!(free.bytes.len(), HEADER_BYTES + STATIC * a + FREE * b);
    let payload = encode(&scene, DISTANCE);
    assert_eq!(payload.bytes[4..8], VERSION_BOUND.to_le_bytes());
    let windows: usize = scene
        .splats
        .windows()
        .iter()
        .map(|w| 12 + 4 * w.keys().len() + w.anchors().len() * (9 + 16 * w.keys().len()))
        .sum();
    let c = bytes_per_bound_splat(LAYOUT);
    assert_eq!(
        payload.bytes.len(),
        HEADER_BYTES + 56 + windows + STATIC * a + BOUND * c + FREE * b
    );
    // free splats are those of the scene without bound ones, row by row
    let (all, alone) = (
        decode(&payload.bytes).unwrap(),
        decode(&free.bytes).unwrap(),
    );
    let last =
        |splats: &Splats| splats.column(Column::TimeMean, 0)[splats.n_dynamic() - FREE..].to_vec();
    assert_eq!(last(&all), last(&alone));
}

#[test]
fn bound_splats_that_no_frame_shows_are_left_out() {
    let mut scene = scene();
    let (windows, mut bindings) = (
        scene.splats.windows().clone(),
        scene.splats.bindings().to_vec(),
    );
    bindings[0].life = [f32::NEG_INFINITY, -1.0];
    bindings[1].life = [20.0, f32::INFINITY];
    bindings[2].life = [f32::NAN, 4.0];
    bindings[3].weights = [0.0; 4];
    bindings[4].weights[1] = f32::NAN;
    scene.splats.bind(windows, bindings).unwrap();
    scene.splats.column_mut(Column::Trend, 1)[5] = f32::INFINITY;
    scene.splats.column_mut(Column::Opacity, 0)[STATIC + 6] = -6.0;
    // a life of one instant has no length
    scene.splats.column_mut(Column::LogTimeSd, 0)[7] = f32::NEG_INFINITY;
    let payload = encode(&scene, DISTANCE);
    assert_eq!(
        (payload.n_bound, payload.n_dynamic),
        (BOUND - 7, BOUND + FREE - 7)
    );
    let back = decode(&payload.bytes).unwrap();
    assert!(back.is_finite() && back.bindings().len() == BOUND - 7);

    // a window that is no motion carries nothing, and its splats go with it
    scene.splats.windows_mut()[0].poses_mut(0)[0].position[2] = f32::NAN;
    let back = decode(&encode(&scene, DISTANCE).bytes).unwrap();
    assert_eq!(back.windows().len(), 1);
    assert!(back.bindings().iter().all(|b| b.window == 0) && back.windows()[0].keys()[0] == 5.0);
}

#[test]
fn isotropic_splats_and_scenes_without_cameras_are_bound_too() {
    let layout = SplatLayout {
        isotropic: true,
        sh_degree: 0,
        time_degree: 0,
    };
    let mut scene = turning(layout, 0, 30, 0);
    scene.source.clear();
    let back = decode(&encode(&scene, f64::NAN).bytes).unwrap();
    assert_eq!(
        (back.n_static(), back.bindings().len(), back.layout()),
        (0, 30, layout)
    );
    assert_eq!(FRAMES, scene.time_frames);
}

#[test]
fn other_bytes_of_windows_are_errors() {
    let good = encode(&scene(), DISTANCE).bytes;
    let with = |at: usize, bytes: &[u8]| {
        let mut changed = good.clone();
        changed[at..at + bytes.len()].copy_from_slice(bytes);
        decode(&changed).unwrap_err()
    };
    let word = |v: u32| v.to_le_bytes();
    let table = HEADER_BYTES + 56;
    assert!(matches!(with(4, &word(3)), PayloadError::Version(3)));
    assert!(matches!(
        decode(&good[..HEADER_BYTES + 30]),
        Err(PayloadError::Header(_))
    ));
    assert!(matches!(
        with(HEADER_BYTES, &word(1)),
        PayloadError::Bound { bound: 1, .. }
    ));
    assert!(matches!(
        with(HEADER_BYTES + 4, &word(u32::MAX)),
        PayloadError::Header(_)
    ));
    assert!(matches!(
        with(HEADER_BYTES + 8, &f64::NAN.to_le_bytes()),
        PayloadError::Number { index: 14, .. }
    ));
    assert!(matches!(
        with(12, &word(5)),
        PayloadError::Bound { n_dynamic: 5, .. }
    ));
    for k in [4, 8] {
        assert!(
            matches!(
                with(table + k, &word(u32::MAX)),
                PayloadError::Length { .. }
            ),
            "no overflow, no allocation"
        );
    }
    // the planes of what bound splats have alone
    let (a, b) = bytes_per_splat(LAYOUT);
    let first = table + 24 + (STATIC + BOUND + FREE) * a + FREE * (b - a);
    assert!(matches!(
        with(first + 9 * BOUND, &[99]),
        PayloadError::Key {
            splat: 0,
            key: 99,
            keys: 5
        }
    ));
    assert!(
        matches!(with(first + 15 * BOUND, &[77]), PayloadError::Windows(_)),
        "a node that is not there"
    );
    assert!(matches!(
        with(first + 23 * BOUND, &[255, 255]),
        PayloadError::Weights { splat: 0 | 1 }
    ));
    let windows = first + 26 * BOUND;
    assert!(matches!(
        with(windows, &f32::INFINITY.to_le_bytes()),
        PayloadError::Time { index: 0, .. }
    ));
    assert!(
        matches!(
            with(windows, &2.0f32.to_le_bytes()),
            PayloadError::Windows(_)
        ),
        "keys rise"
    );
    let places = 9 * 9 * (6 + 5);
    assert!(matches!(
        with(windows + 4 * 9 + places, &[4]),
        PayloadError::Turn {
            pose: 0,
            component: 4
        }
    ));
}
