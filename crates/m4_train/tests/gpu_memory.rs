//! What is planned is what is taken, and a warm-up gives back what it takes. The runtime counts for
//! the whole process, so that this test has one of its own.

use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane, Se3, SplatLayout};
use m4_kernels::adam::cpu::AdamState;
use m4_kernels::bench::{BenchScene, SceneConfig, SceneKind};
use m4_kernels::gpu::Gpu;
use m4_kernels::plan::Plan;
use m4_kernels::renderer::gpu::Size;
use m4_train::backend::gpu::{GpuBackend, GpuTrainer};
use m4_train::{RefineConfig, TrainConfig, warm_up};

const SIZE: (usize, usize) = (96, 72);

/// Two images of one wall.
fn wall() -> Capture {
    let camera = Camera {
        intrinsics: Intrinsics::centred(SIZE.0, SIZE.1, 90.0),
        c2w: Se3::identity(),
    };
    let frame = |i: usize| CaptureFrame {
        name: format!("{i:03}"),
        camera,
        t: i as f64,
        rgb: Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            [(2 * x) as u8, (3 * y) as u8, (40 * i) as u8]
        }),
        depth: Some(Plane::filled(SIZE.0, SIZE.1, 2.0f32).into()),
        mask: None,
        motion: None,
        instances: None,
        camera_index: None,
        distance_sigma: None,
    };
    Capture {
        frames: (0..2).map(frame).collect(),
        time_frames: 2,
        duration_s: None,
        metric: true,
        tracks: None,
    }
}

#[test]
fn a_trainer_takes_what_was_planned_and_a_warm_up_gives_all_back() {
    let gpu = match Gpu::for_tests() {
        Ok(gpu) => gpu,
        Err(error) => {
            m4_testkit::skip(m4_testkit::Need::Vulkan, &error.to_string());
            return;
        }
    };
    let scene = BenchScene::new(&SceneConfig {
        splats: 3000,
        width: SIZE.0,
        height: SIZE.1,
        kind: SceneKind::FourD,
    })
    .unwrap();
    let (n, n_static) = (scene.splats.n(), scene.splats.n_static());
    let frames = [&scene.target; 3];
    let entries = Size::first_entries(n);
    let plan = Plan::training(
        n_static,
        n - n_static,
        scene.splats.layout(),
        SIZE,
        frames.len(),
        entries,
    );
    let plan = plan.with_image_gradients();
    let passing: u64 = plan
        .parts()
        .iter()
        .filter(|p| p.what == "density control")
        .map(|p| p.bytes)
        .sum();
    let before = gpu.memory().in_use;
    let mut trainer = GpuTrainer::new(
        gpu.clone(),
        &scene.splats,
        &AdamState::new(&scene.splats),
        frames,
        usize::MAX,
    )
    .unwrap();
    trainer.collect_image_gradients();
    let memory_bytes = gpu.memory().in_use - before;
    let want = plan.total() - passing;
    let off = (memory_bytes as f64 / want as f64 - 1.0).abs();
    assert!(
        off < 0.03,
        "{memory_bytes} bytes for {want} planned: {plan}"
    );
    assert!(plan.check_buffers(&gpu).is_ok());
    drop(trainer);
    assert!(gpu.memory().in_use < before + memory_bytes / 10, "dropped");

    let refine = RefineConfig {
        poses: true,
        focal: true,
        exposure: true,
        ..RefineConfig::default()
    };
    let everything = TrainConfig {
        batch: 2,
        refine,
        ..TrainConfig::fast()
    };
    for (isotropic, config) in [(false, everything), (true, TrainConfig::faithful())] {
        let layout = SplatLayout {
            isotropic,
            sh_degree: 0,
            time_degree: 0,
        };
        let backend = Box::new(GpuBackend::new(gpu.clone(), None, &config));
        warm_up(&wall(), layout, &config, backend).unwrap();
    }
    gpu.give_back().unwrap();
    let after = gpu.memory().in_use;
    assert!(
        after <= before,
        "{after} bytes after warm-ups, {before} before"
    );
}
