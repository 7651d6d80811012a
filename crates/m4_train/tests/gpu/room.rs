//! Frames with more tile entries than there is room for.

use crate::{
    gpu,
    step::{LAYOUT, SIZE, columns, image, settings, start},
};
use m4_core::{Column, Splats};
use m4_kernels::{Renderer, SimdLevel, View, adam::cpu::AdamState, gpu::Gpu, morton_order};
use m4_train::backend::{StepView, gpu::GpuTrainer};

/// Room that a trainer has at first for few splats.
const FIRST: usize = 1 << 16;

/// Many splats, each over the whole image; nearly transparent, so that the last of them counts too.
fn wide() -> (Splats, View) {
    let (splats, view) = start();
    let rows: Vec<u32> = (0..4500).map(|i| i * 300 / 4500).collect();
    let mut out = splats.gather(&rows).unwrap();
    let centre = view.camera.centre();
    let axis = view.camera.c2w.rotation.column(2).into_owned();
    for row in 0..out.n() {
        let at = centre + axis * (2.0 + 1e-3 * row as f64);
        for k in 0..3 {
            out.column_mut(Column::Mean, k)[row] = at[k] as f32;
            out.column_mut(Column::LogScale, k)[row] = 3.0;
        }
        out.column_mut(Column::Opacity, 0)[row] = -5.2;
    }
    (out, view)
}

fn rates() -> Vec<f32> {
    vec![0.0; LAYOUT.columns()]
}

/// The image drawn last is that of the CPU.
fn check(trainer: &GpuTrainer, splats: &Splats, view: &View) {
    let want = Renderer::new(SimdLevel::best())
        .render(splats, view)
        .clone();
    let got = trainer.frame().unwrap();
    let planes = got.rgb.iter().flatten().zip(want.rgb.iter().flatten());
    let worst = planes.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 2e-3, "{worst}");
}

#[test]
fn the_first_frame_allocates_enough_tile_entries() {
    let Some(gpu) = gpu("a first frame without room") else {
        return;
    };
    let (splats, view) = wide();
    let mut trainer = GpuTrainer::new(
        gpu,
        &splats,
        &AdamState::new(&splats),
        [image(0)],
        usize::MAX,
    )
    .unwrap();
    let rates = rates();
    trainer
        .step(&[StepView::new(0, &view)], &settings(&rates))
        .unwrap();
    check(&trainer, &splats, &view);
    trainer.stats().unwrap();
    assert!(trainer.room() > FIRST);
}

#[test]
fn tile_entries_are_reallocated_after_an_overflow() {
    let Some(gpu) = gpu("a later frame without room") else {
        return;
    };
    let (splats, view) = wide();
    // the first sees nothing
    let away = View { near: 1e9, ..view };
    let mut trainer = GpuTrainer::new(
        gpu,
        &splats,
        &AdamState::new(&splats),
        [image(0)],
        usize::MAX,
    )
    .unwrap();
    let rates = rates();
    trainer
        .step(&[StepView::new(0, &away)], &settings(&rates))
        .unwrap();
    // a frame without room moves nothing
    let moving = vec![1e-3; LAYOUT.columns()];
    trainer
        .step(&[StepView::new(0, &view)], &settings(&moving))
        .unwrap();
    let (same, adam) = trainer.download().unwrap();
    assert!(same == splats && adam == AdamState::new(&splats));
    let stats = trainer.stats().unwrap();
    let room = trainer.room();
    assert!(
        room > FIRST && stats.l1.is_finite() && stats.splats_are_finite && stats.touched == 0.0
    );
    trainer
        .step(&[StepView::new(0, &view)], &settings(&rates))
        .unwrap();
    check(&trainer, &splats, &view);
    trainer.stats().unwrap();
    assert_eq!(trainer.room(), room);
}

#[test]
fn steps_give_the_same_bits_every_time() {
    let Some(gpu) = gpu("bits of steps") else {
        return;
    };
    let (splats, view) = start();
    let rates = vec![1e-3; LAYOUT.columns()];
    let once = |budget| {
        let frames = [image(0), image(1)];
        let mut trainer = GpuTrainer::new(
            gpu.clone(),
            &splats,
            &AdamState::new(&splats),
            &frames,
            budget,
        )
        .unwrap();
        for i in 0..6 {
            trainer
                .step(&[StepView::new(i % 2, &view)], &settings(&rates))
                .unwrap();
        }
        let (splats, adam) = trainer.download().unwrap();
        let bits = |of: &Splats| columns(of).iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        (
            bits(&splats),
            bits(&adam.v),
            trainer.stats().unwrap().l1.to_bits(),
        )
    };
    // frames on the device, one of them streamed, both
    let want = once(usize::MAX);
    assert_eq!(once(4 * 3 * (SIZE.0 * SIZE.1).div_ceil(4)), want);
    assert_eq!(once(0), want);
}

fn trainer(gpu: Gpu) -> (GpuTrainer, View) {
    let (splats, view) = start();
    let mut trainer = GpuTrainer::new(
        gpu,
        &splats,
        &AdamState::new(&splats),
        [image(0)],
        usize::MAX,
    )
    .unwrap();
    let rates = vec![1e-3; LAYOUT.columns()];
    for _ in 0..2 {
        trainer
            .step(&[StepView::new(0, &view)], &settings(&rates))
            .unwrap();
    }
    (trainer, view)
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
        nodes: Vec::new(),
    };
    trainer.reorder();
    let got = trainer.download().unwrap();
    // a division that rounds another way may put a splat into the next cell: none does here
    assert!(got == (splats.gather(&order).unwrap(), want));
    assert_ne!(got.0, splats);
    let rates = vec![1e-3; LAYOUT.columns()];
    trainer
        .step(&[StepView::new(0, &view)], &settings(&rates))
        .unwrap();
    assert!(trainer.stats().unwrap().touched > 0.0);
}
