//! Sums for the fit of colours.

use crate::batch::{CASTS, exposed, pulled_back};
use crate::gpu;
use crate::step::{image, start};
use m4_core::{Column, Exposure, Splats};
use m4_kernels::adam::cpu::AdamState;
use m4_kernels::loss::cpu::Target;
use m4_kernels::{FrameGradient, Gradients, Renderer, SimdLevel, View, Wanted};
use m4_testkit::assert_gradient;
use m4_train::backend::gpu::GpuTrainer;

/// Residual, weight.
fn on_the_cpu(
    splats: &Splats,
    frames: &[Target],
    views: &[(usize, View)],
    exposures: &[Exposure],
) -> [[Vec<f64>; 3]; 2] {
    let mut renderer = Renderer::new(SimdLevel::best());
    let zero = || [0, 1, 2].map(|_| vec![0.0; splats.n()]);
    let (mut residual, mut weight) = (zero(), zero());
    let first = splats.layout().column(Column::Colour);
    let add = |renderer: &mut Renderer, g: &FrameGradient, to: &mut [Vec<f64>; 3]| {
        let mut out = Gradients::default();
        renderer.backward(splats, g, Wanted::default(), &mut out);
        for (k, to) in to.iter_mut().enumerate() {
            for (i, to) in to.iter_mut().enumerate().filter(|&(i, _)| out.touched[i] == 1) {
                *to += f64::from(out.columns[first + k][i]);
            }
        }
    };
    for (frame, view) in views {
        let drawn = exposed(exposures.get(*frame), &renderer.render(splats, view).rgb);
        let target = frames[*frame].rgb();
        let rgb = [0, 1, 2].map(|k| -> Vec<f32> { drawn[k].iter().zip(&target[k]).map(|(a, b)| a - b).collect() });
        let mut g = FrameGradient { rgb: pulled_back(exposures.get(*frame), &rgb), ..FrameGradient::default() };
        add(&mut renderer, &g, &mut residual);
        g.rgb.iter_mut().for_each(|plane| plane.fill(1.0));
        add(&mut renderer, &g, &mut weight);
    }
    [residual, weight]
}

#[test]
fn sums_are_those_of_the_cpu() {
    let Some(gpu) = gpu("sums of colours") else { return };
    let (splats, view) = start();
    let frames = [image(0), image(2)];
    let views = [(0, view), (1, View { t: 6.5, ..view })];
    let mut trainer = GpuTrainer::new(gpu, &splats, &AdamState::new(&splats), &frames, usize::MAX).unwrap();
    for exposures in [&CASTS[..0], &CASTS[..1]] {
        trainer.set_exposures(exposures);
        let [residual, weight] = on_the_cpu(&splats, &frames, &views, exposures);
        let got = trainer.colour_sums(&views, true).unwrap();
        let wide = |plane: &[f32]| -> Vec<f64> { plane.iter().map(|&v| f64::from(v)).collect() };
        for k in 0..3 {
            assert_gradient("residuals", &wide(&got.residual[k]), &residual[k], 5e-3);
            assert_gradient("weights", &wide(&got.weight[k]), &weight[k], 5e-3);
        }
        let again = trainer.colour_sums(&views, false).unwrap();
        assert_eq!(again.residual, got.residual, "the same bits");
        assert!(again.weight.iter().all(Vec::is_empty));
    }
    assert_eq!(trainer.download_splats().unwrap(), splats, "nothing moves");
}
