//! Turns the points of a clip into rows of splats: static, bound, free.

use crate::init::{
    FirstSplats, InitConfig, InitError, TimeSpread,
    lives::{Bound, Lives},
    motion::Paths,
    shell::Shell,
    tracked::Tracked,
    voxel::Centroids,
    write::{BRIGHT, DARK, Writer, Y00, spacing},
};
use m4_core::{Capture, Column, SplatLayout, Splats, nalgebra::Quaternion};
use std::sync::Arc;

/// Splats that darken or brighten what is behind them, at one keyframe; the colour of a centroid is
/// the share of light that it takes away or adds.
#[derive(Debug, Default)]
pub(crate) struct Tints {
    pub darker: Centroids,
    pub brighter: Centroids,
}

/// Everything that splats are made of.
pub(crate) struct Parts {
    pub static_points: Centroids,
    pub shell: Shell,
    /// Time and points, one per keyframe.
    pub dynamic: Vec<(f64, Centroids)>,
    /// Motion of the points of each keyframe.
    pub paths: Vec<Paths>,
    /// What the points of the keyframes become.
    pub lives: Lives,
    /// Points of tracks that each keyframe lacks.
    pub tracked: Vec<Tracked>,
    /// One per keyframe.
    pub tints: Vec<Tints>,
}

/// The rows of all parts.
pub(crate) fn rows(
    capture: &Capture,
    config: &InitConfig,
    parts: Parts,
) -> Result<FirstSplats, InitError> {
    let layout = SplatLayout {
        isotropic: config.isotropic,
        sh_degree: 0,
        time_degree: 0,
    };
    let count = |of: fn(&Parts) -> usize| of(&parts);
    let n_bound = count(|p| p.lives.bound.iter().map(Vec::len).sum());
    let n_free = count(|p| p.lives.free.iter().map(Vec::len).sum());
    let n_tracked = count(|p| p.tracked.iter().map(|t| t.points.xyz.len()).sum());
    let n_tints = count(|p| {
        p.tints
            .iter()
            .map(|t| t.darker.xyz.len() + t.brighter.xyz.len())
            .sum()
    });
    let n_background = parts.static_points.xyz.len() + parts.shell.xyz.len();
    let n_static = if config.static_fade { 0 } else { n_background };
    let mut splats = Splats::zeros(
        layout,
        n_static,
        n_background - n_static + n_bound + n_free + n_tracked + n_tints,
    );

    let mut writer = Writer {
        splats: &mut splats,
        config,
        row: 0,
    };
    writer.surface(&parts.static_points);
    writer.shell(&parts.shell);
    let fixed = writer.row - parts.shell.filling..writer.row;
    let times: Vec<f64> = parts.dynamic.iter().map(|(t, _)| *t).collect();
    if config.static_fade {
        writer.time(0, static_life(capture, config));
    }
    let mut bindings = Vec::with_capacity(n_bound);
    let (mut bound_row, mut free_row) = (n_background, n_background + n_bound);
    for (i, (t, points)) in parts.dynamic.iter().enumerate() {
        // sizes follow from all points of the keyframe
        let mut own = Splats::zeros(layout, points.xyz.len(), 0);
        Writer {
            splats: &mut own,
            config,
            row: 0,
        }
        .surface(points);
        let (bound, free) = (&parts.lives.bound[i], &parts.lives.free[i]);
        copy(&own, bound.iter().map(|b| b.point), &mut splats, bound_row);
        for bound in bound {
            bind(&mut splats, bound_row, bound, &times, i);
            bindings.push(bound.binding);
            bound_row += 1;
        }
        copy(&own, free.iter().copied(), &mut splats, free_row);
        let mut writer = Writer {
            splats: &mut splats,
            config,
            row: free_row + free.len(),
        };
        let Paths { velocity, bend } = parts.paths[i].of_points(free);
        writer.velocity(free_row, &velocity);
        let first = writer.row;
        writer.surface(&parts.tracked[i].points);
        writer.velocity(first, &parts.tracked[i].velocity);
        writer.tint(&parts.tints[i].darker, DARK);
        writer.tint(&parts.tints[i].brighter, BRIGHT);
        writer.time(
            free_row,
            (*t as f32, log_time_sd(capture, config, &times, i)),
        );
        if let TimeSpread::KeyframeGaps { .. } = config.time_spread {
            writer.shorten(free_row, &bend);
        }
        free_row = writer.row;
    }
    if config.isotropic {
        space_all(&mut splats, config);
    }
    splats.bind(Arc::new(parts.lives.windows), bindings)?;
    Ok(FirstSplats { splats, fixed })
}

