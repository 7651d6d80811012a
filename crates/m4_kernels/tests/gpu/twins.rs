//! Images and gradients.

use crate::gpu;
use m4_core::{CounterRng, SplatLayout, Splats};
use m4_kernels::gpu::Renderer as GpuRenderer;
use m4_kernels::{FrameGradient, Gradients, Renderer, SimdLevel, View, Wanted};
use m4_testkit::{Flips, SceneSpec, assert_gradient, assert_image, random_camera, random_splats};

/// Splats, half of them dynamic, before a random camera.
fn scene(seed: u64, size: (usize, usize), layout: SplatLayout, n: usize) -> (Splats, View) {
    let camera = random_camera(seed, size.0, size.1);
    let spec = SceneSpec { layout, n_static: n / 2, n_dynamic: n - n / 2, ..SceneSpec::default() };
    let view =
        View { camera, t: 3.0, background: [0.1, 0.5, 0.9], near: 0.01, mip: false, period: 10.0, with_depth: true };
    (random_splats(seed, &camera, &spec), view)
}

fn layout(isotropic: bool, sh_degree: usize, time_degree: usize) -> SplatLayout {
    SplatLayout { isotropic, sh_degree, time_degree }
}

/// A contribution may be there in one and not in the other where alpha is at its threshold.
const FLIPS: Flips = Flips { tolerance: 2e-5, step: 0.02, share: 0.01 };

/// Fails unless the splats touched and their gradients are those of the processor, `want`.
pub fn assert_same_gradients(what: &str, got: &Gradients, want: &Gradients) {
    assert_eq!(got.columns.len(), want.columns.len(), "{what}");
    let different = got.touched.iter().zip(&want.touched).filter(|(a, b)| a != b).count();
    assert!(different <= 2, "{what}: {different} splats touched by one alone");
    let both: Vec<bool> = got.touched.iter().zip(&want.touched).map(|(a, b)| a & b == 1).collect();
    for (c, (got, want)) in got.columns.iter().zip(&want.columns).enumerate() {
        let first = both.len() - want.len();
        let seen = |column: &[f32]| -> Vec<f64> {
            let rows = column.iter().zip(&both[first..]).filter(|(_, both)| **both);
            rows.map(|(&v, _)| f64::from(v)).collect()
        };
        // a contribution that only one of them has is a thousandth of a large gradient
        assert_gradient(&format!("{what}, column {c}"), &seen(got), &seen(want), 5e-3);
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
            let deep = Flips { tolerance: 1e-4, step: 0.1, ..FLIPS };
            assert_image(&what, &got.depth, &wide(&want.depth), deep);

            let mut rng = CounterRng::new(seed, 5, 5);
            let mut plane = || (0..size.0 * size.1).map(|_| rng.normal() as f32).collect::<Vec<f32>>();
            let g = FrameGradient { rgb: [plane(), plane(), plane()], alpha: plane(), depth: plane() };
            let (mut want, mut got) = (Gradients::default(), Gradients::default());
            cpu.backward(&splats, &g, Wanted::default(), &mut want);
            twin.backward(&view, &g, &mut got).unwrap();
            assert_same_gradients(&what, &got, &want);
        }
    }
}

#[test]
fn the_same_bits_every_time() {
    let Some(gpu) = gpu("the same bits") else { return };
    let (splats, view) = scene(9, (100, 70), layout(false, 0, 0), 800);
    let plane: Vec<f32> = (0..7000).map(|i| (i % 13) as f32 - 6.0).collect();
    let g = FrameGradient { rgb: [plane.clone(), plane.clone(), plane], ..FrameGradient::default() };
    let once = || {
        let mut twin = GpuRenderer::new(gpu.clone(), &splats).unwrap();
        let frame = twin.render(&view).unwrap();
        let mut out = Gradients::default();
        twin.backward(&view, &g, &mut out).unwrap();
        let bits = |v: &[f32], rows: &[u8]| -> Vec<u32> {
            let first = rows.len() - v.len();
            v.iter().zip(&rows[first..]).filter(|(_, t)| **t == 1).map(|(v, _)| v.to_bits()).collect()
        };
        let columns: Vec<Vec<u32>> = out.columns.iter().map(|c| bits(c, &out.touched)).collect();
        (frame, out.touched.clone(), columns)
    };
    assert_eq!(once(), once());
}
