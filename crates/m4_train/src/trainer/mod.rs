//! The training loop.

mod periodic;
mod run;
mod save;
mod step;

use crate::{
    TrainError,
    backend::{Backend, CpuBackend},
    config::TrainConfig,
    init::FirstSplats,
    metrics::Totals,
    refine::Refinement,
    scale::SceneScale,
    schedule::Picker,
    schedule::{RateBasis, period},
    state::{Reader, read_adam, read_refinement},
};
use m4_core::{Capture, Column, Splats, TrainState, median};
use m4_kernels::adam::{FIXED, cpu::AdamState};
use m4_kernels::{SimdLevel, View, morton_order};
use std::{collections::HashSet, time::Instant};
use step::StepReport;

/// Splats nearer than this share of the median depth are not drawn. The reference has 0.2 scene
/// units whatever the scale (docs/spec/optimiser.md 1.6).
const NEAR_SHARE: f32 = 0.05;

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// All iterations that were asked for are done.
    Finished,
    /// The user asked to stop; what was learned so far is kept.
    Stopped {
        /// Steps taken.
        iteration: usize,
    },
}

/// A run of training: what is learned, and where it stands.
#[derive(Debug)]
pub struct Trainer<'a> {
    config: TrainConfig,
    capture: &'a Capture,
    /// Where splats live while they are trained.
    backend: Box<dyn Backend + 'a>,
    /// Whether that is another device than the CPU, whose kernels are compiled for `level`.
    is_device: bool,
    level: SimdLevel,
    /// The frames that the backend lacks.
    frames_wanted: Option<&'a Capture>,
    /// The backend has splats and state; `adam` has nothing then.
    is_uploaded: bool,
    /// `splats` are those of the backend.
    is_current: bool,
    /// Static and dynamic splats, wherever they are.
    counts: (usize, usize),
    /// When splats were last copied to go back to.
    saved: Instant,
    /// What the last steps found.
    last: StepReport,
    /// Frames whose cameras or exposures have gradients that the backend still holds.
    pending: HashSet<usize>,
    /// Frames, one per frame of the capture.
    times: Vec<f64>,
    /// As the capture has them, one per frame.
    distance_sigmas: Vec<Option<f32>>,
    time_frames: usize,
    duration_s: Option<f64>,
    scale: SceneScale,
    /// The last that were checked to be finite: those of iteration `good`.
    splats: Splats,
    good: usize,
    adam: AdamState,
    /// Where splats are that are never stepped, as bits: the way to know them again without the
    /// optimiser's state.
    fixed: HashSet<[u32; 3]>,
    fit: Refinement,
    picker: Picker,
    iteration: usize,
    /// Whether the fit of colours after the last step is done.
    is_fitted: bool,
    background: [f32; 3],
    first_splats: usize,
    basis: RateBasis,
    totals: Totals,
    seconds: f64,
    processor_seconds: f64,
}

impl<'a> Trainer<'a> {
    /// A run that starts from `first`. Fails with [`TrainError`] if a setting is out of range, the
    /// capture has no frames, or the splats are none or not finite.
    pub fn new(
        capture: &'a Capture,
        first: impl Into<FirstSplats>,
        config: TrainConfig,
        level: SimdLevel,
    ) -> Result<Self, TrainError> {
        let FirstSplats { splats, fixed } = first.into();
        check_start(capture, &splats, &config)?;
        let fixed = fixed.start..fixed.end.min(splats.n_static());
        let order = morton_order(&splats);
        let splats = splats.gather(&order)?;
        let mut adam = AdamState::new(&splats);
        for (step, &row) in adam.step.iter_mut().zip(&order) {
            if fixed.contains(&(row as usize)) {
                *step = FIXED;
            }
        }
        let basis = RateBasis {
            // a life longer than the video moves no further than the video lasts
            time_sd: median_time_sd(&splats)
                .min(0.25 * capture.time_frames as f32)
                .max(0.5),
            time_frames: capture.time_frames,
        };
        let background = config.background.unwrap_or_else(|| background_of(capture));
        let first_splats = splats.n();
        Ok(Self::assemble(
            capture,
            splats,
            adam,
            basis,
            background,
            first_splats,
            config,
            level,
        ))
    }

