//! Training on a GPU learns what training on the CPU learns.

use crate::common::{
    FRAMES, add_harmonics, disturbed, filmed, halves_have_the_colour_of_their_time, video,
};
use crate::gpu;
use m4_core::{Capture, Column, Silent, Splats};
use m4_kernels::gpu::Gpu;
use m4_kernels::{Renderer, SimdLevel, View};
use m4_testkit::MovingScene;
use m4_train::backend::gpu::GpuBackend;
use m4_train::config::SplitPlacement;
use m4_train::{Backend, ColourDegree, DensityConfig, TrainConfig, Trainer};

fn view(scene: &MovingScene, frame: usize) -> View {
    View {
        camera: scene.cameras[frame],
        t: frame as f64,
        background: [0.0; 3],
        near: 0.1,
        mip: true,
        period: (FRAMES - 1) as f32,
        with_depth: false,
    }
}

fn start(scene: &MovingScene) -> Splats {
    disturbed(scene, 7)
}

fn backend(gpu: &Gpu, limit_mb: Option<usize>) -> Box<dyn Backend> {
    Box::new(GpuBackend::new(gpu.clone(), limit_mb, &TrainConfig::fast()))
}

/// Density control and a fit of colours within this many steps.
fn config(iterations: usize) -> TrainConfig {
    let mut config = TrainConfig::fast();
    config.iterations = iterations;
    config.seed = 5;
    config.density = DensityConfig {
        from: 0.2,
        every: 0.2,
        prune_every: 0.4,
        ..DensityConfig::fast()
    };
    config
}

/// Density control as 3DGS does it.
fn by_gradient(iterations: usize) -> TrainConfig {
    let density = DensityConfig {
        from: 0.25,
        every: 0.25,
        until: 0.7,
        ..DensityConfig::by_gradient()
    };
    TrainConfig {
        density,
        ..config(iterations)
    }
}

fn train<'a>(
    scene: &MovingScene,
    capture: &'a Capture,
    config: TrainConfig,
    gpu: Option<&Gpu>,
) -> Trainer<'a> {
    let mut trainer = Trainer::new(capture, start(scene), config, SimdLevel::best()).unwrap();
    if let Some(gpu) = gpu {
        trainer.use_backend(backend(gpu, None)).unwrap();
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
        let drawn = renderer.render(splats, &view(scene, i));
        let (w, h) = (drawn.width, drawn.height);
        for (c, plane) in drawn.rgb.iter().enumerate() {
            for (at, &value) in plane.iter().enumerate() {
                let target = f64::from(frame.rgb[(at % w, at / w)][c]) / 255.0;
                squares += (f64::from(value.clamp(0.0, 1.0)) - target).powi(2);
            }
        }
        values += 3 * w * h;
    }
    -10.0 * (squares / values as f64).log10()
}

#[test]
fn a_gpu_learns_what_the_cpu_learns() {
    let Some(gpu) = gpu("training") else {
        return;
    };
    let (scene, capture) = video();
    let before = psnr(&start(&scene), &scene, &capture);
    // One round each: in so short a run, a second one splits splats that are not trained yet, and
    // what follows multiplies every rounding difference by a hundred.
    let density = DensityConfig {
        from: 0.4,
        every: 0.4,
        prune_every: 0.4,
        ..DensityConfig::faithful()
    };
    let faithful = TrainConfig {
        iterations: 60,
        seed: 5,
        density,
        ..TrainConfig::faithful()
    };
    let mut by_gradient = by_gradient(80);
    (by_gradient.density.from, by_gradient.density.every) = (0.4, 0.4);
    let mut drawn = config(60);
    drawn.density.split_placement = SplitPlacement::Sample;
    let mut everything = config(60);
    everything.batch = 2;
    let refine = &mut everything.refine;
    (refine.poses, refine.focal, refine.exposure, refine.from) = (true, true, true, 10);
    for (config, gain) in [
        (config(120), 2.0),
        (faithful, 0.7),
        (drawn, 1.0),
        (everything, 1.0),
        (by_gradient, 0.3),
    ] {
        let on_cpu = train(&scene, &capture, config.clone(), None);
        let on_gpu = train(&scene, &capture, config, Some(&gpu));
        let [a, b] = [&on_cpu, &on_gpu].map(|t| psnr(t.splats(), &scene, &capture));
        assert!(
            a > before + gain,
            "the CPU learns: {before:.2} to {a:.2} dB"
        );
        assert!((a - b).abs() < 0.1, "CPU {a:.3} dB, GPU {b:.3} dB");
        let (n, m) = (on_cpu.splats().n() as f64, on_gpu.splats().n() as f64);
        assert!((n - m).abs() < 0.03 * n + 2.0, "{n} and {m} splats");
    }
}

