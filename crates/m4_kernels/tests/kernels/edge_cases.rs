//! The SIMD version on scenes that do not occur in training: nothing to draw, nothing in front,
//! numbers that are none.

use crate::twin::{
    Expected, assert_frame, assert_gradients, compare, every_level, frame_gradient, view,
};
use m4_core::{Camera, Column, CounterRng, Intrinsics, SplatLayout, Splats};
use m4_kernels::{
    Gradients, Renderer, SimdLevel, View,
    adam::cpu::{AdamConfig, AdamState, step},
};
use m4_testkit::{SceneSpec, camera_looking_at, random_camera, random_splats};

const LAYOUT: SplatLayout = SplatLayout {
    isotropic: false,
    sh_degree: 1,
    time_degree: 1,
};

fn front(width: usize, height: usize) -> Camera {
    camera_looking_at(
        Intrinsics::centred(width, height, 30.0),
        [0.0; 3],
        [0.0, 0.0, 1.0],
    )
}

/// Everything finite, nothing touched, the background everywhere.
fn assert_empty(name: &str, level: SimdLevel, splats: &Splats, view: &View) {
    let mut renderer = Renderer::new(level);
    let frame = renderer.render(splats, view).clone();
    for (plane, c) in frame.rgb.iter().zip(view.background) {
        assert!(plane.iter().all(|&v| v == c), "{name}: not the background");
    }
    assert!(frame.transmittance.iter().all(|&t| t == 1.0), "{name}");
    assert!(frame.depth.iter().all(|&z| z == 0.0), "{name}");
    let g = frame_gradient(1, view);
    let mut out = Gradients::default();
    renderer.backward(splats, &g, true, &mut out);
    assert_eq!(out.touched.len(), splats.n(), "{name}");
    assert!(out.touched.iter().all(|&t| t == 0), "{name}");
    assert_eq!(out.camera, m4_kernels::CameraGradient::default(), "{name}");
    for c in 0..3 {
        let want: f64 = g[c].iter().map(|&v| f64::from(v)).sum();
        assert!(
            (f64::from(out.background[c]) - want).abs() < 1e-3 * (1.0 + want.abs()),
            "{name}"
        );
    }
    let mut score = vec![0.0; splats.n()];
    renderer.score(&vec![1.0; frame.transmittance.len()], &mut score);
    assert!(score.iter().all(|&s| s == 0.0), "{name}");
}

#[test]
fn no_splats() {
    every_level(|level| {
        for (width, height) in [(20, 13), (1, 1), (8, 24)] {
            let nothing = Splats::zeros(LAYOUT, 0, 0);
            assert_empty("no splats", level, &nothing, &view(front(width, height)));
        }
    });
}

#[test]
fn no_pixels() {
    every_level(|level| {
        let camera = front(20, 10);
        let splats = random_splats(1, &camera, &SceneSpec::default());
        for (width, height) in [(0, 0), (0, 5), (5, 0)] {
            let mut view = view(camera);
            (view.camera.intrinsics.width, view.camera.intrinsics.height) = (width, height);
            assert_empty("no pixels", level, &splats, &view);
        }
    });
}

#[test]
fn all_behind_the_camera() {
    every_level(|level| {
        let camera = front(24, 18);
        let splats = random_splats(2, &camera, &SceneSpec::default());
        let back = camera_looking_at(camera.intrinsics, [0.0; 3], [0.0, 0.0, -1.0]);
        assert_empty("behind", level, &splats, &view(back));
        for near in [0.0, -5.0, f32::NAN] {
            let at = View { near, ..view(back) };
            assert_empty(&format!("behind, near plane {near}"), level, &splats, &at);
            let at = View {
                near,
                ..view(camera)
            };
            compare(
                &format!("in front, near plane {near}"),
                level,
                &splats,
                &at,
                5e-4,
            );
        }
        let beyond = View {
            near: 1e3,
            ..view(camera)
        };
        assert_empty("near plane behind everything", level, &splats, &beyond);
    });
}

#[test]
fn all_long_dead() {
    every_level(|level| {
        let camera = front(24, 18);
        let spec = SceneSpec {
            n_static: 0,
            ..SceneSpec::default()
        };
        let splats = random_splats(3, &camera, &spec);
        for t in [-1e4, 1e4, 1e30, f64::NAN] {
            let mut view = view(camera);
            view.t = t;
            assert_empty(&format!("at t = {t}"), level, &splats, &view);
        }
    });
}

