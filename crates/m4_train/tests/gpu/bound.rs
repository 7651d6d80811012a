//! Training of bound splats.

use crate::common::{FRAMES, disturbed, video};
use crate::density::{DUE, check, round};
use crate::gpu;
use crate::step::{COVER, LAYOUT, columns, image, settings, start};
use m4_core::{Binding, Capture, Column, CounterRng, Pose, Silent, Splats, Window};
use m4_kernels::{
    Renderer, SimdLevel, View,
    adam::cpu::{AdamConfig, AdamState},
    gpu::Gpu,
};
use m4_testkit::{MovingScene, assert_gradient, bind_at_random};
use m4_train::backend::{
    Backend, CpuBackend, StepSettings, StepView, gpu::GpuBackend, gpu::GpuTrainer,
};
use m4_train::{
    DensityConfig, SceneScale, TrainConfig, Trainer,
    config::{SplitPlacement, SplitSize},
};
use std::sync::Arc;

const BOUND: usize = 120;

/// Static splats, bound ones in two windows, and free ones.
fn splats() -> (Splats, View) {
    let (mut splats, view) = start();
    bind_at_random(6, &mut splats, BOUND);
    (splats, view)
}

/// Both, with the same frames and splats.
fn backends<'a>(gpu: &Gpu, capture: &'a Capture, splats: &Splats) -> [Box<dyn Backend + 'a>; 2] {
    let cpu = CpuBackend::new(capture, 100, SimdLevel::best());
    let both: [Box<dyn Backend>; 2] = [
        Box::new(cpu),
        Box::new(GpuBackend::new(gpu.clone(), None, &TrainConfig::fast())),
    ];
    both.map(|mut backend| {
        backend.set_frames(vec![image(0), image(2)]).unwrap();
        backend.upload(splats, AdamState::new(splats)).unwrap();
        backend
    })
}

/// Of the poses of all nodes.
fn poses(splats: &Splats) -> Vec<f64> {
    let keys = splats
        .windows()
        .iter()
        .flat_map(|w| (0..w.keys().len()).flat_map(|key| w.poses(key)));
    keys.flat_map(|p| p.position.into_iter().chain(p.rotation))
        .map(f64::from)
        .collect()
}

fn moved(from: &[f64], to: &[f64]) -> Vec<f64> {
    to.iter().zip(from).map(|(a, b)| a - b).collect()
}

#[test]
fn steps_of_bound_splats_are_those_of_the_cpu() {
    let Some(gpu) = gpu("steps of bound splats") else {
        return;
    };
    let (_, capture) = video();
    let (splats, view) = splats();
    let rates: Vec<f32> = (0..LAYOUT.columns())
        .map(|c| 1e-4 * (1 + c % 3) as f32)
        .collect();
    let views = [3.0, 1.0, 2.4, 3.0, 5.5].map(|t| View { t, ..view });
    for (sparse, batch) in [(true, 1), (false, 1), (true, 2)] {
        let adam = AdamConfig {
            sparse,
            ..AdamConfig::default()
        };
        let settings = StepSettings {
            cover: COVER,
            adam,
            ..settings(&rates)
        };
        let [want, got] = backends(&gpu, &capture, &splats).map(|mut backend| {
            let steps: Vec<StepView<'_>> = views
                .iter()
                .enumerate()
                .map(|(k, view)| StepView::new(k % 2, view))
                .collect();
            for step in steps.windows(batch) {
                backend.step(step, &settings).unwrap();
            }
            let stats = backend.stats().unwrap();
            assert!(stats.splats_are_finite && stats.steps == views.len() + 1 - batch);
            backend.take().unwrap()
        });
        let ((want, want_adam), (got, got_adam)) = (want, got);
        assert_eq!(got.bindings(), want.bindings());
        let different = got_adam
            .step
            .iter()
            .zip(&want_adam.step)
            .filter(|(a, b)| a != b)
            .count();
        assert!(different <= 3, "{different} counts of steps");
        assert_gradient(
            "first moments",
            &columns(&got_adam.m),
            &columns(&want_adam.m),
            5e-3,
        );
        assert_gradient(
            "second moments",
            &columns(&got_adam.v),
            &columns(&want_adam.v),
            5e-3,
        );
        let (a, b, c) = (columns(&splats), columns(&got), columns(&want));
        let off = moved(&a, &b)
            .iter()
            .zip(moved(&a, &c))
            .filter(|(a, b)| (*a - b).abs() > 2e-5)
            .count();
        assert!(
            off * 50 < a.len(),
            "{off} of {} parameters went elsewhere",
            a.len()
        );
        for (got, want) in got_adam.nodes.iter().zip(&want_adam.nodes) {
            assert_eq!(got.step, want.step);
            let wide = |v: &[f32]| v.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
            assert_gradient(
                "first moments of nodes",
                &wide(&got.m),
                &wide(&want.m),
                5e-3,
            );
            assert_gradient(
                "second moments of nodes",
                &wide(&got.v),
                &wide(&want.v),
                1e-2,
            );
        }
        let steps: u32 = want_adam.nodes.iter().flat_map(|n| &n.step).sum();
        assert!(steps >= 6 && got_adam.nodes.len() == 2, "{steps}");
        let before = poses(&splats);
        let (got, want) = (moved(&before, &poses(&got)), moved(&before, &poses(&want)));
        assert!(
            want.iter().filter(|d| d.abs() > 1e-3).count() > 40,
            "nodes move"
        );
        let off = got
            .iter()
            .zip(&want)
            .filter(|(a, b)| (*a - *b).abs() > 2e-4)
            .count();
        assert!(
            off * 50 < want.len(),
            "{off} of {} numbers of nodes went elsewhere",
            want.len()
        );
    }
}

