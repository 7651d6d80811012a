//! Steps of several frames, with the gradients of cameras and exposures.

use crate::gpu;
use crate::step::{LAMBDA, LAYOUT, columns, image, settings, start};
use m4_core::{Exposure, Splats};
use m4_kernels::adam::cpu::{AdamConfig, AdamState, step};
use m4_kernels::gpu::GpuError;
use m4_kernels::loss::cpu::{LossScratch, Target, loss};
use m4_kernels::{CameraGradient, Gradients, Renderer, SimdLevel, View};
use m4_testkit::assert_gradient;
use m4_train::backend::gpu::GpuTrainer;
use m4_train::backend::{StepSettings, StepView};

/// Corrections of two frames.
pub const CASTS: [Exposure; 2] = [
    Exposure {
        matrix: [[0.8, 0.1, 0.0], [0.05, 1.1, -0.1], [0.0, 0.2, 0.9]],
        offset: [0.02, 0.0, 0.05],
    },
    Exposure {
        matrix: [[1.2, 0.0, 0.1], [0.0, 0.7, 0.0], [0.1, 0.0, 1.1]],
        offset: [-0.1, 0.05, 0.0],
    },
];

/// `matrix rgb + offset`, and unchanged without a correction.
pub fn exposed(exposure: Option<&Exposure>, rgb: &[Vec<f32>; 3]) -> [Vec<f32>; 3] {
    let Some(Exposure { matrix, offset }) = exposure else {
        return rgb.clone();
    };
    [0, 1, 2].map(|r| {
        let pixels = 0..rgb[0].len();
        let colour = |i: usize| (0..3).map(|k| matrix[r][k] * rgb[k][i]).sum::<f32>();
        pixels.map(|i| colour(i) + offset[r]).collect()
    })
}

/// Of the colours before, given that of the colours after.
pub fn pulled_back(exposure: Option<&Exposure>, g: &[Vec<f32>; 3]) -> [Vec<f32>; 3] {
    let Some(Exposure { matrix, .. }) = exposure else {
        return g.clone();
    };
    [0, 1, 2].map(|k| {
        let pixels = 0..g[0].len();
        pixels
            .map(|i| (0..3).map(|r| matrix[r][k] * g[r][i]).sum())
            .collect()
    })
}

/// Rows of the matrix, each with its offset.
fn of_exposure(rgb: &[Vec<f32>; 3], g: &[Vec<f32>; 3]) -> [f64; 12] {
    let dot =
        |a: &[f32], b: &[f32]| -> f64 { a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum() };
    std::array::from_fn(|i| match (i / 4, i % 4) {
        (r, 3) => g[r].iter().map(|&g| f64::from(g)).sum(),
        (r, k) => dot(&g[r], &rgb[k]),
    })
}

/// Moments and the gradients of cameras and exposures after a step.
struct Host {
    adam: AdamState,
    cameras: Vec<CameraGradient>,
    exposures: Vec<[f64; 12]>,
}

fn on_the_cpu(splats: &Splats, views: &[(Target, View)], rates: &[f32]) -> Host {
    let mut renderer = Renderer::new(SimdLevel::best());
    let (mut scratch, mut cameras, mut exposures) =
        (LossScratch::default(), Vec::new(), Vec::new());
    let mut sum = Gradients::default();
    sum.reset(splats);
    sum.columns.iter_mut().for_each(|c| c.fill(0.0));
    for (frame, (target, view)) in views.iter().enumerate() {
        let drawn = renderer.render(splats, view).clone();
        let (shown, mut g) = (exposed(CASTS.get(frame), &drawn.rgb), Default::default());
        loss(
            SimdLevel::best(),
            target,
            &shown,
            LAMBDA,
            &mut scratch,
            &mut g,
        );
        if frame < CASTS.len() {
            exposures.push(of_exposure(&drawn.rgb, &g));
        }
        g = pulled_back(CASTS.get(frame), &g);
        let mut out = Gradients::default();
        renderer.backward(splats, &g, true, &mut out);
        cameras.push(out.camera);
        for (to, from) in sum.columns.iter_mut().zip(&out.columns) {
            let first = splats.n() - to.len();
            for (i, to) in to
                .iter_mut()
                .enumerate()
                .filter(|&(i, _)| out.touched[first + i] == 1)
            {
                *to += from[i];
            }
        }
        sum.touched
            .iter_mut()
            .zip(&out.touched)
            .for_each(|(a, b)| *a |= b);
    }
    let (mut moved, mut adam) = (splats.clone(), AdamState::new(splats));
    step(
        SimdLevel::best(),
        &mut moved,
        &sum,
        &mut adam,
        &AdamConfig::default(),
        rates,
    );
    Host {
        adam,
        cameras,
        exposures,
    }
}

