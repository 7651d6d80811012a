//! A whole step: loss, gradient, optimiser.

use crate::gpu;
use m4_core::{SplatLayout, Splats};
use m4_kernels::{
    Gradients, Kernel, Renderer, SimdLevel, View,
    adam::{
        cpu::{AdamConfig, AdamState, step},
        nodes::NodeRates,
    },
    bench::{Bench as HostBench, SceneConfig},
    cover,
    loss::cpu::{LossScratch, Target, loss},
};
use m4_testkit::{SceneSpec, assert_gradient, random_camera, random_splats};
use m4_train::backend::{
    StepSettings, StepView,
    gpu::{Bench, GpuTrainer},
};

pub const LAYOUT: SplatLayout = SplatLayout {
    isotropic: false,
    sh_degree: 1,
    time_degree: 0,
};
pub const SIZE: (usize, usize) = (75, 50);
pub const LAMBDA: f32 = 0.4;
/// Large enough to change many steps.
pub const COVER: f32 = 0.5;
/// Of nodes, if there are any.
pub const NODES: NodeRates = NodeRates {
    position: 2e-3,
    turn: 3e-3,
};

pub fn image(shift: usize) -> Target {
    let plane = |value: fn(usize, usize, usize) -> usize| -> Vec<u8> {
        let pixels = (0..SIZE.0 * SIZE.1).map(|i| (i % SIZE.0, i / SIZE.0));
        pixels.map(|(x, y)| value(x, y, shift) as u8).collect()
    };
    let planes = [
        plane(|x, _, s| 3 * x + s),
        plane(|_, y, _| 5 * y),
        plane(|x, y, s| x * y / 8 + 40 * s),
    ];
    Target::from_bytes(SIZE.0, SIZE.1, planes).unwrap()
}

pub fn start() -> (Splats, View) {
    let camera = random_camera(11, SIZE.0, SIZE.1);
    let spec = SceneSpec {
        layout: LAYOUT,
        n_static: 300,
        n_dynamic: 200,
        ..SceneSpec::default()
    };
    let view = View {
        camera,
        t: 4.0,
        background: [0.3; 3],
        near: 0.01,
        mip: true,
        period: 10.0,
        with_depth: false,
    };
    (random_splats(11, &camera, &spec), view)
}

/// Steps of [`LAMBDA`] without cover.
pub fn settings(rates: &[f32]) -> StepSettings<'_> {
    StepSettings {
        lambda_ssim: LAMBDA,
        cover: 0.0,
        rates,
        nodes: NODES,
        adam: AdamConfig::default(),
        psnr: true,
    }
}

struct Host {
    splats: Splats,
    adam: AdamState,
    l1: f64,
    ssim: f64,
    /// Of the last frame.
    psnr: f64,
    touched: f64,
}

fn on_the_cpu(frames: &[Target], config: &AdamConfig, rates: &[f32], steps: usize) -> Host {
    let (mut splats, view) = start();
    let mut adam = AdamState::new(&splats);
    let mut renderer = Renderer::new(SimdLevel::best());
    let (mut scratch, mut out, mut gradients) = (
        LossScratch::default(),
        Default::default(),
        Gradients::default(),
    );
    let (mut l1, mut ssim, mut psnr, mut touched) = (0.0, 0.0, 0.0, 0.0);
    for i in 0..steps {
        let target = &frames[i % frames.len()];
        let drawn = renderer.render(&splats, &view);
        let terms = loss(
            SimdLevel::best(),
            target,
            &drawn.rgb,
            LAMBDA,
            &mut scratch,
            &mut out,
        );
        (l1, ssim) = (
            l1 + terms.l1 / steps as f64,
            ssim + terms.ssim / steps as f64,
        );
        psnr = shown(&drawn.rgb, target);
        renderer.backward(&splats, &out, false, &mut gradients);
        touched += gradients.touched.iter().filter(|&&t| t == 1).count() as f64 / steps as f64;
        cover::cpu::add(&splats, &mut gradients, COVER / (SIZE.0 * SIZE.1) as f32);
        step(
            SimdLevel::best(),
            &mut splats,
            &gradients,
            &mut adam,
            config,
            rates,
        );
    }
    Host {
        splats,
        adam,
        l1,
        ssim,
        psnr,
        touched,
    }
}

