//! The optimiser's state follows its splats.

use crate::gpu;
use crate::step::{LAMBDA, LAYOUT, image, start};
use m4_kernels::adam::cpu::{AdamConfig, AdamState};
use m4_kernels::{View, gpu::Gpu, morton_order};
use m4_train::backend::gpu::GpuTrainer;
use m4_train::backend::{StepSettings, StepView};

fn trainer(gpu: Gpu) -> (GpuTrainer, View) {
    let (splats, view) = start();
    let mut trainer = GpuTrainer::new(gpu, &splats, &AdamState::new(&splats), [image(0)], usize::MAX).unwrap();
    let rates = vec![1e-3; LAYOUT.columns()];
    for _ in 0..2 {
        trainer.step(&[StepView::new(0, &view)], &settings(&rates)).unwrap();
    }
    (trainer, view)
}

fn settings(rates: &[f32]) -> StepSettings<'_> {
    StepSettings { lambda_ssim: LAMBDA, cover: 0.0, rates, adam: AdamConfig::default(), psnr: true }
}

#[test]
fn the_order_in_memory_is_that_of_the_cpu() {
    let Some(gpu) = gpu("ordering") else { return };
    let (mut trainer, view) = trainer(gpu);
    let (splats, adam) = trainer.download().unwrap();
    let order = morton_order(&splats);
    let want = AdamState {
        m: adam.m.gather(&order).unwrap(),
        v: adam.v.gather(&order).unwrap(),
        step: order.iter().map(|&r| adam.step[r as usize]).collect(),
    };
    trainer.reorder();
    let got = trainer.download().unwrap();
    // a division that rounds another way may put a splat into the next cell: none does here
    assert!(got == (splats.gather(&order).unwrap(), want));
    assert_ne!(got.0, splats);
    let rates = vec![1e-3; LAYOUT.columns()];
    trainer.step(&[StepView::new(0, &view)], &settings(&rates)).unwrap();
    assert!(trainer.stats().unwrap().touched > 0.0);
}