    /// A run that resumes from [`state`](Self::state); `splats` are those of the scene saved with
    /// it. Capture and settings must be those of the saved run, else the result is not that of an
    /// uninterrupted one; the number of iterations is taken from the saved run. Fails with
    /// [`TrainError`] as [`new`](Self::new), or if the state lacks a part or belongs to other
    /// splats or another capture.
    pub fn resume(
        capture: &'a Capture,
        splats: Splats,
        state: &TrainState<'_>,
        config: TrainConfig,
        level: SimdLevel,
    ) -> Result<Self, TrainError> {
        check_start(capture, &splats, &config)?;
        let reader = Reader(state);
        let adam = read_adam(&reader, &splats)?;
        let basis = RateBasis {
            time_sd: reader.f32("train/time_sd", 1)?[0],
            time_frames: capture.time_frames,
        };
        let rgb = reader.f32("train/background", 3)?;
        let background = [rgb[0], rgb[1], rgb[2]];
        let first_splats = reader.u32("train/first_splats", 1)?[0] as usize;
        let iteration = reader.u32("train/iteration", 1)?[0] as usize;
        let config = TrainConfig {
            iterations: reader.u32("train/iterations", 1)?[0] as usize,
            ..config
        };
        let mut out = Self::assemble(
            capture,
            splats,
            adam,
            basis,
            background,
            first_splats,
            config,
            level,
        );
        out.iteration = iteration;
        read_refinement(&reader, &mut out.fit)?;
        Ok(out)
    }

    fn assemble(
        capture: &'a Capture,
        splats: Splats,
        adam: AdamState,
        basis: RateBasis,
        background: [f32; 3],
        first_splats: usize,
        config: TrainConfig,
        level: SimdLevel,
    ) -> Self {
        Self {
            capture,
            backend: cpu(capture, &config, level),
            is_device: false,
            level,
            frames_wanted: None,
            is_uploaded: false,
            is_current: true,
            counts: (splats.n_static(), splats.n_dynamic()),
            saved: Instant::now(),
            last: StepReport::NONE,
            pending: HashSet::new(),
            times: capture.frames.iter().map(|f| f.t).collect(),
            distance_sigmas: capture.frames.iter().map(|f| f.distance_sigma).collect(),
            time_frames: capture.time_frames,
            duration_s: capture.duration_s,
            scale: SceneScale::of(capture),
            fixed: (0..splats.n())
                .filter(|&row| adam.step[row] == FIXED)
                .map(|row| place(&splats, row))
                .collect(),
            fit: Refinement::new(capture.frames.iter().map(|f| f.camera)),
            picker: Picker::new(config.seed, capture.frames.len()),
            iteration: 0,
            is_fitted: config.colour_fit_rounds == 0,
            good: 0,
            totals: Totals::default(),
            seconds: 0.0,
            processor_seconds: 0.0,
            splats,
            adam,
            basis,
            background,
            first_splats,
            config,
        }
    }

    /// Steps of the whole run.
    pub fn iterations(&self) -> usize {
        self.config.iterations
    }

    /// Steps taken.
    pub fn iteration(&self) -> usize {
        self.iteration
    }

    /// Takes steps on `backend` from here on instead of the CPU. The result depends on it as on a
    /// SIMD level: the same device gives the same bits, another one last digits of its own.
    /// Corrections of poses or exposures wait for the device where a frame is drawn again, a few
    /// times for all frames; that of the focal length waits in every step. Fails with
    /// [`TrainError::Device`] if the backend that was used before fails to give its splats back.
    pub fn use_backend(&mut self, mut backend: Box<dyn Backend + 'a>) -> Result<(), TrainError> {
        if self.config.density.needs_image_gradients() {
            backend.collect_image_gradients();
        }
        self.synchronize()?;
        self.backend = backend;
        self.is_device = true;
        self.frames_wanted = Some(self.capture);
        Ok(())
    }

