//! Images and gradients.

use crate::gpu;
use m4_core::{Camera, Column, CounterRng, Intrinsics, Se3, SplatLayout, Splats};
use m4_kernels::{
    Frame, Gradients, Renderer, SimdLevel, View, renderer::gpu::Renderer as GpuRenderer,
};
use m4_testkit::{Flips, SceneSpec, assert_gradient, assert_image, random_camera, random_splats};

/// Splats, half of them dynamic, before a random camera.
pub fn scene(seed: u64, size: (usize, usize), layout: SplatLayout, n: usize) -> (Splats, View) {
    let camera = random_camera(seed, size.0, size.1);
    let spec = SceneSpec {
        layout,
        n_static: n / 2,
        n_dynamic: n - n / 2,
        ..SceneSpec::default()
    };
    let view = View {
        camera,
        t: 3.0,
        background: [0.1, 0.5, 0.9],
        near: 0.01,
        mip: false,
        period: 10.0,
        with_depth: true,
    };
    (random_splats(seed, &camera, &spec), view)
}

pub fn layout(isotropic: bool, sh_degree: usize, time_degree: usize) -> SplatLayout {
    SplatLayout {
        isotropic,
        sh_degree,
        time_degree,
    }
}

/// A contribution may be there in one and not in the other where alpha is at its threshold.
pub const FLIPS: Flips = Flips {
    tolerance: 2e-5,
    step: 0.02,
    share: 0.01,
};

/// Fails unless the splats touched and their gradients are those of the processor, `want`.
pub fn assert_same_gradients(what: &str, got: &Gradients, want: &Gradients) {
    assert_eq!(got.columns.len(), want.columns.len(), "{what}");
    let different = got
        .touched
        .iter()
        .zip(&want.touched)
        .filter(|(a, b)| a != b)
        .count();
    assert!(
        different <= 2,
        "{what}: {different} splats touched by one alone"
    );
    let both: Vec<bool> = got
        .touched
        .iter()
        .zip(&want.touched)
        .map(|(a, b)| a & b == 1)
        .collect();
    for (c, (got, want)) in got.columns.iter().zip(&want.columns).enumerate() {
        let first = both.len() - want.len();
        let touched_values = |column: &[f32]| -> Vec<f64> {
            let rows = column.iter().zip(&both[first..]).filter(|(_, both)| **both);
            rows.map(|(&v, _)| f64::from(v)).collect()
        };
        // a contribution that only one of them has is a thousandth of a large gradient
        assert_gradient(
            &format!("{what}, column {c}"),
            &touched_values(got),
            &touched_values(want),
            5e-3,
        );
    }
}

#[test]
fn images_and_gradients_are_those_of_the_cpu() {
    let Some(gpu) = gpu("images and gradients") else {
        return;
    };
    for (seed, size, layout, n) in [
        (1, (64, 64), layout(false, 0, 0), 500),
        (2, (61, 37), layout(true, 3, 2), 500),
        (3, (200, 131), layout(false, 1, 1), 2000),
        (4, (7, 5), layout(false, 2, 0), 30),
    ] {
        for mip in [false, true] {
            let (splats, view) = scene(seed, size, layout, n);
            let view = View { mip, ..view };
            let what = format!("scene {seed}, mip {mip}");
            let mut cpu = Renderer::new(SimdLevel::best());
            let want = cpu.render(&splats, &view).clone();
            let mut twin = GpuRenderer::new(gpu.clone(), &splats).unwrap();
            let got = twin.render(&view).unwrap();
            let wide = |plane: &[f32]| plane.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
            for k in 0..3 {
                assert_image(&what, &got.rgb[k], &wide(&want.rgb[k]), FLIPS);
            }
            assert_image(&what, &got.transmittance, &wide(&want.transmittance), FLIPS);
            let deep = Flips {
                tolerance: 1e-4,
                step: 0.1,
                ..FLIPS
            };
            assert_image(&what, &got.depth, &wide(&want.depth), deep);

            let mut rng = CounterRng::new(seed, 5, 5);
            let mut plane = || {
                (0..size.0 * size.1)
                    .map(|_| rng.normal() as f32)
                    .collect::<Vec<f32>>()
            };
            let g = [plane(), plane(), plane()];
            let (mut want, mut got) = (Gradients::default(), Gradients::default());
            cpu.backward(&splats, &g, false, &mut want);
            twin.backward(&view, &g, &mut got).unwrap();
            assert_same_gradients(&what, &got, &want);
        }
    }
}

#[test]
fn the_same_bits_every_time() {
    let Some(gpu) = gpu("the same bits") else {
        return;
    };
    let (splats, view) = scene(9, (100, 70), layout(false, 0, 0), 800);
    let plane: Vec<f32> = (0..7000).map(|i| (i % 13) as f32 - 6.0).collect();
    let g = [plane.clone(), plane.clone(), plane];
    let once = || {
        let mut twin = GpuRenderer::new(gpu.clone(), &splats).unwrap();
        let frame = twin.render(&view).unwrap();
        let mut out = Gradients::default();
        twin.backward(&view, &g, &mut out).unwrap();
        let bits = |v: &[f32], rows: &[u8]| -> Vec<u32> {
            let first = rows.len() - v.len();
            v.iter()
                .zip(&rows[first..])
                .filter(|(_, t)| **t == 1)
                .map(|(v, _)| v.to_bits())
                .collect()
        };
        let columns: Vec<Vec<u32>> = out.columns.iter().map(|c| bits(c, &out.touched)).collect();
        (frame, out.touched.clone(), columns)
    };
    assert_eq!(once(), once());
}

