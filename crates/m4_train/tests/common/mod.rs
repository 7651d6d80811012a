//! A synthetic video whose splats, cameras and motion are known, and a backend that fails, breaks a splat, or leaves
//! density control to the trainer.

use m4_core::{
    Capture, CaptureFrame, Column, CompactMask, CounterRng, Exposure, Intrinsics, Plane, SplatLayout, Splats,
};
use m4_kernels::{Renderer, SimdLevel, StepStats, View, adam::cpu::AdamState, loss::cpu::Target};
use m4_testkit::{MovingScene, moving_scene};
use m4_train::{
    Backend, BackendError,
    backend::{ColourSums, DensityRound, DensityStats, ScoreSettings, StepSettings, StepView},
    density::Scores,
};
use std::sync::{
    Arc,
    atomic::{AtomicUsize, Ordering},
};

/// Frames of the video.
pub const FRAMES: usize = 8;

/// The scene, and the video that a renderer makes of it.
pub fn video() -> (MovingScene, Capture) {
    let mut scene = moving_scene(Intrinsics::centred(96, 72, 90.0), FRAMES);
    // A wall of one depth has no order from front to back that a small step would not turn around.
    let n_static = scene.splats.n_static();
    for (i, z) in scene.splats.column_mut(Column::Mean, 2)[..n_static].iter_mut().enumerate() {
        *z += 0.2 * ((i * 7919) % 101) as f32 / 101.0;
    }
    scene.splats.column_mut(Column::LogScale, 0)[..n_static].fill(0.12f32.ln());
    let level = SimdLevel::best();
    let mut renderer = Renderer::new(level);
    let frames = scene.cameras.iter().enumerate().map(|(i, camera)| {
        let view = View {
            camera: *camera,
            t: i as f64,
            background: [0.0; 3],
            near: 0.1,
            mip: true,
            period: (FRAMES - 1) as f32,
            with_depth: true,
        };
        let frame = renderer.render(&scene.splats, &view);
        let (w, h) = (frame.width, frame.height);
        let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
        let depth = |i: usize| {
            let alpha = 1.0 - frame.transmittance[i];
            if alpha > 0.5 { frame.depth[i] / alpha } else { 0.0 }
        };
        CaptureFrame {
            name: format!("{i:03}"),
            camera: *camera,
            t: i as f64,
            rgb: Plane::from_fn(w, h, |x, y| [0, 1, 2].map(|c| byte(frame.rgb[c][y * w + x]))),
            depth: Some(Plane::from_fn(w, h, |x, y| depth(y * w + x)).into()),
            // the ball is nearer than 3.2, the wall farther
            mask: Some(CompactMask::from_fn(w, h, |x, y| {
                let z = depth(y * w + x);
                z > 0.0 && z < 3.2
            })),
            motion: None,
            instances: None,
            camera_index: None,
        }
    });
    let frames = frames.collect();
    let capture = Capture { frames, time_frames: FRAMES, duration_s: None, metric: true, tracks: None };
    (scene, capture)
}

/// The splats of the scene with everything that can be learned disturbed; anisotropic, velocities 0.
pub fn disturbed(scene: &MovingScene, seed: u64) -> Splats {
    let from = &scene.splats;
    let layout = SplatLayout { isotropic: false, sh_degree: 0, time_degree: 0 };
    let mut out = Splats::zeros(layout, from.n_static(), from.n_dynamic());
    let mut rng = CounterRng::new(seed, 0, 0);
    for column in [Column::Mean, Column::Colour, Column::TimeMean, Column::LogTimeSd, Column::Opacity] {
        for k in 0..layout.range(column).len() {
            out.column_mut(column, k).copy_from_slice(from.column(column, k));
        }
    }
    for k in 0..3 {
        out.column_mut(Column::LogScale, k).copy_from_slice(from.column(Column::LogScale, 0));
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

/// Another backend, as one that must be waited for.
#[derive(Debug)]
pub struct Watched<'a> {
    inner: Box<dyn Backend + 'a>,
    /// Counts the rounds of density control; `None` leaves them to the trainer.
    rounds: Option<Arc<AtomicUsize>>,
    steps: usize,
    /// The step that fails.
    pub fails_at: usize,
    /// A splat is NaN after this step.
    pub breaks_at: usize,
}

impl<'a> Watched<'a> {
    pub fn new(inner: Box<dyn Backend + 'a>, rounds: Option<&Arc<AtomicUsize>>) -> Self {
        Self { inner, rounds: rounds.cloned(), steps: 0, fails_at: 0, breaks_at: 0 }
    }
}

impl Backend for Watched<'_> {
    fn name(&self) -> String {
        self.inner.name()
    }

    fn is_synchronous(&self) -> bool {
        false
    }

    fn set_frames(&mut self, frames: Vec<Target>) -> Result<(), BackendError> {
        self.inner.set_frames(frames)
    }

    fn set_exposures(&mut self, exposures: &[Exposure]) -> Result<(), BackendError> {
        self.inner.set_exposures(exposures)
    }

    fn upload(&mut self, splats: &Splats, adam: AdamState) -> Result<(), BackendError> {
        self.inner.upload(splats, adam)
    }

    fn take(&mut self) -> Result<(Splats, AdamState), BackendError> {
        self.inner.take()
    }

    fn splats(&mut self) -> Result<Splats, BackendError> {
        self.inner.splats()
    }

    fn set_splats(&mut self, splats: &Splats) -> Result<(), BackendError> {
        self.inner.set_splats(splats)
    }

    fn reorder(&mut self) -> Result<(), BackendError> {
        self.inner.reorder()
    }

    fn step(&mut self, views: &[StepView<'_>], settings: &StepSettings<'_>) -> Result<(), BackendError> {
        self.steps += 1;
        if self.steps == self.fails_at {
            return Err(BackendError("the backend broke".to_owned()));
        }
        self.inner.step(views, settings)?;
        if self.steps == self.breaks_at {
            let mut splats = self.inner.splats()?;
            splats.column_mut(Column::Opacity, 0)[0] = f32::NAN;
            self.inner.set_splats(&splats)?;
        }
        Ok(())
    }

    fn stats(&mut self) -> Result<StepStats, BackendError> {
        let splats_are_finite = self.inner.splats()?.is_finite();
        Ok(StepStats { splats_are_finite, ..self.inner.stats()? })
    }

    fn score(&mut self, views: &[(usize, View)], settings: &ScoreSettings) -> Result<Scores, BackendError> {
        self.inner.score(views, settings)
    }

    fn densify(&mut self, round: &DensityRound<'_>) -> Result<Option<DensityStats>, BackendError> {
        let Some(rounds) = &self.rounds else { return Ok(None) };
        rounds.fetch_add(1, Ordering::Relaxed);
        self.inner.densify(round)
    }

    fn colour_sums(&mut self, views: &[(usize, View)], with_weight: bool) -> Result<ColourSums, BackendError> {
        self.inner.colour_sums(views, with_weight)
    }
}
