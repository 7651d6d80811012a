//! Scenes that are easily got wrong.

use crate::gpu;
use crate::twins::assert_same_gradients;
use m4_core::{Camera, Column, Intrinsics, Se3, SplatLayout, Splats};
use m4_kernels::gpu::Renderer as GpuRenderer;
use m4_kernels::{Frame, FrameGradient, Gradients, Renderer, SimdLevel, View, Wanted};

const LAYOUT: SplatLayout = SplatLayout { isotropic: false, sh_degree: 0, time_degree: 0 };

fn view(width: usize, height: usize) -> View {
    View {
        camera: Camera { intrinsics: Intrinsics::centred(width, height, width as f64), c2w: Se3::identity() },
        t: 0.0,
        background: [0.2, 0.4, 0.6],
        near: 0.01,
        mip: true,
        period: 0.0,
        with_depth: true,
    }
}

/// Grey splats at these places with about this logarithm of their size: a sphere would leave its rotation without a gradient.
fn splats(means: &[[f32; 3]], log_scale: f32) -> Splats {
    let mut out = Splats::zeros(LAYOUT, means.len(), 0);
    for (row, mean) in means.iter().enumerate() {
        for k in 0..3 {
            out.column_mut(Column::Mean, k)[row] = mean[k];
            out.column_mut(Column::LogScale, k)[row] = log_scale + 0.2 * (k as f32 - 1.0);
        }
        out.column_mut(Column::Quat, 0)[row] = 1.0;
        out.column_mut(Column::Opacity, 0)[row] = 1.0;
    }
    out
}

fn close(what: &str, got: &Frame, want: &Frame) {
    let planes = |f: &Frame| [f.rgb.concat(), f.transmittance.clone(), f.depth.clone()].concat();
    for (i, (a, b)) in planes(got).iter().zip(&planes(want)).enumerate() {
        assert!((a - b).abs() <= 1e-4 * (1.0 + b.abs()), "{what}: value {i} is {a} for {b}");
    }
}

/// Fails unless the image is that of the processor; both renderers have then rendered it.
fn same_image(what: &str, splats: &Splats, view: &View) -> Option<(Renderer, GpuRenderer)> {
    let gpu = gpu(what)?;
    let mut cpu = Renderer::new(SimdLevel::best());
    let mut twin = GpuRenderer::new(gpu, splats).unwrap();
    let got = twin.render(view).unwrap();
    close(what, &got, cpu.render(splats, view));
    Some((cpu, twin))
}

/// Fails unless image and gradients are those of the processor, whose gradients are finite.
fn both(what: &str, splats: &Splats, view: &View) {
    let Some((mut cpu, mut twin)) = same_image(what, splats, view) else {
        return;
    };
    let Intrinsics { width, height, .. } = view.camera.intrinsics;
    let pixels = width * height;
    let plane = |step: usize| -> Vec<f32> { (0..pixels).map(|i| (i * step % 13) as f32 / 6.0 - 1.0).collect() };
    let g = FrameGradient { rgb: [plane(5), plane(7), plane(8)], alpha: plane(9), depth: plane(11) };
    let (mut want, mut got) = (Gradients::default(), Gradients::default());
    cpu.backward(splats, &g, Wanted::default(), &mut want);
    twin.backward(view, &g, &mut got).unwrap();
    for (c, column) in want.columns.iter().enumerate() {
        let first = splats.n() - column.len();
        let touched = column.iter().zip(&want.touched[first..]).filter(|(_, t)| **t == 1);
        let bad = touched.filter(|(v, _)| !v.is_finite()).count();
        assert_eq!(bad, 0, "{what}: column {c} of the processor has values that are not finite");
    }
    assert_same_gradients(what, &got, &want);
}

#[test]
fn no_splats_show_the_background() {
    let Some(gpu) = gpu("no splats") else { return };
    let empty = Splats::zeros(LAYOUT, 0, 0);
    let view = view(33, 17);
    let mut twin = GpuRenderer::new(gpu, &empty).unwrap();
    let frame = twin.render(&view).unwrap();
    assert!(frame.rgb[1].iter().all(|&v| v == 0.4) && frame.transmittance.iter().all(|&v| v == 1.0));
    let plane = vec![1.0; 33 * 17];
    let g = FrameGradient { rgb: [plane.clone(), plane.clone(), plane], ..FrameGradient::default() };
    let mut out = Gradients::default();
    twin.backward(&view, &g, &mut out).unwrap();
    assert!(out.touched.is_empty() && out.columns.iter().all(Vec::is_empty));
}

#[test]
fn one_pixel_one_tile_and_odd_sizes() {
    let means: Vec<[f32; 3]> =
        (0..40).map(|i| [0.05 * i as f32 - 1.0, 0.02 * i as f32 - 0.4, 2.0 + 0.1 * i as f32]).collect();
    for (w, h) in [(1, 1), (16, 16), (17, 16), (15, 33), (250, 3)] {
        both(&format!("{w}x{h}"), &splats(&means, -2.0), &view(w, h));
    }
}

#[test]
fn splats_behind_the_camera_and_at_its_centre_are_left_out() {
    let means = [[0.0, 0.0, -3.0], [0.0, 0.0, 0.0], [0.1, 0.0, 0.005], [0.0, 0.0, 3.0]];
    both("behind", &splats(&means, -1.0), &view(40, 30));
}

#[test]
fn splats_without_extent_with_too_much_of_it_or_without_a_number() {
    let means = [[0.0, 0.0, 2.0], [0.3, 0.1, 3.0]];
    for log_scale in [-60.0, -15.0, 5.0, 40.0] {
        both(&format!("scale e^{log_scale}"), &splats(&means, log_scale), &view(40, 30));
    }
    let mut flat = splats(&means, -1.0);
    flat.column_mut(Column::LogScale, 2).fill(-50.0);
    flat.column_mut(Column::LogScale, 1).fill(-50.0);
    both("needles", &flat, &view(40, 30));
    let mut broken = splats(&means, -1.0);
    broken.column_mut(Column::Mean, 1)[0] = f32::NAN;
    broken.column_mut(Column::Quat, 0)[1] = 0.0;
    both("not a number", &broken, &view(40, 30));
}

#[test]
fn a_thousand_splats_of_one_depth_keep_their_order() {
    let means: Vec<[f32; 3]> = (0..1000).map(|i| [1e-3 * (i % 32) as f32, 1e-3 * (i / 32) as f32, 2.0]).collect();
    let mut splats = splats(&means, -2.5);
    for k in 0..3 {
        for (i, v) in splats.column_mut(Column::Colour, k).iter_mut().enumerate() {
            *v = ((i * (k + 3)) % 17) as f32 * 0.1;
        }
    }
    both("one depth", &splats, &view(64, 48));
}

#[test]
fn a_million_splats() {
    let n = 1_000_000;
    let means: Vec<[f32; 3]> = (0..n)
        .map(|i| {
            let (x, y, z) = (i % 100, i / 100 % 100, i / 10_000);
            [0.04 * x as f32 - 2.0, 0.04 * y as f32 - 2.0, 2.0 + 0.05 * z as f32]
        })
        .collect();
    // Their gradients need more memory than a software driver gives to one buffer.
    let _renderers = same_image("a million", &splats(&means, -5.5), &view(64, 64));
}