#[test]
fn bound_splats_keep_their_bindings_wherever_they_go() {
    let Some(gpu) = gpu("bindings") else { return };
    let (_, capture) = video();
    let (splats, view) = splats();
    let [want, got] = backends(&gpu, &capture, &splats).map(|mut backend| {
        backend.reorder().unwrap();
        backend.take().unwrap()
    });
    assert!(got == want && got.0 != splats, "the order in memory");
    let windows: Vec<u32> = got.0.bindings().iter().map(|b| b.window).collect();
    assert!(windows.is_sorted(), "{windows:?}");

    let mut trainer =
        GpuTrainer::new(gpu, &got.0, &got.1, [image(0), image(2)], usize::MAX).unwrap();
    let rates = vec![1e-3; LAYOUT.columns()];
    let views = [(0, view), (1, View { t: 3.0, ..view })];
    for (frame, view) in &views {
        trainer
            .step(&[StepView::new(*frame, view)], &settings(&rates))
            .unwrap();
    }
    let lengths = SceneScale {
        one_centre: false,
        extent: 1.0,
        median_depth: 1.0,
        focal_px: 60.0,
        centres: vec![[0.0; 3]],
    };
    let config = DensityConfig {
        densify_threshold: 0.001,
        budget: 1.0,
        min_opacity: 0.3,
        split_size: SplitSize::Pixels { pixels: 2.0 },
        ..DensityConfig::fast()
    };
    let before = trainer.download_splats().unwrap();
    let grown = check(
        "bound",
        &mut trainer,
        &round(&views, &config, &lengths, DUE),
    );
    assert!(
        grown.cloned + grown.split > 10 && grown.pruned > 10,
        "{grown:?}"
    );
    let after = trainer.download_splats().unwrap();
    let count = |splats: &Splats, binding: &Binding| {
        splats.bindings().iter().filter(|b| *b == binding).count()
    };
    let copied = before
        .bindings()
        .iter()
        .filter(|b| count(&after, b) > 1)
        .count();
    let gone = before
        .bindings()
        .iter()
        .filter(|b| count(&after, b) == 0)
        .count();
    assert!(
        copied > 2 && gone > 2 && after.bindings().len() > 20,
        "{copied} copied, {gone} gone"
    );
    // drawn children: those of bound splats live as their bindings say
    let drawn = DensityConfig {
        split_placement: SplitPlacement::Sample,
        min_opacity: 0.0,
        ..config
    };
    let grown = check(
        "bound, drawn",
        &mut trainer,
        &round(&views, &drawn, &lengths, DUE),
    );
    assert!(grown.split > 5, "{grown:?}");
    let after = trainer.download_splats().unwrap();
    // nodes have lists of the new rows
    trainer.stats().unwrap();
    let late = View { t: 3.0, ..view };
    trainer
        .step(&[StepView::new(0, &late)], &settings(&rates))
        .unwrap();
    let moved = trainer.download_splats().unwrap();
    assert!(poses(&moved) != poses(&after) && trainer.stats().unwrap().splats_are_finite);
}

/// The disturbed scene, half of the ball bound to four nodes that move about as it does.
fn first(scene: &MovingScene) -> Splats {
    let mut out = disturbed(scene, 7);
    let mut rng = CounterRng::new(9, 0, 0);
    let keys: Vec<f32> = (0..FRAMES).map(|t| t as f32).collect();
    let anchors: Vec<[f32; 3]> = (0..4)
        .map(|node| [0, 1, 2].map(|k| scene.start[k] + if node == k { scene.radius } else { 0.0 }))
        .collect();
    let mut poses = Vec::new();
    for &t in &keys {
        for anchor in &anchors {
            let position =
                [0, 1, 2].map(|k| anchor[k] + scene.velocity[k] * t + 0.03 * rng.normal() as f32);
            poses.push(Pose {
                position,
                rotation: [1.0, 0.0, 0.0, 0.0],
            });
        }
    }
    let binding = Binding {
        window: 0,
        nodes: [0, 1, 2, 3],
        weights: [0.25; 4],
        life: [f32::NEG_INFINITY, f32::INFINITY],
    };
    let (n_static, n_bound) = (out.n_static(), out.n_dynamic() / 2);
    let middle = 0.5 * (FRAMES - 1) as f32;
    for k in 0..3 {
        // where they are before the nodes move
        out.column_mut(Column::Mean, k)[n_static..][..n_bound]
            .iter_mut()
            .for_each(|x| *x -= scene.velocity[k] * middle);
    }
    out.column_mut(Column::TimeMean, 0)[..n_bound].fill(3.0);
    let windows = vec![Window::new(keys, anchors, poses).unwrap()];
    out.bind(Arc::new(windows), vec![binding; n_bound]).unwrap();
    out
}