#[test]
fn the_same_gpu_gives_the_same_bits_and_a_saved_run_goes_on() {
    let Some(gpu) = gpu("training") else {
        return;
    };
    let (scene, capture) = video();
    let twice = |config: fn(usize) -> TrainConfig| {
        let [whole, again] = [(); 2].map(|()| train(&scene, &capture, config(60), Some(&gpu)));
        assert!(whole.splats() == again.splats(), "twice the same");
        whole
    };
    assert!(twice(by_gradient).splats().n() > start(&scene).n());
    let whole = twice(config);

    let mut half = Trainer::new(&capture, start(&scene), config(60), SimdLevel::best()).unwrap();
    half.use_backend(backend(&gpu, None)).unwrap();
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
    rest.use_backend(backend(&gpu, None)).unwrap();
    rest.run(&Silent, &mut |_| {}).unwrap();
    assert!(whole.splats() == rest.splats(), "resumed");
    assert!(whole.state() == rest.state(), "the optimiser's state too");
}

#[test]
fn memory_that_was_not_allowed_is_refused_with_numbers_and_frames_are_streamed() {
    let Some(gpu) = gpu("training") else {
        return;
    };
    let (scene, capture) = video();
    let run = |limit_mb: Option<usize>| {
        let mut trainer =
            Trainer::new(&capture, start(&scene), config(12), SimdLevel::best()).unwrap();
        trainer.use_backend(backend(&gpu, limit_mb)).unwrap();
        let end = trainer.run(&Silent, &mut |_| {});
        (end, trainer.splats().clone())
    };
    let (end, splats) = run(Some(1));
    let error = end.unwrap_err().to_string();
    for part in ["MB", "splats", "moments", "frames"] {
        assert!(error.contains(part), "{part}: {error}");
    }
    assert_eq!(splats.n(), start(&scene).n());
    // as little as it takes
    let enough = (2..200).find(|&mb| run(Some(mb)).0.is_ok()).unwrap();
    let (unlimited, limited) = (run(None).1, run(Some(enough)).1);
    assert!(unlimited == limited, "{enough} MB");
}

#[test]
fn halves_drawn_on_the_device_have_the_colour_of_their_time() {
    let Some(gpu) = gpu("phases of harmonics of time") else {
        return;
    };
    halves_have_the_colour_of_their_time(Some(backend(&gpu, None)));
}

/// Degrees rise on the way, in steps of two frames.
#[test]
fn harmonics_of_colours_are_trained_on_the_device_as_on_the_cpu() {
    let Some(gpu) = gpu("harmonics of colours") else {
        return;
    };
    let (scene, _) = video();
    let mut truth = scene.splats.clone();
    add_harmonics(&mut truth, (1, 1));
    let capture = filmed(&truth, &scene.cameras);
    let mut config = TrainConfig {
        batch: 2,
        colour_degree: ColourDegree { space: 1, time: 1 },
        ..config(60)
    };
    config.density.enabled = false;
    let [on_cpu, on_gpu] = [None, Some(&gpu)].map(|gpu| {
        train(&scene, &capture, config.clone(), gpu)
            .into_scene()
            .splats
    });
    assert_eq!(
        (on_gpu.layout().sh_degree, on_gpu.layout().time_degree),
        (1, 1)
    );
    let columns = on_cpu.layout().range(Column::Colour);
    // Adam turns the last digits of small gradients into whole steps: single coefficients differ,
    // all together do not.
    let (mut size, mut difference) = (0.0, 0.0);
    for (a, b) in on_cpu.columns()[columns.clone()]
        .iter()
        .zip(&on_gpu.columns()[columns])
        .skip(3)
    {
        assert!(a.iter().any(|&v| v != 0.0));
        for (a, b) in a.iter().zip(b) {
            size += f64::from(a * a);
            difference += f64::from((a - b) * (a - b));
        }
    }
    let share = (difference / size).sqrt();
    assert!(
        share < 0.1,
        "the coefficients differ by {share:.4} of their size"
    );
}
