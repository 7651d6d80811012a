//! Steps of several frames.

use crate::gpu;
use crate::step::{LAMBDA, LAYOUT, columns, image, settings, start};
use m4_core::Splats;
use m4_kernels::adam::cpu::{AdamConfig, AdamState, step};
use m4_kernels::gpu::GpuError;
use m4_kernels::loss::cpu::{LossScratch, Target, loss};
use m4_kernels::{FrameGradient, Gradients, Renderer, SimdLevel, View};
use m4_testkit::assert_gradient;
use m4_train::backend::gpu::GpuTrainer;
use m4_train::backend::{StepSettings, StepView};

/// The optimiser after a step along the sum of the gradients.
fn on_the_cpu(splats: &Splats, views: &[(Target, View)], rates: &[f32]) -> AdamState {
    let (mut renderer, mut scratch) = (Renderer::new(SimdLevel::best()), LossScratch::default());
    let mut sum = Gradients::default();
    sum.reset(splats);
    sum.columns.iter_mut().for_each(|c| c.fill(0.0));
    for (target, view) in views {
        let drawn = renderer.render(splats, view);
        let (mut g, mut out) = (FrameGradient::default(), Gradients::default());
        loss(SimdLevel::best(), target, &drawn.rgb, LAMBDA, &mut scratch, &mut g.rgb);
        renderer.backward(splats, &g, false, &mut out);
        for (to, from) in sum.columns.iter_mut().zip(&out.columns) {
            let first = splats.n() - to.len();
            for (i, to) in to.iter_mut().enumerate().filter(|&(i, _)| out.touched[first + i] == 1) {
                *to += from[i];
            }
        }
        sum.touched.iter_mut().zip(&out.touched).for_each(|(a, b)| *a |= b);
    }
    let (mut moved, mut adam) = (splats.clone(), AdamState::new(splats));
    step(SimdLevel::best(), &mut moved, &sum, &mut adam, &AdamConfig::default(), rates);
    adam
}

#[test]
fn a_batched_step_matches_the_cpu() {
    let Some(gpu) = gpu("steps of some frames") else { return };
    let (splats, view) = start();
    let rates = vec![1e-4; LAYOUT.columns()];
    let late = View { t: 6.5, ..view };
    let views = [(image(0), view), (image(2), late), (image(1), View { t: 0.5, ..view })];
    let settings = settings(&rates);
    for chosen in [&views[..], &views[1..2], &views[..1]] {
        let want = on_the_cpu(&splats, chosen, &rates);
        let frames = chosen.iter().map(|(frame, _)| frame);
        let mut trainer = GpuTrainer::new(gpu.clone(), &splats, &AdamState::new(&splats), frames, 1 << 14).unwrap();
        let asked: Vec<StepView<'_>> =
            chosen.iter().enumerate().map(|(frame, (_, view))| StepView::new(frame, view)).collect();
        trainer.step(&asked, &settings).unwrap();
        let stats = trainer.stats().unwrap();
        assert_eq!((stats.steps, stats.frames), (1, chosen.len()));
        let (_, adam) = trainer.download().unwrap();
        let different = adam.step.iter().zip(&want.step).filter(|(a, b)| a != b).count();
        assert!(different <= 2, "{different} splats moved by one alone");
        assert_gradient("gradients", &columns(&adam.m), &columns(&want.m), 5e-3);
    }
}

#[test]
fn missing_frames_are_errors() {
    let Some(gpu) = gpu("missing frames") else { return };
    let (splats, view) = start();
    let mut trainer = GpuTrainer::new(gpu, &splats, &AdamState::new(&splats), [image(0)], usize::MAX).unwrap();
    let rates = vec![0.0; LAYOUT.columns()];
    let settings = settings(&rates);
    let missing = trainer.step(&[StepView::new(1, &view)], &settings).unwrap_err();
    assert!(missing.to_string().contains("no frame 1"), "{missing}");
    trainer.step(&[], &settings).unwrap();
    let mut large = view;
    large.camera.intrinsics.width += 16;
    assert!(matches!(trainer.step(&[StepView::new(0, &large)], &settings), Err(GpuError::Shape(_))));
    let few = StepSettings { rates: &rates[1..], ..settings };
    assert!(matches!(trainer.step(&[StepView::new(0, &view)], &few), Err(GpuError::Shape(_))));
    let others = AdamState::new(&splats.gather(&[0, 1]).unwrap());
    assert!(matches!(trainer.replace(&splats, &others), Err(GpuError::Shape(_))));
    assert_eq!(trainer.stats().unwrap().steps, 0);
}