fn config(iterations: usize) -> TrainConfig {
    let mut config = TrainConfig {
        iterations,
        seed: 5,
        ..TrainConfig::fast()
    };
    config.density = DensityConfig {
        from: 0.2,
        every: 0.2,
        prune_every: 0.4,
        ..DensityConfig::fast()
    };
    config
}

fn backend(gpu: &Gpu) -> Box<dyn Backend> {
    Box::new(GpuBackend::new(gpu.clone(), None, &TrainConfig::fast()))
}

fn train<'a>(scene: &MovingScene, capture: &'a Capture, gpu: Option<&Gpu>) -> Trainer<'a> {
    let mut trainer = Trainer::new(capture, first(scene), config(60), SimdLevel::best()).unwrap();
    if let Some(gpu) = gpu {
        trainer.use_backend(backend(gpu)).unwrap();
    }
    trainer
        .run(&Silent, &mut |event| assert!(event.loss.is_finite()))
        .unwrap();
    trainer
}

/// PSNR over all frames of the video, dB.
fn psnr(splats: &Splats, scene: &MovingScene, capture: &Capture) -> f64 {
    let mut renderer = Renderer::new(SimdLevel::best());
    let (mut squares, mut values) = (0.0, 0usize);
    for (i, frame) in capture.frames.iter().enumerate() {
        let view = View {
            camera: scene.cameras[i],
            t: i as f64,
            background: [0.0; 3],
            near: 0.1,
            mip: true,
            period: (FRAMES - 1) as f32,
            with_depth: false,
        };
        let drawn = renderer.render(splats, &view);
        for (c, plane) in drawn.rgb.iter().enumerate() {
            for (at, &value) in plane.iter().enumerate() {
                let target = f64::from(frame.rgb[(at % drawn.width, at / drawn.width)][c]) / 255.0;
                squares += (f64::from(value.clamp(0.0, 1.0)) - target).powi(2);
            }
        }
        values += 3 * drawn.width * drawn.height;
    }
    -10.0 * (squares / values as f64).log10()
}

#[test]
fn bound_splats_learn_as_on_the_cpu_and_a_saved_run_goes_on() {
    let Some(gpu) = gpu("training of bound splats") else {
        return;
    };
    let (scene, capture) = video();
    let here = train(&scene, &capture, None);
    let [whole, again] = [(); 2].map(|()| train(&scene, &capture, Some(&gpu)));
    assert!(
        whole.splats() == again.splats() && whole.state() == again.state(),
        "twice the same"
    );
    let before = psnr(&first(&scene), &scene, &capture);
    let [a, b] = [&here, &whole].map(|t| psnr(t.splats(), &scene, &capture));
    assert!(a > before + 1.0, "the CPU learns: {before:.2} to {a:.2} dB");
    assert!((a - b).abs() < 0.1, "CPU {a:.3} dB, GPU {b:.3} dB");
    let (n, m) = (
        here.splats().bindings().len(),
        whole.splats().bindings().len(),
    );
    assert!(n.abs_diff(m) <= 2 && n > 20, "{n} and {m} bound splats");
    let motion = moved(&poses(&first(&scene)), &poses(whole.splats()));
    assert!(
        motion.iter().filter(|d| d.abs() > 1e-4).count() > 30,
        "nodes are trained"
    );

    let mut half = Trainer::new(&capture, first(&scene), config(60), SimdLevel::best()).unwrap();
    half.use_backend(backend(&gpu)).unwrap();
    half.run_until(33, &Silent, &mut |_| {}).unwrap();
    let (saved, state) = (half.scene(), half.state());
    let mut rest = Trainer::resume(
        &capture,
        saved.splats,
        &state,
        config(60),
        SimdLevel::best(),
    )
    .unwrap();
    rest.use_backend(backend(&gpu)).unwrap();
    rest.run(&Silent, &mut |_| {}).unwrap();
    assert!(whole.splats() == rest.splats(), "resumed");
    assert!(whole.state() == rest.state(), "the optimiser's state too");
}