/// Breaks one parameter of every second splat.
fn broken(camera: &Camera, column: Column, value: f32) -> Splats {
    let spec = SceneSpec {
        layout: LAYOUT,
        n_static: 20,
        n_dynamic: 20,
        ..SceneSpec::default()
    };
    let mut splats = random_splats(4, camera, &spec);
    for k in 0..splats.layout().range(column).len() {
        for v in splats.column_mut(column, k).iter_mut().step_by(2) {
            *v = value;
        }
    }
    splats
}

#[test]
fn numbers_that_are_none_are_left_out() {
    let geometry = [
        Column::Mean,
        Column::LogScale,
        Column::Quat,
        Column::Opacity,
        Column::TimeMean,
        Column::LogTimeSd,
        Column::Velocity,
    ];
    let camera = random_camera(9, 40, 30);
    every_level(|level| {
        for column in geometry {
            for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30] {
                if column == Column::Opacity && !value.is_nan() {
                    // an infinite logit is an opacity of 0 or 1: drawn, see below
                    continue;
                }
                let name = format!("{column:?} {value} on {level}");
                let splats = broken(&camera, column, value);
                let at = view(camera);
                let expected = Expected::new(&splats, &at);
                let mut renderer = Renderer::new(level);
                let frame = renderer.render(&splats, &at).clone();
                let planes = frame.rgb.iter().chain([&frame.transmittance, &frame.depth]);
                assert!(
                    planes.flatten().all(|v| v.is_finite()),
                    "{name}: a pixel is not finite"
                );
                let g = frame_gradient(2, &at);
                let mut out = Gradients::default();
                renderer.backward(&splats, &g, true, &mut out);
                for column in crate::twin::COLUMNS {
                    let values = crate::twin::parameter(&out, &splats, column);
                    assert!(
                        values.iter().all(|v| v.is_finite()),
                        "{name}: {column:?} has no finite gradient"
                    );
                }
                let camera = out
                    .camera
                    .tau
                    .iter()
                    .chain(&out.camera.omega)
                    .chain(&out.camera.intrinsics);
                assert!(
                    camera.chain(&[0.0]).all(|v| v.is_finite()),
                    "{name}: camera"
                );
                // the healthy half is drawn as if the others were not there; f32 overflows before
                // f64 does, so only what is broken in both is compared
                if !value.is_finite() && column != Column::LogScale && column != Column::LogTimeSd {
                    assert_frame(&name, &frame, &expected.rendered);
                    assert_gradients(&name, &out, &expected.gradient(&g), &splats, 5e-4);
                }
            }
        }
    });
}

#[test]
fn a_quaternion_of_length_0_is_left_out() {
    let camera = random_camera(9, 40, 30);
    every_level(|level| {
        let splats = broken(&camera, Column::Quat, 0.0);
        compare("quaternion 0", level, &splats, &view(camera), 5e-4);
    });
}

#[test]
fn extreme_opacities_and_shapes() {
    let camera = random_camera(10, 40, 30);
    every_level(|level| {
        let cases = [
            (Column::Opacity, -100.0),
            (Column::Opacity, 100.0),
            (Column::Opacity, f32::INFINITY),
            (Column::Opacity, f32::NEG_INFINITY),
            (Column::LogScale, -40.0),
            (Column::LogScale, 3.0),
            (Column::Quat, 1e-12),
            (Column::Quat, 1e12),
            (Column::LogTimeSd, 20.0),
            (Column::LogTimeSd, -20.0),
            (Column::Velocity, 3.0),
        ];
        for (column, value) in cases {
            for mip in [false, true] {
                let name = format!("{column:?} {value}, mip {mip}");
                let splats = broken(&camera, column, value);
                compare(
                    &name,
                    level,
                    &splats,
                    &View {
                        mip,
                        ..view(camera)
                    },
                    2e-3,
                );
            }
        }
    });
}

#[test]
fn flat_and_needle_splats() {
    let camera = random_camera(11, 40, 30);
    every_level(|level| {
        for flat in [1, 2] {
            let mut splats = broken(&camera, Column::Velocity, 0.0);
            for k in 0..flat {
                splats.column_mut(Column::LogScale, k).fill(-14.0);
            }
            for mip in [false, true] {
                let view = View {
                    mip,
                    ..view(camera)
                };
                compare(
                    &format!("{flat} flat axes, mip {mip}"),
                    level,
                    &splats,
                    &view,
                    2e-3,
                );
            }
        }
    });
}

