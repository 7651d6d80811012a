//! Kernels on the synthetic scenes of [`m4_kernels::bench`], 480x360 pixels, with criterion's statistics:
//! for telling small differences apart. `minute4d bench` has the whole table.
//!
//! `cargo bench -p m4_kernels` times each on the threads of rayon's default pool, on the level that
//! `MINUTE4D_SIMD` names or the best one; `RAYON_NUM_THREADS=1` gives figures a core.

use criterion::{Criterion, criterion_group, criterion_main};
use m4_kernels::{
    FrameGradient, Gradients, Renderer, SimdLevel, Wanted,
    adam::cpu::{self as adam, AdamConfig, AdamState},
    bench::{BenchScene, SceneConfig, SceneKind},
    morton_order,
    photo::cpu::{self as photo, PhotoScratch},
};
use std::hint::black_box;

fn kernels(c: &mut Criterion) {
    let level = SimdLevel::detect().expect("MINUTE4D_SIMD names a level of this machine");
    let cases = [
        (20_000, 0, SceneKind::Static),
        (100_000, 0, SceneKind::Static),
        (100_000, 0, SceneKind::FourD),
        (20_000, 3, SceneKind::Static),
    ];
    for (splats, sh_degree, kind) in cases {
        let config = SceneConfig {
            splats,
            sh_degree,
            kind,
            ..SceneConfig::default()
        };
        let BenchScene {
            mut splats,
            views,
            target,
        } = BenchScene::new(&config).expect("the scene fits itself");
        let view = views[0];
        let name = format!("{}_splats_sh{sh_degree}_{}", config.splats, kind.name());
        let id = |kernel: &str| format!("{kernel}/{name}");
        let mut renderer = Renderer::new(level);
        let (mut scratch, mut gradient) = (PhotoScratch::default(), FrameGradient::default());
        let mut gradients = Gradients::default();
        let mut state = AdamState::new(&splats);
        // too small to change the scene while it is timed
        let rates = vec![1e-12; splats.columns().len()];

        c.bench_function(&id("render"), |b| {
            b.iter(|| black_box(renderer.render(&splats, &view).width));
        });
        let frame = renderer.render(&splats, &view).clone();
        c.bench_function(&id("photo"), |b| {
            b.iter(|| photo::loss(level, &target, &frame.rgb, 0.2, &mut scratch, &mut gradient.rgb));
        });
        c.bench_function(&id("backward"), |b| {
            b.iter(|| renderer.backward(&splats, &gradient, Wanted::default(), &mut gradients));
        });
        c.bench_function(&id("adam"), |b| {
            b.iter(|| {
                let config = AdamConfig::default();
                adam::step(level, &mut splats, &gradients, &mut state, &config, &rates);
            });
        });
        let mut score = vec![0.0; splats.n()];
        c.bench_function(&id("score"), |b| {
            b.iter(|| renderer.score(&frame.rgb[0], &mut score));
        });
        c.bench_function(&id("morton_order"), |b| b.iter(|| morton_order(&splats)));
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = kernels
}
criterion_main!(benches);
