//! The integration tests of this crate, in one program: a dynamic surface stays as solid between
//! the frames of a video as at them; and a scene through the bytes of its page and back renders as
//! before, from the source cameras.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use m4_core::{
    Camera, Capture, CaptureFrame, CompactMask, Exposure, Intrinsics, Plane, Scene, Se3, Silent,
};
use m4_core::{SourceFrame, SplatLayout, Splats};
use m4_kernels::{Renderer, SimdLevel, View};
use m4_testkit::{SceneSpec, camera_looking_at, random_splats};
use m4_train::init::{InitConfig, initialise};
use minute4d::m4_viewer::payload::{bytes_per_splat, decode, encode};
use minute4d::render::Painter;

const SIZE: (usize, usize) = (96, 64);
const WALL: f64 = 4.0;
const SQUARE: f64 = 2.0;
/// World units per frame, to the right.
const SPEED: f64 = 0.03;

fn camera() -> Camera {
    Camera {
        intrinsics: Intrinsics::centred(SIZE.0, SIZE.1, 100.0),
        c2w: Se3::identity(),
    }
}

/// Whether the square covers a pixel at time `t`, frames, but for a rim of `rim` world units.
fn covers(x: usize, y: usize, t: f64, rim: f64) -> bool {
    let p = camera().unproject(x as f64, y as f64, SQUARE);
    (p.x - SPEED * t + 0.2).abs() < 0.3 - rim && p.y.abs() < 0.3 - rim
}

/// A square that slides in front of a wall, filmed at `times`, frames.
fn capture(times: &[f64]) -> Capture {
    let (w, h) = SIZE;
    let texture = |x: f64, y: f64| {
        [0.0, 1.3, 2.9]
            .map(|p: f64| (127.5 + 120.0 * (9.0 * x + p).sin() * (7.0 * y - p).cos()) as u8)
    };
    let make = |(i, &t): (usize, &f64)| {
        let on = |x: usize, y: usize| covers(x, y, t, 0.0);
        let colour = |x: usize, y: usize| {
            let p = camera().unproject(x as f64, y as f64, if on(x, y) { SQUARE } else { WALL });
            let shift = if on(x, y) { SPEED * t } else { 5.0 };
            texture(p.x - shift, p.y)
        };
        CaptureFrame {
            name: format!("{i:03}"),
            camera: camera(),
            t,
            rgb: Plane::from_fn(w, h, colour),
            depth: Some(
                Plane::from_fn(w, h, |x, y| if on(x, y) { SQUARE } else { WALL } as f32).into(),
            ),
            mask: Some(CompactMask::from_fn(w, h, on)),
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        }
    };
    Capture {
        frames: times.iter().enumerate().map(make).collect(),
        time_frames: 11,
        duration_s: None,
        metric: true,
        tracks: None,
    }
}

/// The dynamic splats alone.
fn dynamic(splats: &Splats) -> Splats {
    let rows: Vec<u32> = (splats.n_static() as u32..splats.n() as u32).collect();
    splats.gather(&rows).unwrap()
}

/// Mean opacity of the square at every tenth of a frame between 1 and 9.
fn opacities(times: &[f64]) -> Vec<f64> {
    let config = InitConfig {
        max_static: Some(2000),
        max_dynamic: 60_000,
        change_threshold: 0.0,
        shell_splats: 0,
        ..InitConfig::fast()
    };
    let splats = dynamic(
        &initialise(&capture(times), &config, &Silent)
            .unwrap()
            .splats,
    );
    let mut renderer = Renderer::new(SimdLevel::best());
    let at = |t: f64| {
        let frame = renderer.render(
            &splats,
            &View {
                camera: camera(),
                t,
                background: [0.0; 3],
                near: 0.1,
                mip: true,
                period: 10.0,
                with_depth: false,
            },
        );
        let inside = (0..SIZE.0 * SIZE.1).filter(|i| covers(i % SIZE.0, i / SIZE.0, t, 0.06));
        let opacities: Vec<f64> = inside
            .map(|i| 1.0 - f64::from(frame.transmittance[i]))
            .collect();
        opacities.iter().sum::<f64>() / opacities.len() as f64
    };
    (10..=90).map(|k| 0.1 * f64::from(k)).map(at).collect()
}

