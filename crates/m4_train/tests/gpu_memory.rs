//! What is planned is what is taken. The runtime counts for the whole process, so that this test has one of its own.

use m4_kernels::adam::cpu::AdamState;
use m4_kernels::bench::{BenchScene, SceneConfig, SceneKind};
use m4_kernels::gpu::{Gpu, Plan};
use m4_train::backend::gpu::GpuTrainer;

const SIZE: (usize, usize) = (96, 72);

#[test]
fn a_trainer_takes_what_was_planned() {
    let gpu = match Gpu::for_tests() {
        Ok(gpu) => gpu,
        Err(error) => {
            m4_testkit::skip(m4_testkit::Need::Vulkan, &error.to_string());
            return;
        }
    };
    let scene =
        BenchScene::new(&SceneConfig { splats: 3000, width: SIZE.0, height: SIZE.1, kind: SceneKind::FourD }).unwrap();
    let (n, n_static) = (scene.splats.n(), scene.splats.n_static());
    let frames = [&scene.target; 3];
    let entries = Plan::first_entries(n);
    let plan = Plan::training(n_static, n - n_static, scene.splats.layout(), SIZE, frames.len(), entries);
    let passing: u64 = plan.parts().iter().filter(|p| p.what == "density control").map(|p| p.bytes).sum();
    let before = gpu.memory().in_use;
    let trainer =
        GpuTrainer::new(gpu.clone(), &scene.splats, &AdamState::new(&scene.splats), frames, usize::MAX).unwrap();
    let taken = gpu.memory().in_use - before;
    let want = plan.total() - passing;
    let off = (taken as f64 / want as f64 - 1.0).abs();
    assert!(off < 0.03, "{taken} bytes for {want} planned: {plan}");
    assert!(plan.check_buffers(&gpu).is_ok());
    drop(trainer);
    assert!(gpu.memory().in_use < before + taken / 10, "dropped");
}