#[test]
fn splats_close_to_the_camera_and_far_outside_the_image() {
    let camera = front(40, 30);
    every_level(|level| {
        let spec = SceneSpec {
            layout: LAYOUT,
            n_static: 60,
            n_dynamic: 0,
            ..SceneSpec::default()
        };
        let mut splats = random_splats(12, &camera, &spec);
        for row in 0..splats.n() {
            // a fan of splats from straight ahead to 80 degrees off the axis, 0.21 to 3 units deep
            let angle = 1.4 * (row as f32 / 30.0 - 1.0);
            let z = 0.21 + 0.05 * row as f32;
            for (k, v) in [z * angle.tan(), 0.1 * z * (row as f32).sin(), z]
                .into_iter()
                .enumerate()
            {
                splats.column_mut(Column::Mean, k)[row] = v;
                splats.column_mut(Column::LogScale, k)[row] = ((0.15 + 0.1 * k as f32) * z).ln();
            }
        }
        compare("fan", level, &splats, &view(camera), 2e-3);
    });
}

#[test]
fn a_camera_far_from_the_origin() {
    // world coordinates in the hundreds: f32 keeps 1e-5 of a unit
    let mut camera = random_camera(13, 40, 30);
    camera.c2w.translation *= 100.0;
    every_level(|level| {
        let splats = random_splats(13, &camera, &SceneSpec::default());
        let expected = Expected::new(&splats, &view(camera));
        let mut renderer = Renderer::new(level);
        assert_frame(
            "far from the origin",
            renderer.render(&splats, &view(camera)),
            &expected.rendered,
        );
    });
}

#[test]
fn a_renderer_forgets_the_frame_before() {
    let (small, large) = (random_camera(14, 21, 9), random_camera(15, 70, 55));
    let spec = SceneSpec {
        n_static: 300,
        ..SceneSpec::default()
    };
    let (few, many) = (
        random_splats(14, &small, &SceneSpec::default()),
        random_splats(15, &large, &spec),
    );
    every_level(|level| {
        let run = |renderer: &mut Renderer, splats: &Splats, camera: Camera| {
            let view = view(camera);
            let frame = renderer.render(splats, &view).clone();
            let mut out = Gradients::default();
            renderer.backward(splats, &frame_gradient(3, &view), true, &mut out);
            let mut score = vec![0.0; splats.n()];
            renderer.score(&vec![0.5; frame.transmittance.len()], &mut score);
            let columns: Vec<_> = crate::twin::COLUMNS
                .iter()
                .map(|&c| crate::twin::parameter(&out, splats, c))
                .collect();
            (frame, columns, out.touched, out.camera, score)
        };
        let mut used = Renderer::new(level);
        for (splats, camera) in [
            (&many, large),
            (&few, small),
            (&many, small),
            (&few, large),
            (&many, large),
        ] {
            let fresh = run(&mut Renderer::new(level), splats, camera);
            assert!(
                fresh == run(&mut used, splats, camera),
                "state leaks from frame to frame"
            );
        }
    });
}

/// Everything that a frame gives, as bits.
fn bits(level: SimdLevel, splats: &Splats, view: &View) -> Vec<u64> {
    let mut renderer = Renderer::new(level);
    let frame = renderer.render(splats, view).clone();
    let mut out = Gradients::default();
    renderer.backward(splats, &frame_gradient(8, view), true, &mut out);
    let mut score = vec![0.0; splats.n()];
    renderer.score(&frame.rgb[1], &mut score);
    let planes = frame
        .rgb
        .iter()
        .chain([&frame.transmittance, &frame.depth, &score]);
    let mut all: Vec<u64> = planes.flatten().map(|v| u64::from(v.to_bits())).collect();
    for column in crate::twin::COLUMNS {
        all.extend(
            crate::twin::parameter(&out, splats, column)
                .iter()
                .map(|v| v.to_bits()),
        );
    }
    all.extend(out.touched.iter().map(|&t| u64::from(t)));
    all.extend(out.background.map(|v| u64::from(v.to_bits())));
    let camera = out
        .camera
        .tau
        .iter()
        .chain(&out.camera.omega)
        .chain(&out.camera.intrinsics);
    all.extend(camera.map(|v| v.to_bits()));
    all
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 1,
        time_degree: 1,
    };
    // small enough for one task, and large enough for many
    for (n_static, n_dynamic, width, height) in [(40, 30, 31, 17), (9_000, 5_000, 150, 110)] {
        let camera = random_camera(22, width, height);
        let spec = SceneSpec {
            layout,
            n_static,
            n_dynamic,
            ..SceneSpec::default()
        };
        let splats = random_splats(22, &camera, &spec);
        every_level(|level| {
            let runs: Vec<Vec<u64>> = [1, 2, 3]
                .iter()
                .map(|&threads| {
                    let pool = rayon::ThreadPoolBuilder::new()
                        .num_threads(threads)
                        .build()
                        .unwrap();
                    pool.install(|| bits(level, &splats, &view(camera)))
                })
                .collect();
            assert!(runs[0] == runs[1], "{level}: 1 and 2 threads differ");
            assert!(runs[0] == runs[2], "{level}: 1 and 3 threads differ");
        });
    }
}

