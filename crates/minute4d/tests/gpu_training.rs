//! Training on a GPU learns what training on the processor learns. Without a GPU it runs on a software Vulkan driver (lavapipe), where
//! that is installed; without that either, every test says so and ends.
#![cfg(feature = "gpu")]
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use m4_core::{Capture, CaptureFrame, Column, CounterRng, Exposure, Intrinsics, Plane, Silent, SplatLayout, Splats};
use m4_kernels::adam::cpu::AdamState;
use m4_kernels::loss::cpu::Target;
use m4_kernels::{Renderer, SimdLevel, View};
use m4_testkit::{MovingScene, Need, moving_scene, skip};
use m4_train::config::PruneRule;
use m4_train::density::Scores;
use m4_train::device::{
    ColourGradient, DensifyPlan, DensifyStats, DeviceFound, DeviceLook, DeviceRound, DeviceStep, ScoreSettings,
};
use m4_train::{DensityConfig, Device, DeviceError, TrainConfig, Trainer};
use minute4d::device::{DeviceChoice, OpenGpu};

const FRAMES: usize = 6;

/// The best GPU, or a software Vulkan driver (lavapipe).
#[track_caller]
fn gpu() -> Option<OpenGpu> {
    let opened = DeviceChoice::Gpu(None)
        .open()
        .or_else(|_| DeviceChoice::Gpu(Some(0)).open());
    match opened {
        Ok(gpu) => gpu,
        Err(error) => {
            skip(Need::Vulkan, &error.to_string());
            None
        }
    }
}

fn view(scene: &MovingScene, frame: usize) -> View {
    View {
        camera: scene.cameras[frame],
        t: frame as f64,
        background: [0.0; 3],
        near: 0.1,
        mip: true,
        period: (FRAMES - 1) as f32,
        with_depth: true,
    }
}

/// A ball that moves before a wall, and the video that a renderer makes of it.
fn video() -> (MovingScene, Capture) {
    let mut scene = moving_scene(Intrinsics::centred(64, 48, 60.0), FRAMES);
    let n_static = scene.splats.n_static();
    for (i, z) in scene.splats.column_mut(Column::Mean, 2)[..n_static]
        .iter_mut()
        .enumerate()
    {
        *z += 0.2 * ((i * 7919) % 101) as f32 / 101.0;
    }
    let mut renderer = Renderer::new(SimdLevel::best());
    let frames = (0..FRAMES).map(|i| {
        let frame = renderer.render(&scene.splats, &view(&scene, i));
        let (w, h) = (frame.width, frame.height);
        let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
        let depth = |i: usize| match 1.0 - frame.transmittance[i] {
            alpha if alpha > 0.5 => frame.depth[i] / alpha,
            _ => 0.0,
        };
        CaptureFrame {
            name: format!("{i:03}"),
            camera: scene.cameras[i],
            t: i as f64,
            rgb: Plane::from_fn(w, h, |x, y| [0, 1, 2].map(|c| byte(frame.rgb[c][y * w + x]))),
            depth: Some(Plane::from_fn(w, h, |x, y| depth(y * w + x)).into()),
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
        }
    });
    let frames = frames.collect();
    let capture = Capture {
        frames,
        time_frames: FRAMES,
        duration_s: None,
        metric: true,
        tracks: None,
    };
    (scene, capture)
}

/// The splats of the scene with colours and places disturbed.
fn start(scene: &MovingScene) -> Splats {
    let from = &scene.splats;
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 0,
        time_degree: 0,
    };
    let mut out = Splats::zeros(layout, from.n_static(), from.n_dynamic());
    let mut rng = CounterRng::new(7, 0, 0);
    for column in [Column::Mean, Column::Colour, Column::TimeMean, Column::LogTimeSd] {
        for k in 0..layout.range(column).len() {
            out.column_mut(column, k).copy_from_slice(from.column(column, k));
        }
    }
    for k in 0..3 {
        out.column_mut(Column::LogScale, k)
            .copy_from_slice(from.column(Column::LogScale, 0));
        for c in out.column_mut(Column::Colour, k) {
            *c += 0.5 * rng.normal() as f32;
        }
        for c in out.column_mut(Column::Mean, k) {
            *c += 0.01 * rng.normal() as f32;
        }
    }
    out.column_mut(Column::Opacity, 0).fill(1.0);
    out.column_mut(Column::Quat, 0).fill(1.0);
    out
}