/// Copies rows of static splats, one after the other from `first` on.
fn copy(from: &Splats, rows: impl Iterator<Item = u32> + Clone, to: &mut Splats, first: usize) {
    let shared = from.layout().shared_columns();
    for (from, to) in from.columns().iter().zip(to.columns_mut()).take(shared) {
        for (row, out) in rows.clone().zip(to.get_mut(first..).unwrap_or_default()) {
            *out = from[row as usize];
        }
    }
}

/// Turns a row of keyframe `key` into one of a bound splat; `times` are those of all keyframes,
/// frames.
fn bind(splats: &mut Splats, row: usize, bound: &Bound, times: &[f64], key: usize) {
    for k in 0..3 {
        splats.column_mut(Column::Mean, k)[row] = bound.mean[k];
    }
    if !splats.layout().isotropic {
        let [w, x, y, z] = bound.turn;
        let own: [f32; 4] = std::array::from_fn(|k| splats.column(Column::Quat, k)[row]);
        let q = Quaternion::new(w, -x, -y, -z) * Quaternion::new(own[0], own[1], own[2], own[3]);
        for (k, v) in [q.w, q.i, q.j, q.k].into_iter().enumerate() {
            splats.column_mut(Column::Quat, k)[row] = v;
        }
    }
    let i = row - splats.n_static();
    for k in 0..3 {
        splats.column_mut(Column::Trend, k)[i] = bound.trend[k] / Y00;
    }
    splats.column_mut(Column::TimeMean, 0)[i] = times[key] as f32;
    // an end that is open is that of the clip
    let [begin, end] = bound.binding.life.map(f64::from);
    let length = end.min(times[times.len() - 1]) - begin.max(times[0]);
    splats.column_mut(Column::LogTimeSd, 0)[i] = (0.5 * length.max(gap(times, key))).ln() as f32;
}

/// Sizes splats by their neighbours among all of them, of whatever time (Instant4D;
/// docs/spec/optimiser.md 2.5).
fn space_all(splats: &mut Splats, config: &InitConfig) {
    let means: Vec<[f32; 3]> = (0..splats.n())
        .map(|row| [0, 1, 2].map(|k| splats.column(Column::Mean, k)[row]))
        .collect();
    let own: Vec<f32> = splats
        .column(Column::LogScale, 0)
        .iter()
        .map(|log| log.exp() / config.scale_factor)
        .collect();
    let spacing = spacing(&means, &own);
    for (log, size) in splats
        .column_mut(Column::LogScale, 0)
        .iter_mut()
        .zip(spacing)
    {
        *log = (config.scale_factor * size).ln();
    }
}

/// Middle and logarithm of the standard deviation in time, frames, of static points that fade.
fn static_life(capture: &Capture, config: &InitConfig) -> (f32, f32) {
    let last = (capture.time_frames.max(2) - 1) as f32;
    // without a reference time axis they fade as the reference's do at D = 3
    let time_range = match config.time_spread {
        TimeSpread::KeyframeGaps { .. } => 3.0,
        TimeSpread::Reference { time_range } => time_range,
    };
    let middle = if time_range >= 2.0 {
        last / 3.0
    } else {
        last / 2.0
    };
    (middle, (last / time_range.sqrt()).ln())
}

/// Logarithm of the standard deviation in time, frames, of the points of keyframe `i`; `times` are
/// those of all keyframes, in order.
fn log_time_sd(capture: &Capture, config: &InitConfig, times: &[f64], i: usize) -> f32 {
    match config.time_spread {
        TimeSpread::KeyframeGaps { factor } => (factor * gap(times, i) as f32).ln(),
        TimeSpread::Reference { time_range } => {
            let last = (capture.time_frames.max(2) - 1) as f32;
            0.5 * (last / (10.0 * time_range)).ln()
        }
    }
}

/// Mean of the frames from keyframe `i` to its neighbours in time; 1 for a lone one. Keyframes of
/// the same instant, from another camera, are no neighbours.
fn gap(times: &[f64], i: usize) -> f64 {
    let before = times[..i]
        .iter()
        .rev()
        .map(|t| times[i] - t)
        .find(|gap| *gap > 0.0);
    let after = times[i..]
        .iter()
        .map(|t| t - times[i])
        .find(|gap| *gap > 0.0);
    match (before, after) {
        (Some(before), Some(after)) => 0.5 * (before + after),
        (Some(gap), None) | (None, Some(gap)) => gap,
        (None, None) => 1.0,
    }
}
