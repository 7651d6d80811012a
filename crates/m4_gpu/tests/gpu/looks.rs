//! Steps of several frames, with depth and the gradient of cameras.

use crate::gpu;
use crate::step::{LAMBDA, LAYOUT, SIZE, columns, picture, start};
use m4_gpu::{DepthTerm, GpuError, Look, StepSettings, Trainer};
use m4_kernels::adam::cpu::{AdamConfig, AdamState, step};
use m4_kernels::photo::cpu::{PhotoScratch, Target, loss};
use m4_kernels::{CameraGradient, FrameGradient, Gradients, Renderer, SimdLevel, View, Wanted};
use m4_scene::Splats;
use m4_testkit::assert_gradient;

const TERM: DepthTerm = DepthTerm {
    weight: 0.7,
    huber: 0.1,
    alpha_weight: 0.05,
};

/// About where the splats are; unknown here and there.
fn depth() -> Vec<f32> {
    let unknown = [0.0, -1.0, f32::NAN, f32::INFINITY];
    let z = |i: usize| match i % 13 {
        k @ 0..4 => unknown[k],
        k => 2.0 + 0.3 * k as f32,
    };
    (0..SIZE.0 * SIZE.1).map(z).collect()
}

/// The loss of depth, and its gradient with respect to alpha and depth.
fn depth_loss(depth: &[f32], transmittance: &[f32], z: &[f32], g: &mut FrameGradient) -> f64 {
    let known: Vec<bool> = z.iter().map(|z| *z > 0.0 && z.is_finite()).collect();
    let count = known.iter().filter(|k| **k).count() as f32;
    let mut sum = 0.0;
    g.depth = vec![0.0; z.len()];
    g.alpha = vec![0.0; z.len()];
    for i in (0..z.len()).filter(|&i| known[i]) {
        let r = (depth[i] - z[i] * (1.0 - transmittance[i])) / z[i];
        let (value, slope) = if r.abs() < TERM.huber {
            (0.5 * r * r / TERM.huber, r / TERM.huber)
        } else {
            (r.abs() - 0.5 * TERM.huber, r.signum())
        };
        sum += f64::from(TERM.weight * value + TERM.alpha_weight * transmittance[i]);
        g.depth[i] = TERM.weight * slope / count / z[i];
        g.alpha[i] = -(TERM.weight * slope + TERM.alpha_weight) / count;
    }
    sum / f64::from(count)
}

/// Splats, moments, the loss of depth and the cameras' gradients after a step.
struct Host {
    adam: AdamState,
    depth: f64,
    cameras: Vec<CameraGradient>,
}

fn on_the_processor(splats: &Splats, looks: &[(Target, View, bool)], rates: &[f32]) -> Host {
    let mut renderer = Renderer::new(SimdLevel::best());
    let (mut scratch, mut cameras, mut depth_sum) = (PhotoScratch::default(), Vec::new(), 0.0);
    let mut sum = Gradients::default();
    sum.reset(splats);
    sum.columns.iter_mut().for_each(|c| c.fill(0.0));
    for (target, view, with_depth) in looks {
        let view = View {
            with_depth: *with_depth,
            ..*view
        };
        let drawn = renderer.render(splats, &view).clone();
        let mut g = FrameGradient::default();
        loss(SimdLevel::best(), target, &drawn.rgb, LAMBDA, &mut scratch, &mut g.rgb);
        if *with_depth {
            depth_sum += depth_loss(&drawn.depth, &drawn.transmittance, &depth(), &mut g);
        }
        let mut out = Gradients::default();
        let wanted = Wanted {
            camera: true,
            ..Wanted::default()
        };
        renderer.backward(splats, &g, wanted, &mut out);
        cameras.push(out.camera);
        for (to, from) in sum.columns.iter_mut().zip(&out.columns) {
            let first = splats.n() - to.len();
            for (i, to) in to.iter_mut().enumerate().filter(|&(i, _)| out.touched[first + i] == 1) {
                *to += from[i];
            }
        }
        sum.touched.iter_mut().zip(&out.touched).for_each(|(a, b)| *a |= b);
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
        depth: depth_sum,
        cameras,
    }
}

#[test]
fn a_step_of_some_frames_is_that_of_the_processor() {
    let Some(gpu) = gpu("steps of some frames") else { return };
    let (splats, view) = start();
    let rates = vec![1e-4; LAYOUT.columns()];
    let late = View { t: 6.5, ..view };
    let looks = [
        (picture(0), view, false),
        (picture(2), late, true),
        (picture(1), View { t: 0.5, ..view }, false),
    ];
    let settings = StepSettings {
        lambda_ssim: LAMBDA,
        rates: &rates,
        adam: AdamConfig::default(),
        shared_steps: None,
    };
    for chosen in [&looks[..], &looks[1..2], &looks[..1]] {
        let want = on_the_processor(&splats, chosen, &rates);
        let frames = chosen.iter().map(|(frame, ..)| frame);
        let mut trainer = Trainer::new(gpu.clone(), &splats, &AdamState::new(&splats), frames, 1 << 14).unwrap();
        let depths = chosen.iter().map(|(_, _, there)| there.then(depth));
        trainer.set_depths(depths, usize::MAX).unwrap();
        // a frame without depth has no term
        let asked: Vec<Look<'_>> = chosen
            .iter()
            .enumerate()
            .map(|(frame, (_, view, _))| Look {
                depth: Some(TERM),
                camera: true,
                ..Look::new(frame, view)
            })
            .collect();
        trainer.step_looks(&asked, &settings).unwrap();
        let found = trainer.found().unwrap();
        assert_eq!((found.steps, found.looks), (1, chosen.len()));
        let depth = found.depth * chosen.len() as f64;
        assert!((depth - want.depth).abs() < 1e-4, "depth {depth} for {}", want.depth);
        let (_, adam) = trainer.download().unwrap();
        let different = adam.step.iter().zip(&want.adam.step).filter(|(a, b)| a != b).count();
        assert!(different <= 2, "{different} splats moved by one alone");
        assert_gradient("gradients", &columns(&adam.m), &columns(&want.adam.m), 5e-3);
        assert_eq!(found.cameras.len(), chosen.len());
        for (i, ((frame, got), want)) in found.cameras.iter().zip(&want.cameras).enumerate() {
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
        assert!(trainer.found().unwrap().cameras.is_empty());
    }
}

#[test]
fn frames_that_are_not_there_are_errors() {
    let Some(gpu) = gpu("missing frames") else { return };
    let (splats, view) = start();
    let mut trainer = Trainer::new(gpu, &splats, &AdamState::new(&splats), [picture(0)], usize::MAX).unwrap();
    let rates = vec![0.0; LAYOUT.columns()];
    let settings = StepSettings {
        lambda_ssim: LAMBDA,
        rates: &rates,
        adam: AdamConfig::default(),
        shared_steps: None,
    };
    let missing = trainer.step(1, &view, &settings).unwrap_err();
    assert!(missing.to_string().contains("no frame 1"), "{missing}");
    assert!(matches!(
        trainer.set_depths([Some(vec![1.0])], 0),
        Err(GpuError::Shape(_))
    ));
    let none: [Option<Vec<f32>>; 2] = [None, None];
    assert!(matches!(trainer.set_depths(none, 0), Err(GpuError::NoFrame { .. })));
    trainer.step_looks(&[], &settings).unwrap();
    assert_eq!(trainer.found().unwrap().steps, 0);
}