/// PSNR with colours clamped to 0..1.
fn shown(rgb: &[Vec<f32>; 3], target: &Target) -> f64 {
    let (target, mut sum) = (target.rgb().concat(), 0.0);
    for (a, b) in rgb.concat().iter().zip(&target) {
        sum += f64::from(a.clamp(0.0, 1.0) - b).powi(2);
    }
    -10.0 * (sum / target.len() as f64).log10()
}

pub fn columns(splats: &Splats) -> Vec<f64> {
    splats
        .columns()
        .iter()
        .flatten()
        .map(|&v| f64::from(v))
        .collect()
}

#[test]
fn steps_are_those_of_the_cpu() {
    let Some(gpu) = gpu("steps") else { return };
    let frames = [image(0), image(2)];
    let rates: Vec<f32> = (0..LAYOUT.columns())
        .map(|c| 1e-4 * (1 + c % 3) as f32)
        .collect();
    for sparse in [true, false] {
        let config = AdamConfig {
            sparse,
            ..AdamConfig::default()
        };
        let steps = 4;
        let want = on_the_cpu(&frames, &config, &rates, steps);
        let (splats, view) = start();
        let mut trainer =
            GpuTrainer::new(gpu.clone(), &splats, &AdamState::new(&splats), &frames, 0).unwrap();
        let settings = StepSettings {
            cover: COVER,
            adam: config,
            ..settings(&rates)
        };
        for i in 0..steps {
            trainer
                .step(&[StepView::new(i % frames.len(), &view)], &settings)
                .unwrap();
        }
        let stats = trainer.stats().unwrap();
        assert_eq!(stats.steps, steps);
        assert!(
            (stats.l1 - want.l1).abs() < 1e-5,
            "l1 {} for {}",
            stats.l1,
            want.l1
        );
        assert!(
            (stats.ssim - want.ssim).abs() < 1e-4,
            "ssim {} for {}",
            stats.ssim,
            want.ssim
        );
        assert!(
            (stats.psnr - want.psnr).abs() < 1e-2,
            "{} dB for {}",
            stats.psnr,
            want.psnr
        );
        assert!(
            (stats.touched - want.touched).abs() <= 1.0,
            "{} touched",
            stats.touched
        );
        assert!(stats.l1.is_finite() && stats.splats_are_finite);
        let again = trainer.stats().unwrap();
        assert!(again.steps == 0 && again.psnr.is_nan());
        let (got, adam) = trainer.download().unwrap();
        let different = adam
            .step
            .iter()
            .zip(&want.adam.step)
            .filter(|(a, b)| a != b)
            .count();
        assert!(different <= 2, "{different} counts of steps");
        assert_gradient(
            "first moments",
            &columns(&adam.m),
            &columns(&want.adam.m),
            5e-3,
        );
        assert_gradient(
            "second moments",
            &columns(&adam.v),
            &columns(&want.adam.v),
            5e-3,
        );
        let moved = |to: &Splats| -> Vec<f64> {
            columns(to)
                .iter()
                .zip(columns(&splats))
                .map(|(a, b)| a - b)
                .collect()
        };
        let (got, want) = (moved(&got), moved(&want.splats));
        // Adam moves by the sign of what is next to nothing too
        let off = got
            .iter()
            .zip(&want)
            .filter(|(a, b)| (*a - *b).abs() > 2e-5)
            .count();
        assert!(
            off * 50 < want.len(),
            "{off} of {} parameters went elsewhere",
            want.len()
        );
    }
}