#[test]
fn the_order_of_the_rows_only_rounds() {
    // two orders of the same splats are the same image: nothing depends on the place in memory
    let camera = random_camera(23, 60, 40);
    let spec = SceneSpec {
        n_static: 300,
        n_dynamic: 200,
        ..SceneSpec::default()
    };
    let splats = random_splats(23, &camera, &spec);
    let rows: Vec<u32> = (0..300).rev().chain((300..500).rev()).collect();
    let turned = splats.gather(&rows).unwrap();
    every_level(|level| {
        let a = Renderer::new(level).render(&splats, &view(camera)).clone();
        let b = Renderer::new(level).render(&turned, &view(camera)).clone();
        assert_eq!(a, b);
    });
}

#[test]
fn splats_of_other_frames_change_nothing_and_are_left_alone() {
    let camera = random_camera(24, 90, 60);
    let spec = SceneSpec {
        n_static: 300,
        n_dynamic: 9_000,
        ..SceneSpec::default()
    };
    let mut splats = random_splats(24, &camera, &spec);
    let view = view(camera);
    // some live now, in runs and alone; the others never at this instant, by a little or by far
    let (mut rng, t) = (CounterRng::new(24, 0, 0), view.t as f32);
    let mut alive = Vec::new();
    for i in 0..spec.n_dynamic {
        let sd = splats.column(Column::LogTimeSd, 0)[i].exp();
        let now = i < 700 || i % 61 == 0;
        let away = if now {
            2.4 * rng.uniform()
        } else {
            2.5 + 200.0 * rng.uniform().powi(4)
        };
        splats.column_mut(Column::TimeMean, 0)[i] = t + sd * away as f32;
        if now {
            alive.push((spec.n_static + i) as u32);
        }
    }
    let rows: Vec<u32> = (0..spec.n_static as u32).chain(alive).collect();
    let few = splats.gather(&rows).unwrap();
    every_level(|level| {
        let frame = Renderer::new(level).render(&splats, &view).clone();
        let mut renderer = Renderer::new(level);
        assert!(
            frame == *renderer.render(&few, &view),
            "{level}: the images differ"
        );

        let (mut renderer, mut gradients) = (Renderer::new(level), Gradients::default());
        renderer.render(&splats, &view);
        renderer.backward(&splats, &frame_gradient(9, &view), true, &mut gradients);
        let (mut stepped, mut state) = (splats.clone(), AdamState::new(&splats));
        let rates = vec![0.01; splats.columns().len()];
        step(
            level,
            &mut stepped,
            &gradients,
            &mut state,
            &AdamConfig::default(),
            &rates,
        );
        let mut moved = 0;
        for row in 0..splats.n() {
            let opacity = |s: &Splats| s.column(Column::Opacity, 0)[row].to_bits();
            let touched = gradients.touched[row] != 0;
            assert!(
                !touched || rows.contains(&(row as u32)),
                "{level}: row {row} is of another frame"
            );
            assert_eq!(state.step[row], u32::from(touched), "{level}: row {row}");
            assert!(
                touched || opacity(&splats) == opacity(&stepped),
                "{level}: row {row} moved"
            );
            moved += usize::from(touched);
        }
        assert!(moved > 300, "{level}: {moved} rows moved");
    });
}
