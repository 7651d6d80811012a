//! Same bits on any number of threads.

use crate::twin::{every_level, frame_gradient, view};
use m4_core::{Column, CounterRng, SplatLayout, Splats};
use m4_kernels::{
    Gradients, Renderer, SimdLevel, View, Wanted,
    adam::cpu::{AdamConfig, AdamState, step},
};
use m4_testkit::{SceneSpec, random_camera, random_splats};

/// Everything that a frame gives, as bits.
fn bits(level: SimdLevel, splats: &Splats, view: &View) -> Vec<u64> {
    let mut renderer = Renderer::new(level);
    let frame = renderer.render(splats, view).clone();
    let mut out = Gradients::default();
    renderer.backward(splats, &frame_gradient(8, view), Wanted::ALL, &mut out);
    let mut score = vec![0.0; splats.n()];
    renderer.score(&frame.rgb[1], &mut score);
    let planes = frame.rgb.iter().chain([&frame.transmittance, &frame.depth, &score]);
    let mut all: Vec<u64> = planes.flatten().map(|v| u64::from(v.to_bits())).collect();
    for column in crate::twin::COLUMNS {
        all.extend(crate::twin::parameter(&out, splats, column).iter().map(|v| v.to_bits()));
    }
    all.extend(out.touched.iter().map(|&t| u64::from(t)));
    all.extend(crate::twin::means2d(&out).iter().map(|v| v.to_bits()));
    all.extend(out.background.map(|v| u64::from(v.to_bits())));
    let camera = out.camera.tau.iter().chain(&out.camera.omega).chain(&out.camera.intrinsics);
    all.extend(camera.map(|v| v.to_bits()));
    all
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let layout = SplatLayout { isotropic: false, sh_degree: 1, time_degree: 1 };
    // small enough for one task, and large enough for many
    for (n_static, n_dynamic, width, height) in [(40, 30, 31, 17), (9_000, 5_000, 150, 110)] {
        let camera = random_camera(22, width, height);
        let spec = SceneSpec { layout, n_static, n_dynamic, ..SceneSpec::default() };
        let splats = random_splats(22, &camera, &spec);
        every_level(|level| {
            let runs: Vec<Vec<u64>> = [1, 2, 3]
                .iter()
                .map(|&threads| {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
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
    let spec = SceneSpec { n_static: 300, n_dynamic: 200, ..SceneSpec::default() };
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
    let spec = SceneSpec { n_static: 300, n_dynamic: 9_000, ..SceneSpec::default() };
    let mut splats = random_splats(24, &camera, &spec);
    let view = view(camera);
    // some live now, in runs and alone; the others never at this instant, by a little or by far
    let (mut rng, t) = (CounterRng::new(24, 0, 0), view.t as f32);
    let mut alive = Vec::new();
    for i in 0..spec.n_dynamic {
        let sd = splats.column(Column::LogTimeSd, 0)[i].exp();
        let now = i < 700 || i % 61 == 0;
        let away = if now { 2.4 * rng.uniform() } else { 2.5 + 200.0 * rng.uniform().powi(4) };
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
        assert!(frame == *renderer.render(&few, &view), "{level}: the images differ");

        let (mut renderer, mut gradients) = (Renderer::new(level), Gradients::default());
        renderer.render(&splats, &view);
        renderer.backward(&splats, &frame_gradient(9, &view), Wanted::ALL, &mut gradients);
        let (mut stepped, mut state) = (splats.clone(), AdamState::new(&splats));
        let rates = vec![0.01; splats.columns().len()];
        step(level, &mut stepped, &gradients, &mut state, &AdamConfig::default(), &rates);
        let mut moved = 0;
        for row in 0..splats.n() {
            let opacity = |s: &Splats| s.column(Column::Opacity, 0)[row].to_bits();
            let touched = gradients.touched[row] != 0;
            assert!(!touched || rows.contains(&(row as u32)), "{level}: row {row} is of another frame");
            assert_eq!(state.step[row], u32::from(touched), "{level}: row {row}");
            assert!(touched || opacity(&splats) == opacity(&stepped), "{level}: row {row} moved");
            moved += usize::from(touched);
        }
        assert!(moved > 300, "{level}: {moved} rows moved");
    });
}
