//! The whole reference chain: gradients against differences, and what it must leave alone.

use m4_core::{
    Camera, Column, CounterRng, Intrinsics, SplatLayout, Splats,
    nalgebra::{Vector3, Vector4, Vector6},
};
use m4_kernels::{
    View,
    ellipse::reference::{CHANNELS, Cutoff, Hard, Smooth},
    reference::{Geometry, Setup, Splat, backward, render, splats_of},
    slice::reference::{Gaussian, Life, Shape},
};
use m4_testkit::{
    SceneSpec, Side, assert_gradient, camera_looking_at, central_differences, random_camera,
    random_splats,
};
use std::hash::{DefaultHasher, Hash, Hasher};

fn view(camera: Camera, mip: bool) -> View {
    View {
        camera,
        t: 4.3,
        background: [0.2, 0.4, 0.1],
        near: 0.2,
        mip,
        period: 9.0,
        with_depth: true,
    }
}

fn weights(seed: u64, pixels: usize) -> Vec<[f64; CHANNELS]> {
    let mut rng = CounterRng::new(seed, 2, 0);
    (0..pixels)
        .map(|_| std::array::from_fn(|_| 2.0 * rng.uniform() - 1.0))
        .collect()
}

/// `like` with other numbers, in the order of [`Splat::parameters`].
fn rebuild(like: &Splat<f64>, values: &[f64]) -> Splat<f64> {
    let Geometry::Gaussian(old) = &like.geometry else {
        panic!("only the velocity form has columns")
    };
    let mut values = values.iter().copied();
    let mut next = || values.next().expect("as many numbers as parameters");
    let mut vector = || Vector3::from_fn(|_, _| next());
    let mean = vector();
    let shape = match old.shape {
        Shape::Isotropic { .. } => Shape::Isotropic { log_scale: next() },
        Shape::Anisotropic { .. } => Shape::Anisotropic {
            log_scale: vector(),
            quat: Vector4::from_fn(|_, _| next()),
        },
    };
    let opacity = next();
    let coefficients = like
        .coefficients
        .iter()
        .map(|_| std::array::from_fn(|_| next()))
        .collect();
    let life = old.life.map(|_| Life {
        time_mean: next(),
        log_time_sd: next(),
        velocity: Vector3::from_fn(|_, _| next()),
    });
    Splat {
        geometry: Geometry::Gaussian(Gaussian { mean, shape, life }),
        opacity,
        coefficients,
        sh_terms: like.sh_terms,
    }
}

/// The weighted sum of all channels, and every discrete decision on the way.
fn side<C: Cutoff>(splats: &[Splat<f64>], setup: &Setup<f64>, weights: &[[f64; CHANNELS]]) -> Side {
    let rendered = render::<f64, C>(splats, setup);
    let mut hash = DefaultHasher::new();
    rendered.rows.hash(&mut hash);
    for e in &rendered.ellipses {
        e.channels.map(|c| c > 0.0).hash(&mut hash);
    }
    let values = rendered
        .image
        .pixels
        .iter()
        .flatten()
        .zip(weights.as_flattened());
    Side {
        value: values.map(|(v, w)| v * w).sum(),
        decisions: hash.finish(),
    }
}

