//! Bound splats.

use crate::{
    gpu,
    twins::{FLIPS, assert_same_gradients, layout, scene},
};
use m4_core::{CounterRng, SplatLayout, Splats};
use m4_kernels::{
    Frame, Gradients, Renderer, SimdLevel, View, renderer::gpu::Renderer as GpuRenderer,
};
use m4_testkit::{Flips, assert_gradient, assert_image, bind_at_random};

const SIZE: (usize, usize) = (80, 61);

/// Static splats, bound ones in two windows, and free ones.
fn bound(seed: u64, layout: SplatLayout) -> (Splats, View) {
    let (mut splats, view) = scene(seed, SIZE, layout, 600);
    bind_at_random(seed, &mut splats, 200);
    (splats, view)
}

fn plane_gradients(seed: u64) -> [Vec<f32>; 3] {
    let mut rng = CounterRng::new(seed, 5, 5);
    [(); 3].map(|()| (0..SIZE.0 * SIZE.1).map(|_| rng.normal() as f32).collect())
}

/// How much two images differ, summed.
fn difference(a: &Frame, b: &Frame) -> f32 {
    a.rgb[0]
        .iter()
        .zip(&b.rgb[0])
        .map(|(a, b)| (a - b).abs())
        .sum()
}

#[test]
fn bound_splats_are_those_of_the_cpu() {
    let Some(gpu) = gpu("bound splats") else {
        return;
    };
    for (seed, layout) in [
        (1, layout(false, 0, 0)),
        (2, layout(true, 2, 0)),
        (3, layout(false, 1, 1)),
    ] {
        let (splats, view) = bound(seed, layout);
        // keys of one window, of both and of none; before and after all of them
        for (t, keys) in [
            (3.0, 2),
            (1.0, 1),
            (5.5, 1),
            (2.3, 0),
            (4.7, 0),
            (-0.4, 0),
            (7.9, 0),
        ] {
            let what = format!("scene {seed} at {t}");
            let view = View {
                t,
                mip: seed == 1,
                ..view
            };
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
            let mut unbound = Splats::zeros(layout, splats.n_static(), splats.n_dynamic());
            unbound
                .columns_mut()
                .zip(splats.columns())
                .for_each(|(to, from)| to.copy_from_slice(from));
            let free = Renderer::new(SimdLevel::best())
                .render(&unbound, &view)
                .clone();
            assert!(
                difference(&got, &free) > 10.0,
                "{what}: bindings make a difference"
            );

            let g = plane_gradients(seed);
            let (mut want, mut got) = (Gradients::default(), Gradients::default());
            cpu.backward(&splats, &g, false, &mut want);
            twin.backward(&view, &g, &mut got).unwrap();
            assert!(
                want.touched[splats.bound()]
                    .iter()
                    .filter(|&&t| t != 0)
                    .count()
                    > 4,
                "{what}"
            );
            assert_same_gradients(&what, &got, &want);
            assert_eq!((got.nodes.len(), want.nodes.len()), (keys, keys), "{what}");
            for (got, want) in got.nodes.iter().zip(&want.nodes) {
                assert_eq!((got.window, got.key), (want.window, want.key), "{what}");
                for part in [0..3, 3..6] {
                    let flat = |nodes: &[[f32; 6]]| -> Vec<f64> {
                        nodes
                            .iter()
                            .flat_map(|g| &g[part.clone()])
                            .map(|&v| f64::from(v))
                            .collect()
                    };
                    let want = flat(&want.nodes);
                    assert!(want.iter().filter(|&&g| g != 0.0).count() > 12, "{what}");
                    assert_gradient(&format!("{what}, nodes"), &flat(&got.nodes), &want, 5e-3);
                }
            }
        }
    }
}

#[test]
fn bound_splats_have_the_same_bits_every_time() {
    let Some(gpu) = gpu("the same bits of bound splats") else {
        return;
    };
    let (splats, view) = bound(4, layout(false, 0, 0));
    let g = plane_gradients(4);
    let once = || {
        let mut twin = GpuRenderer::new(gpu.clone(), &splats).unwrap();
        let frame = twin.render(&view).unwrap();
        let mut out = Gradients::default();
        twin.backward(&view, &g, &mut out).unwrap();
        let nodes: Vec<u32> = out
            .nodes
            .iter()
            .flat_map(|n| n.nodes.as_flattened())
            .map(|v| v.to_bits())
            .collect();
        let rows = splats.bound();
        let bits = |c: &Vec<f32>| -> Vec<u32> {
            let first = splats.n() - c.len();
            let touched_rows = rows.clone().filter(|&row| out.touched[row] != 0);
            touched_rows.map(|row| c[row - first].to_bits()).collect()
        };
        let columns: Vec<Vec<u32>> = out.columns.iter().map(bits).collect();
        (frame, nodes, columns)
    };
    assert_eq!(once(), once());
}
