//! A whole step: loss, gradient, optimiser.

use crate::gpu;
use m4_gpu::{StepSettings, Trainer};
use m4_kernels::{
    FrameGradient, Gradients, Renderer, SimdLevel, View, Wanted,
    adam::cpu::{AdamConfig, AdamState, step},
    photo::cpu::{PhotoScratch, Target, loss},
};
use m4_scene::{Plane, RgbImage, SplatLayout, Splats};
use m4_testkit::{SceneSpec, assert_gradient, random_camera, random_splats};

const LAYOUT: SplatLayout = SplatLayout {
    isotropic: false,
    sh_degree: 1,
    time_degree: 0,
};
const SIZE: (usize, usize) = (75, 50);
const LAMBDA: f32 = 0.4;

fn picture(shift: usize) -> RgbImage {
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
        [(3 * x + shift) as u8, (5 * y) as u8, (x * y / 8 + 40 * shift) as u8]
    })
}

fn start() -> (Splats, View) {
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

struct Host {
    splats: Splats,
    adam: AdamState,
    l1: f64,
    ssim: f64,
}

fn on_the_processor(frames: &[RgbImage], config: &AdamConfig, rates: &[f32], steps: usize) -> Host {
    let (mut splats, view) = start();
    let mut adam = AdamState::new(&splats);
    let mut renderer = Renderer::new(SimdLevel::best());
    let (mut scratch, mut out, mut gradients) =
        (PhotoScratch::default(), FrameGradient::default(), Gradients::default());
    let (mut l1, mut ssim) = (0.0, 0.0);
    for i in 0..steps {
        let planes = [0, 1, 2].map(|k| {
            let rows = (0..SIZE.1).flat_map(|y| frames[i % frames.len()].row(y).iter());
            rows.map(|p| p[k]).collect::<Vec<u8>>()
        });
        let target = Target::from_bytes(SIZE.0, SIZE.1, planes).unwrap();
        let drawn = renderer.render(&splats, &view);
        let found = loss(
            SimdLevel::best(),
            &target,
            &drawn.rgb,
            LAMBDA,
            &mut scratch,
            &mut out.rgb,
        );
        (l1, ssim) = (l1 + found.l1 / steps as f64, ssim + found.ssim / steps as f64);
        renderer.backward(&splats, &out, Wanted::default(), &mut gradients);
        step(SimdLevel::best(), &mut splats, &gradients, &mut adam, config, rates);
    }
    Host { splats, adam, l1, ssim }
}

fn columns(splats: &Splats) -> Vec<f64> {
    splats.columns().iter().flatten().map(|&v| f64::from(v)).collect()
}

#[test]
fn steps_are_those_of_the_processor() {
    let Some(gpu) = gpu("steps") else { return };
    let frames = [picture(0), picture(2)];
    let rates: Vec<f32> = (0..LAYOUT.columns()).map(|c| 1e-4 * (1 + c % 3) as f32).collect();
    for sparse in [true, false] {
        let config = AdamConfig {
            sparse,
            ..AdamConfig::default()
        };
        let steps = 4;
        let want = on_the_processor(&frames, &config, &rates, steps);
        let (splats, view) = start();
        let mut trainer = Trainer::new(gpu.clone(), &splats, &AdamState::new(&splats), &frames).unwrap();
        let settings = StepSettings {
            lambda_ssim: LAMBDA,
            rates: &rates,
            adam: config,
            shared_steps: None,
        };
        for i in 0..steps {
            trainer.step(i % frames.len(), &view, &settings);
        }
        let found = trainer.found().unwrap();
        assert_eq!(found.steps, steps);
        assert!((found.l1 - want.l1).abs() < 1e-5, "l1 {} for {}", found.l1, want.l1);
        assert!(
            (found.ssim - want.ssim).abs() < 1e-4,
            "ssim {} for {}",
            found.ssim,
            want.ssim
        );
        let (got, adam) = trainer.download().unwrap();
        let different = adam.step.iter().zip(&want.adam.step).filter(|(a, b)| a != b).count();
        assert!(different <= 2, "{different} counts of steps");
        assert_gradient("first moments", &columns(&adam.m), &columns(&want.adam.m), 5e-3);
        assert_gradient("second moments", &columns(&adam.v), &columns(&want.adam.v), 5e-3);
        let moved =
            |to: &Splats| -> Vec<f64> { columns(to).iter().zip(columns(&splats)).map(|(a, b)| a - b).collect() };
        let (got, want) = (moved(&got), moved(&want.splats));
        // Adam moves by the sign of what is next to nothing too
        let off = got.iter().zip(&want).filter(|(a, b)| (*a - *b).abs() > 2e-5).count();
        assert!(
            off * 50 < want.len(),
            "{off} of {} parameters went elsewhere",
            want.len()
        );
    }
}

#[test]
fn splats_may_be_replaced() {
    let Some(gpu) = gpu("replacing splats") else { return };
    let (splats, view) = start();
    let mut trainer = Trainer::new(gpu, &splats, &AdamState::new(&splats), &[picture(0)]).unwrap();
    let fewer = splats.gather(&(0..400).collect::<Vec<u32>>()).unwrap();
    trainer.replace(&fewer, &AdamState::new(&fewer)).unwrap();
    let rates = vec![0.0; LAYOUT.columns()];
    let settings = StepSettings {
        lambda_ssim: LAMBDA,
        rates: &rates,
        adam: AdamConfig::default(),
        shared_steps: Some(7),
    };
    trainer.step(0, &view, &settings);
    let (got, adam) = trainer.download().unwrap();
    assert_eq!(got, fewer, "rates of 0");
    assert!(adam.step.iter().all(|&s| s == 7));
    let want = Renderer::new(SimdLevel::best()).render(&fewer, &view).clone();
    let frame = trainer.frame().unwrap();
    let off = frame.rgb[0]
        .iter()
        .zip(&want.rgb[0])
        .filter(|(a, b)| (*a - *b).abs() > 1e-3)
        .count();
    assert_eq!(off, 0);
}