    /// Takes steps on the CPU from here on; `level` is what its kernels are compiled for. After a
    /// device failed, from its last good state. Fails with [`TrainError::Device`] if another
    /// backend that was used before fails to give its splats back.
    pub fn use_cpu(&mut self, level: SimdLevel) -> Result<(), TrainError> {
        self.synchronize()?;
        self.backend = cpu(self.capture, &self.config, level);
        self.is_device = false;
        self.frames_wanted = None;
        Ok(())
    }

    /// Whether steps are done when they return.
    pub(crate) fn is_synchronous(&self) -> bool {
        self.backend.is_synchronous()
    }

    /// The splats as they are.
    pub fn splats(&self) -> &Splats {
        &self.splats
    }

    /// The lengths that rates are measured in.
    pub fn scale(&self) -> &SceneScale {
        &self.scale
    }

    fn near(&self) -> f32 {
        NEAR_SHARE * self.scale.median_depth
    }

    /// How frame `frame` is drawn at this point of the run.
    fn view(&self, frame: usize) -> View {
        View {
            camera: self.fit.camera(frame),
            t: self.times[frame],
            background: self.background,
            near: self.near(),
            mip: self.config.mip,
            period: period(self.time_frames),
            with_depth: false,
        }
    }
}

/// The CPU as a backend.
fn cpu<'a>(capture: &'a Capture, config: &TrainConfig, level: SimdLevel) -> Box<dyn Backend + 'a> {
    let mut backend = CpuBackend::new(capture, config.target_cache_mb, level);
    if config.density.needs_image_gradients() {
        backend.collect_image_gradients();
    }
    Box::new(backend)
}

/// Refuses what no run can start from.
fn check_start(capture: &Capture, splats: &Splats, config: &TrainConfig) -> Result<(), TrainError> {
    config.check()?;
    Err(if capture.frames.is_empty() {
        TrainError::NoFrames
    } else if splats.n() == 0 {
        TrainError::NoSplats
    } else if !splats.is_finite() {
        TrainError::BadSplats
    } else {
        return Ok(());
    })
}

/// Bits of the centre of a splat.
fn place(splats: &Splats, row: usize) -> [u32; 3] {
    [0, 1, 2].map(|k| splats.column(Column::Mean, k)[row].to_bits())
}

/// Median standard deviation in time, frames; 1 without dynamic splats.
fn median_time_sd(splats: &Splats) -> f32 {
    median(&mut splats.column(Column::LogTimeSd, 0).to_vec()).map_or(1.0, f32::exp)
}

/// The mean colour of pixels without depth where there are enough of them, else black.
fn background_of(capture: &Capture) -> [f32; 3] {
    let (mut sum, mut empty, mut all) = ([0.0f64; 3], 0usize, 0usize);
    for frame in &capture.frames {
        let Some(depth) = &frame.depth else { continue };
        let ((dw, dh), (w, h)) = (depth.size(), frame.rgb.size());
        for y in (0..dh).step_by(2) {
            for x in (0..dw).step_by(2) {
                all += 1;
                if depth.at(x, y) == 0.0 {
                    let rgb = frame.rgb[((2 * x + 1) * w / (2 * dw), (2 * y + 1) * h / (2 * dh))];
                    (0..3).for_each(|k| sum[k] += f64::from(rgb[k]) / 255.0);
                    empty += 1;
                }
            }
        }
    }
    if empty == 0 || empty * 1000 < all {
        [0.0; 3]
    } else {
        sum.map(|s| (s / empty as f64) as f32)
    }
}