#[test]
fn a_batched_step_matches_the_cpu() {
    let Some(gpu) = gpu("steps of some frames") else {
        return;
    };
    let (splats, view) = start();
    let rates = vec![1e-4; LAYOUT.columns()];
    let late = View { t: 6.5, ..view };
    let views = [
        (image(0), view),
        (image(2), late),
        (image(1), View { t: 0.5, ..view }),
    ];
    let settings = settings(&rates);
    for chosen in [&views[..], &views[1..2], &views[..1]] {
        let want = on_the_cpu(&splats, chosen, &rates);
        let frames = chosen.iter().map(|(frame, _)| frame);
        let mut trainer = GpuTrainer::new(
            gpu.clone(),
            &splats,
            &AdamState::new(&splats),
            frames,
            1 << 14,
        )
        .unwrap();
        let asked: Vec<StepView<'_>> = chosen
            .iter()
            .enumerate()
            .map(|(frame, (_, view))| StepView {
                camera: true,
                exposure: true,
                ..StepView::new(frame, view)
            })
            .collect();
        trainer.set_exposures(&CASTS);
        trainer.step(&asked, &settings).unwrap();
        let stats = trainer.stats().unwrap();
        assert_eq!((stats.steps, stats.frames), (1, chosen.len()));
        let (_, adam) = trainer.download().unwrap();
        let different = adam
            .step
            .iter()
            .zip(&want.adam.step)
            .filter(|(a, b)| a != b)
            .count();
        assert!(different <= 2, "{different} splats moved by one alone");
        assert_gradient("gradients", &columns(&adam.m), &columns(&want.adam.m), 5e-3);
        assert_eq!(stats.cameras.len(), chosen.len());
        for (i, ((frame, got), want)) in stats.cameras.iter().zip(&want.cameras).enumerate() {
            assert_eq!(*frame, i);
            for (what, got, want) in [
                ("tau", &got.tau[..], &want.tau[..]),
                ("omega", &got.omega, &want.omega),
                ("focal", &got.intrinsics[..2], &want.intrinsics[..2]),
                ("centre", &got.intrinsics[2..], &want.intrinsics[2..]),
            ] {
                assert_gradient(&format!("camera {i}, {what}"), got, want, 5e-3);
            }
        }
        assert_eq!(stats.exposures.len(), want.exposures.len());
        for (i, ((frame, got), want)) in stats.exposures.iter().zip(&want.exposures).enumerate() {
            assert_eq!(*frame, i);
            assert_gradient(&format!("exposure {i}"), got, want, 5e-3);
        }
        let again = trainer.stats().unwrap();
        assert!(again.cameras.is_empty() && again.exposures.is_empty());
    }
}

#[test]
fn missing_frames_are_errors() {
    let Some(gpu) = gpu("missing frames") else {
        return;
    };
    let (splats, view) = start();
    let mut trainer = GpuTrainer::new(
        gpu,
        &splats,
        &AdamState::new(&splats),
        [image(0)],
        usize::MAX,
    )
    .unwrap();
    let rates = vec![0.0; LAYOUT.columns()];
    let settings = settings(&rates);
    let missing = trainer
        .step(&[StepView::new(1, &view)], &settings)
        .unwrap_err();
    assert!(missing.to_string().contains("no frame 1"), "{missing}");
    trainer.step(&[], &settings).unwrap();
    let mut large = view;
    large.camera.intrinsics.width += 16;
    assert!(matches!(
        trainer.step(&[StepView::new(0, &large)], &settings),
        Err(GpuError::Shape(_))
    ));
    let few = StepSettings {
        rates: &rates[1..],
        ..settings
    };
    assert!(matches!(
        trainer.step(&[StepView::new(0, &view)], &few),
        Err(GpuError::Shape(_))
    ));
    let others = AdamState::new(&splats.gather(&[0, 1]).unwrap());
    assert!(matches!(
        trainer.replace(&splats, &others),
        Err(GpuError::Shape(_))
    ));
    assert_eq!(trainer.stats().unwrap().steps, 0);
}