#[test]
fn splats_may_be_replaced() {
    let Some(gpu) = gpu("replacing splats") else {
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
    let fewer = splats.gather(&(0..400).collect::<Vec<u32>>()).unwrap();
    trainer.replace(&fewer, &AdamState::new(&fewer)).unwrap();
    let rates = vec![0.0; LAYOUT.columns()];
    let settings = settings(&rates);
    trainer.step(&[StepView::new(0, &view)], &settings).unwrap();
    let (got, adam) = trainer.download().unwrap();
    assert_eq!(got, fewer, "rates of 0");
    assert!(adam.step.contains(&1) && adam.step.iter().all(|&s| s <= 1));
    let want = Renderer::new(SimdLevel::best())
        .render(&fewer, &view)
        .clone();
    let frame = trainer.frame().unwrap();
    let off = frame.rgb[0]
        .iter()
        .zip(&want.rgb[0])
        .filter(|(a, b)| (*a - *b).abs() > 1e-3)
        .count();
    assert_eq!(off, 0);
}

#[test]
fn non_finite_parameters_are_reported() {
    let Some(gpu) = gpu("broken steps") else {
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
    let mut rates = vec![0.0; LAYOUT.columns()];
    rates[4] = f32::INFINITY;
    let settings = settings(&rates);
    trainer.step(&[StepView::new(0, &view)], &settings).unwrap();
    let stats = trainer.stats().unwrap();
    assert!(stats.l1.is_finite() && !stats.splats_are_finite);
    let nowhere = View {
        background: [f32::NAN; 3],
        ..view
    };
    trainer
        .step(&[StepView::new(0, &nowhere)], &settings)
        .unwrap();
    assert!(trainer.stats().unwrap().l1.is_nan());
}

#[test]
fn frames_of_several_sizes_and_none_are_refused() {
    let Some(gpu) = gpu("other frames") else {
        return;
    };
    let (splats, _) = start();
    let adam = AdamState::new(&splats);
    let (w, h) = (SIZE.0 / 2, SIZE.1 / 2);
    let half = Target::from_bytes(w, h, [0, 1, 2].map(|_| vec![0; w * h])).unwrap();
    let mixed = GpuTrainer::new(gpu.clone(), &splats, &adam, [half, image(0)], 0).unwrap_err();
    assert!(mixed.to_string().contains("frame 1 has 75 x 50"), "{mixed}");
    assert!(GpuTrainer::new(gpu, &splats, &adam, Vec::<Target>::new(), 0).is_err());
}

#[test]
fn a_bench_times_every_kernel_and_lowers_the_loss() {
    let Some(gpu) = gpu("the bench") else { return };
    let config = SceneConfig {
        splats: 3000,
        width: 96,
        height: 72,
        ..SceneConfig::default()
    };
    let mut host = HostBench::new(SimdLevel::best(), &config).unwrap();
    let counts = host.count(0);
    let mut bench = Bench::new(gpu.clone(), host.into_scene()).unwrap();
    let entries = bench.entries(0).unwrap();
    assert!(
        entries >= counts.visible && entries <= bench.room(),
        "{entries} for {counts:?}"
    );
    // larger tiles, so fewer entries, of which each is at most 16 of the CPU's
    assert!(
        entries < counts.pairs && 16 * entries > counts.pairs,
        "{entries} for {counts:?}"
    );
    let laps = bench.laps(0).unwrap();
    for (kernel, lap) in Kernel::ALL.iter().zip(laps) {
        assert!(!lap.is_zero(), "{} took no time", kernel.name());
    }
    let first = bench.stats().unwrap();
    for _ in 0..8 {
        bench.step(0).unwrap();
    }
    let last = bench.stats().unwrap();
    assert!(
        last.steps == 8 && last.l1 < first.l1,
        "{last:?} after {first:?}"
    );
    let mut drawing = bench.into_drawing().unwrap();
    let laps = drawing.laps(0).unwrap();
    for (kernel, lap) in Kernel::ALL.iter().zip(laps) {
        assert_eq!(
            lap.is_zero(),
            !kernel.renders(),
            "{}: {lap:?}",
            kernel.name()
        );
    }
}