const LAYOUT: SplatLayout = SplatLayout {
    isotropic: false,
    sh_degree: 0,
    time_degree: 0,
};

fn view(width: usize, height: usize) -> View {
    View {
        camera: Camera {
            intrinsics: Intrinsics::centred(width, height, width as f64),
            c2w: Se3::identity(),
        },
        t: 0.0,
        background: [0.2, 0.4, 0.6],
        near: 0.01,
        mip: true,
        period: 0.0,
        with_depth: true,
    }
}

/// Grey splats at these places with about this logarithm of their size: a sphere would leave its
/// rotation without a gradient.
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
        assert!(
            (a - b).abs() <= 1e-4 * (1.0 + b.abs()),
            "{what}: value {i} is {a} for {b}"
        );
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
    let plane = |step: usize| -> Vec<f32> {
        (0..pixels)
            .map(|i| (i * step % 13) as f32 / 6.0 - 1.0)
            .collect()
    };
    let g = [plane(5), plane(7), plane(8)];
    let (mut want, mut got) = (Gradients::default(), Gradients::default());
    cpu.backward(splats, &g, false, &mut want);
    twin.backward(view, &g, &mut got).unwrap();
    for (c, column) in want.columns.iter().enumerate() {
        let first = splats.n() - column.len();
        let touched = column
            .iter()
            .zip(&want.touched[first..])
            .filter(|(_, t)| **t == 1);
        let bad = touched.filter(|(v, _)| !v.is_finite()).count();
        assert_eq!(
            bad, 0,
            "{what}: column {c} of the processor has values that are not finite"
        );
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
    assert!(
        frame.rgb[1].iter().all(|&v| v == 0.4) && frame.transmittance.iter().all(|&v| v == 1.0)
    );
    let plane = vec![1.0; 33 * 17];
    let g = [plane.clone(), plane.clone(), plane];
    let mut out = Gradients::default();
    twin.backward(&view, &g, &mut out).unwrap();
    assert!(out.touched.is_empty() && out.columns.iter().all(Vec::is_empty));
}

#[test]
fn one_pixel_one_tile_and_odd_sizes() {
    let means: Vec<[f32; 3]> = (0..40)
        .map(|i| {
            [
                0.05 * i as f32 - 1.0,
                0.02 * i as f32 - 0.4,
                2.0 + 0.1 * i as f32,
            ]
        })
        .collect();
    for (w, h) in [(1, 1), (16, 16), (17, 16), (15, 33), (250, 3)] {
        both(&format!("{w}x{h}"), &splats(&means, -2.0), &view(w, h));
    }
}

#[test]
fn splats_behind_the_camera_and_at_its_centre_are_left_out() {
    let means = [
        [0.0, 0.0, -3.0],
        [0.0, 0.0, 0.0],
        [0.1, 0.0, 0.005],
        [0.0, 0.0, 3.0],
    ];
    both("behind", &splats(&means, -1.0), &view(40, 30));
}

#[test]
fn splats_without_extent_with_too_much_of_it_or_without_a_number() {
    let means = [[0.0, 0.0, 2.0], [0.3, 0.1, 3.0]];
    for log_scale in [-60.0, -15.0, 5.0, 40.0] {
        both(
            &format!("scale e^{log_scale}"),
            &splats(&means, log_scale),
            &view(40, 30),
        );
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
fn splats_over_hundreds_of_tiles() {
    let means: Vec<[f32; 3]> = (0..30)
        .map(|i| [0.05 * i as f32 - 0.7, 0.3, 2.0 + 0.1 * i as f32])
        .collect();
    let mut splats = splats(&means, -0.5);
    // nearly transparent, so that every one of them counts
    splats.column_mut(Column::Opacity, 0).fill(-3.0);
    both("hundreds of tiles", &splats, &view(190, 140));
}

#[test]
fn a_thousand_splats_of_one_depth_keep_their_order() {
    let means: Vec<[f32; 3]> = (0..1000)
        .map(|i| [1e-3 * (i % 32) as f32, 1e-3 * (i / 32) as f32, 2.0])
        .collect();
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
            [
                0.04 * x as f32 - 2.0,
                0.04 * y as f32 - 2.0,
                2.0 + 0.05 * z as f32,
            ]
        })
        .collect();
    let (splats, view) = (splats(&means, -5.5), view(64, 64));
    let Some(gpu) = gpu("a million") else { return };
    let got = GpuRenderer::new(gpu, &splats)
        .unwrap()
        .render(&view)
        .unwrap();
    let mut cpu = Renderer::new(SimdLevel::best());
    let want = cpu.render(&splats, &view);
    // of a million some are at the threshold of alpha; their gradients need more memory than a
    // software driver gives to one buffer
    for (got, want) in got
        .rgb
        .iter()
        .chain([&got.transmittance])
        .zip(want.rgb.iter().chain([&want.transmittance]))
    {
        let want: Vec<f64> = want.iter().map(|&v| f64::from(v)).collect();
        assert_image("a million", got, &want, FLIPS);
    }
}