#[test]
fn opacity_is_constant_between_frames() {
    let every: Vec<f64> = (0..11).map(f64::from).collect();
    let without = |missing: &[f64]| -> Vec<f64> {
        every
            .iter()
            .copied()
            .filter(|t| !missing.contains(t))
            .collect()
    };
    // where frames are missing, first velocities are less sure, and splats spread over more than
    // the surface
    for (times, most) in [
        (every.clone(), 0.03),
        (without(&[4.0]), 0.1),
        (without(&[7.0, 8.0]), 0.1),
    ] {
        let values = opacities(&times);
        let (low, high) = values
            .iter()
            .fold((1.0f64, 0.0f64), |(l, h), &v| (l.min(v), h.max(v)));
        assert!(
            low > 0.89 && high - low < most,
            "{} frames: {low:.4} to {high:.4}: {values:.3?}",
            times.len()
        );
    }
}

const FRAMES: usize = 8;

fn synthetic(layout: SplatLayout) -> Scene {
    let camera = |i: usize| {
        let x = 0.5 * i as f64 / (FRAMES - 1) as f64;
        camera_looking_at(
            Intrinsics::centred(240, 180, 220.0),
            [x, 0.0, -0.5],
            [0.0, 0.0, 4.0],
        )
    };
    let spec = SceneSpec {
        layout,
        n_static: 3000,
        n_dynamic: 3000,
        time_frames: FRAMES,
        sd_px: [0.5, 5.0],
        logit: [-3.0, 4.0],
    };
    let source = (0..FRAMES).map(|i| SourceFrame {
        camera: camera(i),
        t: i as f64,
        exposure: Exposure::IDENTITY,
        distance_sigma: None,
    });
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

/// Least PSNR in dB of the frames of the scene after its page, against the scene; also half a frame
/// later.
fn least_psnr_db(scene: &Scene) -> f64 {
    let level = SimdLevel::detect().unwrap();
    let middle = scene.source[scene.source.len() / 2];
    let depth = Painter::new(scene, level)
        .median_depth(&middle.camera, middle.t)
        .unwrap();
    let payload = encode(scene, depth);
    let again = Scene {
        splats: decode(&payload.bytes).unwrap(),
        ..scene.clone()
    };
    let (mut before, mut after) = (Painter::new(scene, level), Painter::new(&again, level));
    let mut least = f64::INFINITY;
    for source in &scene.source {
        for t in [
            source.t,
            (source.t + 0.5).min(scene.time_frames as f64 - 1.0),
        ] {
            let a = before.frame(&source.camera, t, false).rgb.concat();
            let b = after.frame(&source.camera, t, false).rgb.concat();
            let square: f64 = a
                .iter()
                .zip(&b)
                .map(|(a, b)| f64::from(a - b).powi(2))
                .sum();
            least = least.min(-10.0 * (square / a.len() as f64).log10());
        }
    }
    least
}

#[test]
fn the_quantised_page_renders_like_the_scene() {
    let layouts = [(false, 0, 0), (true, 0, 0), (false, 2, 1)];
    for (isotropic, sh_degree, time_degree) in layouts {
        let layout = SplatLayout {
            isotropic,
            sh_degree,
            time_degree,
        };
        let (of_static, of_dynamic) = bytes_per_splat(layout);
        if sh_degree == 0 {
            assert!(
                of_static <= 24 && of_dynamic <= 34,
                "{of_static} {of_dynamic}"
            );
        }
        let psnr_db = least_psnr_db(&synthetic(layout));
        println!("{layout:?}: {psnr_db:.2} dB");
        assert!(psnr_db >= 50.0, "{layout:?}: {psnr_db} dB");
    }
}