/// Every gradient of a scene against differences; returns how many splats are in the image.
fn check_scene(name: &str, splats: &Splats, view: &View) -> usize {
    let (splats, setup) = (splats_of::<f64>(splats), Setup::<f64>::new(view));
    let weights = weights(3, setup.width * setup.height);
    let rendered = render::<f64, Smooth>(&splats, &setup);
    let g = backward::<f64, Smooth>(&splats, &setup, &rendered, &weights);

    // each parameter over all splats, on its own scale
    let x: Vec<Vec<f64>> = splats.iter().map(Splat::parameters).collect();
    let (mut got, mut want) = (vec![Vec::new(); 512], vec![Vec::new(); 512]);
    let mut jumps = 0;
    for (row, x) in x.iter().enumerate() {
        let mut scene = splats.clone();
        let d = central_differences(x, 1e-6, |x| {
            scene[row] = rebuild(&splats[row], x);
            side::<Smooth>(&scene, &setup, &weights)
        });
        let own = g.splats[row].parameters();
        jumps += d.jumps.len();
        for k in (0..x.len()).filter(|k| !d.jumps.contains(k)) {
            got[k].push(own[k]);
            want[k].push(d.gradient[k]);
        }
    }
    assert!(
        jumps * 100 <= x.iter().map(Vec::len).sum(),
        "{name}: {jumps} jumps"
    );
    for (k, (got, want)) in got.iter().zip(&want).enumerate() {
        assert_gradient(&format!("{name}: column {k}"), got, want, 1e-5);
    }

    let camera = |x: &[f64]| {
        let mut setup = setup;
        setup.camera.w2c = setup
            .camera
            .w2c
            .retract(&Vector6::from_column_slice(&x[..6]));
        setup.camera.intrinsics = Vector4::from_column_slice(&x[6..10]);
        setup.background = [x[10], x[11], x[12]];
        setup
    };
    let mut x = vec![0.0; 6];
    x.extend(setup.camera.intrinsics.iter());
    x.extend(setup.background);
    let want = central_differences(&x, 1e-6, |x| side::<Smooth>(&splats, &camera(x), &weights));
    assert!(want.jumps.is_empty(), "{name}: camera");
    let mut own: Vec<f64> = g
        .camera
        .tau
        .iter()
        .chain(g.camera.omega.iter())
        .copied()
        .collect();
    own.extend(g.camera.intrinsics.iter().chain(&g.background));
    for (part, range) in [
        ("tau", 0..3),
        ("omega", 3..6),
        ("intrinsics", 6..10),
        ("background", 10..13),
    ] {
        let want = &want.gradient[range.clone()];
        assert_gradient(&format!("{name}: {part}"), &own[range], want, 1e-5);
    }
    rendered.rows.len()
}

fn layout(isotropic: bool, sh_degree: usize, time_degree: usize) -> SplatLayout {
    SplatLayout {
        isotropic,
        sh_degree,
        time_degree,
    }
}

#[test]
fn fuzzed_cameras_and_layouts() {
    let sizes = [(17, 11), (9, 20), (16, 16), (1, 7)];
    let layouts = [
        layout(false, 3, 2),
        layout(true, 0, 0),
        layout(false, 1, 1),
        layout(false, 0, 2),
    ];
    for (seed, ((width, height), layout)) in sizes.into_iter().zip(layouts).enumerate() {
        for mip in [false, true] {
            let camera = random_camera(seed as u64, width, height);
            let spec = SceneSpec {
                layout,
                n_static: 4,
                n_dynamic: 6,
                ..SceneSpec::default()
            };
            let splats = random_splats(seed as u64, &camera, &spec);
            let drawn = check_scene(
                &format!("scene {seed}, mip {mip}"),
                &splats,
                &view(camera, mip),
            );
            assert!(drawn >= 5, "scene {seed}: only {drawn} splats in the image");
        }
    }
}

/// Puts splat `row` at camera coordinates `p` of a camera at the origin.
fn place(splats: &mut Splats, row: usize, p: [f32; 3], log_scale: f32, logit: f32) {
    for k in 0..3 {
        splats.column_mut(Column::Mean, k)[row] = p[k];
    }
    for k in 0..splats.layout().range(Column::LogScale).len() {
        splats.column_mut(Column::LogScale, k)[row] = log_scale + 0.2 * k as f32;
    }
    for k in 0..splats.layout().range(Column::Quat).len() {
        splats.column_mut(Column::Quat, k)[row] = [0.9, 0.1, -0.3, 0.2][k];
    }
    splats.column_mut(Column::Opacity, 0)[row] = logit;
}

fn front_camera(width: usize, height: usize) -> Camera {
    camera_looking_at(
        Intrinsics::centred(width, height, 14.0),
        [0.0; 3],
        [0.0, 0.0, 1.0],
    )
}

#[test]
fn splats_at_the_near_plane() {
    let mut splats = Splats::zeros(layout(false, 0, 0), 4, 0);
    place(&mut splats, 0, [0.02, 0.01, 0.21], -3.0, 0.5);
    // far outside the image at a shallow depth: past the clamp of the Jacobian, still visible
    place(&mut splats, 1, [-0.45, 0.1, 0.3], -2.0, 1.0);
    place(&mut splats, 2, [0.1, 0.5, 0.35], -2.0, 1.0);
    place(&mut splats, 3, [0.0, 0.0, 3.0], -1.5, 0.0);
    assert_eq!(
        check_scene("near plane", &splats, &view(front_camera(15, 12), false)),
        4
    );
    // not above the near plane: out
    place(&mut splats, 0, [0.02, 0.01, 0.2], -3.0, 0.5);
    let rendered = render::<f64, Hard>(
        &splats_of(&splats),
        &Setup::new(&view(front_camera(15, 12), false)),
    );
    assert!(!rendered.rows.contains(&0));
}

