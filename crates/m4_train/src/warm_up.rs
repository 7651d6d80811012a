//! Makes a device compile its kernels before they are needed.

use crate::{
    Backend, TrainError, Trainer,
    config::{DensityConfig, RefineConfig, TrainConfig},
    scale::SceneScale,
};
use m4_core::{
    BINDING_NODES, Binding, Capture, Column, CounterRng, Pose, Silent, SplatLayout, Splats, Window,
    nalgebra::Vector3,
};
use m4_kernels::SimdLevel;
use std::sync::Arc;

/// Splats: sums and sorts of fewer run in a single cube, by other kernels.
const SPLATS: usize = 16_384;
/// Steps: each is followed by a round of density control.
const STEPS: usize = 4;
const FRAMES: usize = 2;
/// Standard deviation of a splat, in distances from the camera: next to nothing.
const SIZE: f32 = 1e-4;

/// Trains a few thousand tiny splats of `layout` on the first frames of `capture` by these settings
/// for a few steps on `backend`, with everything that a training does somewhere on its way. A GPU
/// compiles a kernel when it is first launched; a training that follows finds them compiled. Meant
/// for a thread of its own while the CPU makes the first splats. Nothing else remains of it. Fails
/// as [`Trainer::new`], [`Trainer::use_backend`] and [`Trainer::run`].
pub fn warm_up<'a>(
    capture: &Capture,
    layout: SplatLayout,
    config: &TrainConfig,
    backend: Box<dyn Backend + 'a>,
) -> Result<(), TrainError> {
    let frames = capture.frames.iter().take(FRAMES).cloned().collect();
    let few = Capture {
        frames,
        tracks: None,
        ..*capture
    };
    let config = TrainConfig {
        iterations: STEPS,
        guard_every: 1,
        metrics_every: 1,
        refine: RefineConfig {
            from: 0,
            ..config.refine.clone()
        },
        density: DensityConfig {
            from: 0.0,
            until: 1.0,
            every: 0.0,
            prune_every: 0.0,
            // some grow whatever their errors
            densify_threshold: -1.0,
            budget: 0.1,
            max_growth: 2.0,
            ..config.density.clone()
        },
        ..config.clone()
    };
    let mut trainer = Trainer::new(&few, splats(&few, layout), config, SimdLevel::best())?;
    trainer.use_backend(backend)?;
    trainer.run(&Silent, &mut |_| {}).map(|_| ())
}

/// Half of them static, spread over the first image at the usual distance.
fn splats(capture: &Capture, layout: SplatLayout) -> Splats {
    let mut out = Splats::zeros(layout, SPLATS / 2, SPLATS / 2);
    let Some(frame) = capture.frames.first() else {
        return out;
    };
    let (camera, depth) = (&frame.camera, SceneScale::of(capture).median_depth);
    let k = &camera.intrinsics;
    let mut rng = CounterRng::new(0, 0, 0);
    for row in 0..SPLATS {
        let (x, y) = (
            rng.uniform() * k.width as f64,
            rng.uniform() * k.height as f64,
        );
        let local = Vector3::new((x - k.cx) / k.fx, (y - k.cy) / k.fy, 1.0) * f64::from(depth);
        let world = camera.c2w.transform(&local);
        (0..3).for_each(|axis| out.column_mut(Column::Mean, axis)[row] = world[axis] as f32);
    }
    for axis in 0..layout.range(Column::LogScale).len() {
        out.column_mut(Column::LogScale, axis)
            .fill((SIZE * depth).ln());
    }
    if !layout.isotropic {
        out.column_mut(Column::Quat, 0).fill(1.0);
        bind(capture, &mut out);
    }
    out
}

/// Binds half of the dynamic ones to nodes that do not move, as profiles do whose splats are no
/// spheres.
fn bind(capture: &Capture, splats: &mut Splats) {
    let mut keys: Vec<f32> = capture.frames.iter().map(|frame| frame.t as f32).collect();
    keys.sort_by(f32::total_cmp);
    keys.dedup();
    let pose = Pose {
        position: [0.0; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
    };
    let poses = vec![pose; BINDING_NODES * keys.len()];
    let binding = Binding {
        window: 0,
        nodes: std::array::from_fn(|k| k as u16),
        weights: [1.0 / BINDING_NODES as f32; BINDING_NODES],
        life: [f32::NEG_INFINITY, f32::INFINITY],
    };
    if let Ok(window) = Window::new(keys, vec![[0.0; 3]; BINDING_NODES], poses) {
        let bound = splats.bind(
            Arc::new(vec![window]),
            vec![binding; splats.n_dynamic() / 2],
        );
        debug_assert!(bound.is_ok());
    }
}
