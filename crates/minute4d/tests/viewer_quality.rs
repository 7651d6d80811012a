//! What the page loses: a scene through its bytes and back, rendered from the source cameras.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]
#![expect(clippy::print_stdout, reason = "figures are read by people")]

use m4_testkit::{SceneSpec, camera_looking_at, random_splats};
use minute4d::core::{Exposure, Intrinsics, Scene, SourceFrame, SplatLayout};
use minute4d::kernels::SimdLevel;
use minute4d::page::payload::{bytes_per_splat, decode, encode};
use minute4d::render::Painter;

const FRAMES: usize = 8;

fn synthetic(layout: SplatLayout) -> Scene {
    let camera = |i: usize| {
        let x = 0.5 * i as f64 / (FRAMES - 1) as f64;
        camera_looking_at(Intrinsics::centred(240, 180, 220.0), [x, 0.0, -0.5], [0.0, 0.0, 4.0])
    };
    let spec = SceneSpec {
        layout,
        n_static: 3000,
        n_dynamic: 3000,
        time_frames: FRAMES,
        sd_px: [0.5, 5.0],
        logit: [-3.0, 4.0],
    };
    let source = (0..FRAMES).map(|i| SourceFrame { camera: camera(i), t: i as f64, exposure: Exposure::IDENTITY });
    Scene {
        splats: random_splats(11, &camera(FRAMES / 2), &spec),
        background: [0.2, 0.2, 0.2],
        time_frames: FRAMES,
        duration_s: None,
        mip: true,
        near: 0.05,
        source: source.collect(),
    }
}

/// PSNR in dB of every `stride`-th frame of the scene after its page, against the scene; also half a frame later.
fn losses(scene: &Scene, stride: usize) -> Vec<f64> {
    let level = SimdLevel::detect().unwrap();
    let middle = scene.source[scene.source.len() / 2];
    let depth = Painter::new(scene, level).median_depth(&middle.camera, middle.t).unwrap();
    let payload = encode(scene, depth);
    let (of_static, of_dynamic) = bytes_per_splat(payload.layout);
    let again = Scene { splats: decode(&payload.bytes).unwrap(), ..scene.clone() };
    println!(
        "{} + {} of {} + {} splats, {of_static} and {of_dynamic} bytes each",
        payload.n_static,
        payload.n_dynamic,
        scene.splats.n_static(),
        scene.splats.n_dynamic()
    );
    let (mut before, mut after) = (Painter::new(scene, level), Painter::new(&again, level));
    let mut all = Vec::new();
    for source in scene.source.iter().step_by(stride) {
        for t in [source.t, (source.t + 0.5).min(scene.time_frames as f64 - 1.0)] {
            let a = before.frame(&source.camera, t, false).rgb.concat();
            let b = after.frame(&source.camera, t, false).rgb.concat();
            let square: f64 = a.iter().zip(&b).map(|(a, b)| f64::from(a - b).powi(2)).sum();
            all.push(-10.0 * (square / a.len() as f64).log10());
        }
    }
    all
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

#[test]
fn the_quantised_page_renders_like_the_scene() {
    let layouts = [(false, 0, 0), (true, 0, 0), (false, 2, 1)];
    for (isotropic, sh_degree, time_degree) in layouts {
        let layout = SplatLayout { isotropic, sh_degree, time_degree };
        let (of_static, of_dynamic) = bytes_per_splat(layout);
        if sh_degree == 0 {
            assert!(of_static <= 24 && of_dynamic <= 34, "{of_static} {of_dynamic}");
        }
        let found = least(&losses(&synthetic(layout), 1));
        println!("{layout:?}: {found:.2} dB");
        assert!(found >= 50.0, "{layout:?}: {found} dB");
    }
}