#[test]
fn behind_an_opaque_stack_there_is_exactly_nothing() {
    let mut splats = Splats::zeros(layout(false, 0, 0), 7, 0);
    for row in 0..6 {
        place(
            &mut splats,
            row,
            [0.0, 0.0, 1.0 + 0.1 * row as f32],
            1.5,
            8.0,
        );
    }
    place(&mut splats, 6, [0.0, 0.0, 5.0], -1.0, 3.0);
    let (splats, setup) = (
        splats_of::<f64>(&splats),
        Setup::new(&view(front_camera(10, 10), false)),
    );
    let rendered = render::<f64, Hard>(&splats, &setup);
    assert!(rendered.rows.contains(&6));
    let g = backward::<f64, Hard>(&splats, &setup, &rendered, &weights(3, 100));
    assert!(g.touched[0] && !g.touched[6]);
    assert!(g.splats[6].parameters().iter().all(|&v| v == 0.0));
    assert!(g.splats[0].parameters().iter().any(|&v| v != 0.0));
    // the pixels stop before their transmittance falls under the bound
    assert!(
        rendered
            .image
            .transmittance
            .iter()
            .all(|&t| (1e-4..1.0).contains(&t))
    );
}

#[test]
fn one_splat_has_a_closed_form() {
    // isotropic, on the axis: V = (f s / z)^2 + 0.3
    let mut splats = Splats::zeros(layout(true, 0, 0), 1, 0);
    place(&mut splats, 0, [0.0, 0.0, 2.0], 0.3f32.ln(), 0.4);
    let view = view(front_camera(9, 9), false);
    let rendered = render::<f64, Hard>(&splats_of(&splats), &Setup::new(&view));
    let log_scale = f64::from(splats.column(Column::LogScale, 0)[0]);
    let variance = (14.0 * log_scale.exp() / 2.0).powi(2) + 0.3;
    let opacity = 1.0 / (1.0 + (-f64::from(0.4f32)).exp());
    for (i, pixel) in rendered.image.pixels.iter().enumerate() {
        let (dx, dy) = ((i % 9) as f64 - 4.0, (i / 9) as f64 - 4.0);
        let alpha = opacity * (-(dx * dx + dy * dy) / (2.0 * variance)).exp();
        let background = f64::from(view.background[0]);
        assert!(
            alpha > 1.0 / 255.0 && (pixel[4] - alpha).abs() < 1e-12,
            "pixel {i}"
        );
        assert!((pixel[0] - (0.5 * alpha + background * (1.0 - alpha))).abs() < 1e-12);
        assert!((pixel[3] - 2.0 * alpha).abs() < 1e-12);
    }
}

#[test]
fn a_splat_moves_with_its_velocity_and_fades_with_its_life() {
    let mut splats = Splats::zeros(layout(false, 0, 0), 0, 1);
    place(&mut splats, 0, [0.0, 0.0, 2.0], -2.0, 3.0);
    splats.column_mut(Column::TimeMean, 0)[0] = 4.0;
    splats.column_mut(Column::LogTimeSd, 0)[0] = 2.0f32.ln();
    splats.column_mut(Column::Velocity, 0)[0] = 0.1;
    let at = |t: f64| {
        let mut view = view(front_camera(20, 10), false);
        view.t = t;
        render::<f64, Hard>(&splats_of(&splats), &Setup::new(&view))
    };
    let (peak, later) = (at(4.0), at(6.0));
    let shift = later.ellipses[0].centre.x - peak.ellipses[0].centre.x;
    assert!(
        (shift - 14.0 * f64::from(0.1f32) * 2.0 / 2.0).abs() < 1e-9,
        "{shift}"
    );
    let fade = later.ellipses[0].opacity / peak.ellipses[0].opacity;
    assert!((fade - (-0.5f64).exp()).abs() < 1e-6, "{fade}");
    // 2.448 standard deviations from the middle the marginal is 0.05
    assert_eq!(at(4.0 + 2.0 * 2.447).rows.len(), 1);
    assert_eq!(at(4.0 + 2.0 * 2.449).rows.len(), 0);
}