/// Density control, a fit of colours and a new order within this many steps.
fn config(iterations: usize) -> TrainConfig {
    let mut config = TrainConfig::fast();
    config.iterations = iterations;
    config.seed = 5;
    config.density = DensityConfig {
        from: 20,
        every: 20,
        prune_every: 40,
        ..DensityConfig::fast()
    };
    config.reorder_every = 30;
    config
}

fn train<'a>(scene: &MovingScene, capture: &'a Capture, config: TrainConfig, gpu: Option<&OpenGpu>) -> Trainer<'a> {
    let mut trainer = Trainer::new(capture, start(scene), config, SimdLevel::best()).unwrap();
    if let Some(gpu) = gpu {
        trainer.use_device(gpu.training(None, 1).unwrap());
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
fn a_gpu_learns_what_the_processor_learns() {
    let Some(gpu) = gpu() else {
        return;
    };
    let (scene, capture) = video();
    let before = psnr(&start(&scene), &scene, &capture);
    let faithful = TrainConfig {
        iterations: 60,
        seed: 5,
        ..TrainConfig::faithful()
    };
    let mut everything = config(60);
    everything.batch = 2;
    let refine = &mut everything.refine;
    (refine.poses, refine.focal, refine.exposure, refine.from) = (true, true, true, 10);
    for (config, gain) in [(config(120), 2.0), (faithful, 1.0), (everything, 1.0)] {
        let here = train(&scene, &capture, config.clone(), None);
        let there = train(&scene, &capture, config, Some(&gpu));
        let [a, b] = [&here, &there].map(|t| psnr(t.splats(), &scene, &capture));
        assert!(a > before + gain, "the processor learns: {before:.2} to {a:.2} dB");
        assert!((a - b).abs() < 0.1, "processor {a:.3} dB, GPU {b:.3} dB");
        let (n, m) = (here.splats().n() as f64, there.splats().n() as f64);
        assert!((n - m).abs() < 0.03 * n + 2.0, "{n} and {m} splats");
    }
}

/// A GPU that leaves density control to the trainer.
#[derive(Debug)]
struct WithoutRounds(Box<dyn Device>);

impl Device for WithoutRounds {
    fn name(&self) -> String {
        self.0.name()
    }

    fn set_frames(&mut self, frames: Vec<Target>) -> Result<(), DeviceError> {
        self.0.set_frames(frames)
    }

    fn set_exposures(&mut self, exposures: &[Exposure]) -> Result<(), DeviceError> {
        self.0.set_exposures(exposures)
    }

    fn upload(&mut self, splats: &Splats, adam: &AdamState) -> Result<(), DeviceError> {
        self.0.upload(splats, adam)
    }

    fn regrow(&mut self, next: &DensifyPlan<'_>) -> Result<(), DeviceError> {
        self.0.regrow(next)
    }

    fn reorder(&mut self) -> Result<(), DeviceError> {
        self.0.reorder()
    }

    fn splats(&mut self) -> Result<Splats, DeviceError> {
        self.0.splats()
    }

    fn adam(&mut self) -> Result<AdamState, DeviceError> {
        self.0.adam()
    }

    fn step(&mut self, looks: &[DeviceLook<'_>], settings: &DeviceStep<'_>) -> Result<(), DeviceError> {
        self.0.step(looks, settings)
    }

    fn found(&mut self) -> Result<DeviceFound, DeviceError> {
        self.0.found()
    }

    fn score(&mut self, looks: &[(usize, View)], settings: &ScoreSettings) -> Result<Scores, DeviceError> {
        self.0.score(looks, settings)
    }

    fn densify(&mut self, _: &DeviceRound<'_>) -> Result<Option<DensifyStats>, DeviceError> {
        Ok(None)
    }

    fn colour_gradient(&mut self, looks: &[(usize, View)], with_weight: bool) -> Result<ColourGradient, DeviceError> {
        self.0.colour_gradient(looks, with_weight)
    }
}

#[test]
fn a_gpu_densifies_and_prunes_as_the_processor_does() {
    let Some(gpu) = gpu() else {
        return;
    };
    let (scene, capture) = video();
    let mut literal = config(80);
    literal.density = DensityConfig {
        prune_rule: PruneRule::Literal,
        prune_threshold: 0.5,
        prune_every: 20,
        max_growth: 2.0,
        budget: 0.2,
        final_opacity: 0.3,
        ..literal.density
    };
    for config in [config(80), literal] {
        let there = train(&scene, &capture, config.clone(), Some(&gpu));
        let mut here = Trainer::new(&capture, start(&scene), config, SimdLevel::best()).unwrap();
        here.use_device(Box::new(WithoutRounds(gpu.training(None, 1).unwrap())));
        here.run(&Silent, &mut |_| {}).unwrap();
        let [a, b] = [&here, &there].map(|t| psnr(t.splats(), &scene, &capture));
        let [n, m] = [&here, &there].map(|t| t.splats().n());
        assert_ne!(n, start(&scene).n());
        // new splats differ in their last digits
        assert!((a - b).abs() < 0.05, "processor {a:.3} dB, GPU {b:.3} dB");
        assert!(n.abs_diff(m) * 100 <= n, "{n} and {m} splats");
    }
}

#[test]
fn the_same_gpu_gives_the_same_bits_and_a_saved_run_goes_on() {
    let Some(gpu) = gpu() else {
        return;
    };
    let (scene, capture) = video();
    let whole = train(&scene, &capture, config(60), Some(&gpu));
    let again = train(&scene, &capture, config(60), Some(&gpu));
    assert!(whole.splats() == again.splats(), "twice the same");

    let mut half = Trainer::new(&capture, start(&scene), config(60), SimdLevel::best()).unwrap();
    half.use_device(gpu.training(None, 1).unwrap());
    half.run_until(33, &Silent, &mut |_| {}).unwrap();
    let (saved, state) = (half.scene(), half.state());
    let mut rest = Trainer::resume(&capture, saved.splats, &state, config(60), SimdLevel::best()).unwrap();
    rest.use_device(gpu.training(None, 1).unwrap());
    rest.run(&Silent, &mut |_| {}).unwrap();
    assert!(whole.splats() == rest.splats(), "resumed");
    assert!(whole.state() == rest.state(), "the optimiser's state too");
}

#[test]
fn memory_that_was_not_allowed_is_refused_with_numbers_and_frames_are_streamed() {
    let Some(gpu) = gpu() else {
        return;
    };
    let (scene, capture) = video();
    let run = |limit_mb: Option<usize>| {
        let mut trainer = Trainer::new(&capture, start(&scene), config(12), SimdLevel::best()).unwrap();
        trainer.use_device(gpu.training(limit_mb, 1).unwrap());
        let end = trainer.run(&Silent, &mut |_| {});
        (end, trainer.splats().clone())
    };
    let (end, kept) = run(Some(1));
    let error = end.unwrap_err().to_string();
    for part in ["MB", "splats", "moments", "frames"] {
        assert!(error.contains(part), "{part}: {error}");
    }
    assert_eq!(kept.n(), start(&scene).n());
    // as little as it takes
    let enough = (2..200).find(|&mb| run(Some(mb)).0.is_ok()).unwrap();
    let (unlimited, limited) = (run(None).1, run(Some(enough)).1);
    assert!(unlimited == limited, "{enough} MB");
}
