//! A synthetic video whose splats, cameras and motion are known.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use m4_core::{
    Camera, Capture, CaptureFrame, Column, CompactMask, CounterRng, Intrinsics, Plane, Silent,
    SplatLayout, Splats,
};
use m4_kernels::{Renderer, SimdLevel, View};
use m4_testkit::{MovingScene, moving_scene};
use m4_train::{Backend, DensityConfig, RateConfig, TrainConfig, Trainer, config::SplitPlacement};

/// Frames of the video.
pub const FRAMES: usize = 8;

/// The scene, and the video that a renderer makes of it.
pub fn video() -> (MovingScene, Capture) {
    let mut scene = moving_scene(Intrinsics::centred(96, 72, 90.0), FRAMES);
    // A wall of one depth has no order from front to back that a small step would not turn around.
    let n_static = scene.splats.n_static();
    for (i, z) in scene.splats.column_mut(Column::Mean, 2)[..n_static]
        .iter_mut()
        .enumerate()
    {
        *z += 0.2 * ((i * 7919) % 101) as f32 / 101.0;
    }
    scene.splats.column_mut(Column::LogScale, 0)[..n_static].fill(0.12f32.ln());
    let capture = filmed(&scene.splats, &scene.cameras);
    (scene, capture)
}

/// What a renderer makes of `splats`, with a camera per frame; the ball is dynamic.
pub fn filmed(splats: &Splats, cameras: &[Camera]) -> Capture {
    let level = SimdLevel::best();
    let mut renderer = Renderer::new(level);
    let frames = cameras.iter().enumerate().map(|(i, camera)| {
        let view = View {
            camera: *camera,
            t: i as f64,
            background: [0.0; 3],
            near: 0.1,
            mip: true,
            period: (FRAMES - 1) as f32,
            with_depth: true,
        };
        let frame = renderer.render(splats, &view);
        let (w, h) = (frame.width, frame.height);
        let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
        let depth = |i: usize| {
            let alpha = 1.0 - frame.transmittance[i];
            if alpha > 0.5 {
                frame.depth[i] / alpha
            } else {
                0.0
            }
        };
        CaptureFrame {
            name: format!("{i:03}"),
            camera: *camera,
            t: i as f64,
            rgb: Plane::from_fn(w, h, |x, y| {
                [0, 1, 2].map(|c| byte(frame.rgb[c][y * w + x]))
            }),
            depth: Some(Plane::from_fn(w, h, |x, y| depth(y * w + x)).into()),
            // the ball is nearer than 3.2, the wall farther
            mask: Some(CompactMask::from_fn(w, h, |x, y| {
                let z = depth(y * w + x);
                z > 0.0 && z < 3.2
            })),
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: (i > 0).then_some(0.01 * i as f32),
        }
    });
    let frames = frames.collect();
    Capture {
        frames,
        time_frames: FRAMES,
        duration_s: None,
        metric: true,
        tracks: None,
    }
}

/// Gives `splats` harmonics of these degrees, in space and time, at random.
pub fn add_harmonics(splats: &mut Splats, (space, time): (usize, usize)) {
    splats.raise_degrees(space, time);
    let mut rng = CounterRng::new(21, 0, 0);
    for k in 3..splats.layout().range(Column::Colour).len() {
        splats
            .column_mut(Column::Colour, k)
            .fill_with(|| 0.25 * rng.normal() as f32);
    }
}

/// The splats of the scene with everything that can be learned disturbed; anisotropic, velocities
/// 0.
pub fn disturbed(scene: &MovingScene, seed: u64) -> Splats {
    let from = &scene.splats;
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 0,
        time_degree: 0,
    };
    let mut out = Splats::zeros(layout, from.n_static(), from.n_dynamic());
    let mut rng = CounterRng::new(seed, 0, 0);
    for column in [
        Column::Mean,
        Column::Colour,
        Column::TimeMean,
        Column::LogTimeSd,
        Column::Opacity,
    ] {
        for k in 0..layout.range(column).len() {
            out.column_mut(column, k)
                .copy_from_slice(from.column(column, k));
        }
    }
    for k in 0..3 {
        out.column_mut(Column::LogScale, k)
            .copy_from_slice(from.column(Column::LogScale, 0));
        for c in out.column_mut(Column::Colour, k) {
            *c += 0.5 * rng.normal() as f32;
        }
        for c in out.column_mut(Column::Mean, k) {
            *c += 0.01 * rng.normal() as f32;
        }
    }
    out.column_mut(Column::Opacity, 0).fill(1.0);
    out.column_mut(Column::Quat, 0).fill(1.0);
    out
}

/// Nothing is trained.
pub const STILL: RateConfig = RateConfig {
    position: 0.0,
    position_end: 0.0,
    colour: 0.0,
    colour_harmonics: 0.0,
    opacity: 0.0,
    scale: 0.0,
    rotation: 0.0,
    time_mean_reference: 0.0,
    time_sd: 0.0,
    velocity: 0.0,
    other_end: 0.05,
};

/// Splits splats that have a harmonic of time, on `backend` or the CPU, into halves drawn at
/// random, and checks that each half has the phase of its time.
pub fn halves_have_the_colour_of_their_time(backend: Option<Box<dyn Backend>>) {
    let (scene, capture) = video();
    let (mut splats, middle) = (scene.splats, 0.5 * (FRAMES - 1) as f32);
    splats.raise_degrees(1, 1);
    let wave = 3 * splats.layout().sh_terms();
    splats.column_mut(Column::Colour, wave).fill(1.0);
    splats.column_mut(Column::LogTimeSd, 0).fill(0.0);
    let mut config = TrainConfig {
        iterations: 20,
        colour_fit_rounds: 0,
        lr: STILL,
        ..TrainConfig::fast()
    };
    config.density = DensityConfig {
        from: 0.5,
        every: 0.5,
        until: 0.5,
        budget: 1.0,
        max_growth: 2.0,
        split_placement: SplitPlacement::Sample,
        ..DensityConfig::fast()
    };
    let mut trainer = Trainer::new(&capture, splats, config, SimdLevel::best()).unwrap();
    if let Some(backend) = backend {
        trainer.use_backend(backend).unwrap();
    }
    trainer.run(&Silent, &mut |_| {}).unwrap();
    let splats = trainer.splats();
    let waves = splats.column(Column::Colour, wave)[splats.n_static()..].iter();
    let mut moved = 0;
    for (&t, &wave) in splats.column(Column::TimeMean, 0).iter().zip(waves) {
        let dt = t - middle;
        let want = (std::f32::consts::TAU * dt / (FRAMES - 1) as f32).cos();
        assert!(
            (wave - want).abs() < 1e-5,
            "{wave} for {want}, {dt} frames off"
        );
        moved += usize::from(dt != 0.0);
    }
    assert!(moved > 5, "{moved}");
}
