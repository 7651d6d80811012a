//! Clouds to splats.

use crate::cloud::{Clouds, clouds};
use crate::spacing::spacing;
use crate::velocity::velocities;
use crate::voxel::{Centroids, Grid, pixels_for};
use crate::{InitConfig, InitError, TimeSpread, VelocityInit};
use m4_scene::{Capture, Column, Progress, SplatLayout, Splats};
use rayon::prelude::*;

/// Value of the constant spherical harmonic.
const Y00: f32 = 0.282_094_8;
/// Voxels below this many pixels are never tried: each pixel is its own point there.
const LEAST_PIXELS: f32 = 0.5;

/// The first splats of a capture.
///
/// Frames without a mask stand still everywhere; frames without depth are skipped. Static splats
/// come first; dynamic ones are in order of time.
///
/// # Errors
///
/// [`InitError`] if a setting is out of range, the capture has no frame or no usable depth, a camera
/// is not finite, or `progress` asked to stop.
pub fn initialise(capture: &Capture, config: &InitConfig, progress: &dyn Progress) -> Result<Splats, InitError> {
    config.check()?;
    let clouds = clouds(capture, config, progress)?;
    let centres: Vec<[f32; 3]> = every_nth(capture.frames.len(), 16)
        .map(|i| capture.frames[i].camera.centre())
        .map(|c| [c.x as f32, c.y as f32, c.z as f32])
        .collect();
    let origin = centres[0];
    let grid = |pixels| {
        Grid::new(
            config.cells,
            pixels,
            clouds.focal_px,
            clouds.median_depth,
            &centres,
            origin,
        )
    };

    let static_pixels = match config.static_pixels {
        0.0 => pixels_for(config.max_static, LEAST_PIXELS, |p| grid(p).occupied(&clouds.standing)),
        pixels => pixels,
    };
    let standing = grid(static_pixels).merge(&clouds.standing);
    if progress.cancelled() {
        return Err(InitError::Stopped);
    }
    progress.update("voxels", 1, 2, &format!("{} static", standing.xyz.len()));

    let count = |p| {
        let grid = grid(p);
        clouds.moving.iter().map(|k| grid.occupied(&k.cloud)).sum()
    };
    let dynamic_pixels = match config.dynamic_pixels {
        0.0 => pixels_for(config.max_dynamic, LEAST_PIXELS, count),
        pixels => pixels,
    };
    let moving_grid = grid(dynamic_pixels);
    let moving: Vec<(f64, Centroids)> = clouds
        .moving
        .par_iter()
        .map(|k| (k.t, moving_grid.merge(&k.cloud)))
        .collect();
    if progress.cancelled() {
        return Err(InitError::Stopped);
    }
    let n_moving: usize = moving.iter().map(|(_, c)| c.xyz.len()).sum();
    progress.update(
        "voxels",
        2,
        2,
        &format!("{} static, {n_moving} dynamic", standing.xyz.len()),
    );
    Ok(assemble(capture, config, &clouds, &standing, &moving))
}

/// At most `count` indices below `n`, evenly spread.
fn every_nth(n: usize, count: usize) -> impl Iterator<Item = usize> {
    (0..n).step_by(n.div_ceil(count).max(1))
}

fn assemble(
    capture: &Capture,
    config: &InitConfig,
    clouds: &Clouds,
    standing: &Centroids,
    moving: &[(f64, Centroids)],
) -> Splats {
    let layout = SplatLayout {
        isotropic: config.isotropic,
        sh_degree: 0,
        time_degree: 0,
    };
    let n_moving = moving.iter().map(|(_, c)| c.xyz.len()).sum::<usize>();
    let (n_static, n_fading) = if config.static_fade {
        (0, standing.xyz.len())
    } else {
        (standing.xyz.len(), 0)
    };
    let mut splats = Splats::zeros(layout, n_static, n_fading + n_moving);

    fill_shared(&mut splats, config, 0, standing);
    let mut row = standing.xyz.len();
    let spans = spans(capture, config, moving);
    if config.static_fade {
        fill_time(&mut splats, 0, n_fading, spans.standing);
    }
    for (i, (t, points)) in moving.iter().enumerate() {
        fill_shared(&mut splats, config, row, points);
        let time_row = row - n_static;
        fill_time(&mut splats, time_row, points.xyz.len(), (*t as f32, spans.moving));
        if let VelocityInit::Nearest {
            colour_scale,
            radius,
            neighbours,
        } = config.velocity
        {
            let radius = radius * clouds.median_depth as f32;
            let v = velocities(moving, i, radius, colour_scale, neighbours);
            for k in 0..3 {
                let column = splats.column_mut(Column::Velocity, k);
                for (out, v) in column[time_row..].iter_mut().zip(&v) {
                    *out = v[k];
                }
            }
        }
        row += points.xyz.len();
    }
    splats
}

/// Mean, size, rotation, opacity and colour of `points`, from row `first` on.
fn fill_shared(splats: &mut Splats, config: &InitConfig, first: usize, points: &Centroids) {
    let size = spacing(&points.xyz, &points.edge);
    let scales = if config.isotropic { 1 } else { 3 };
    let logit = (config.opacity / (1.0 - config.opacity)).ln();
    for (i, &p) in points.xyz.iter().enumerate() {
        let row = first + i;
        let scale = (config.scale_factor * size[i]).min(config.max_scale_cells * points.edge[i]);
        for k in 0..3 {
            splats.column_mut(Column::Mean, k)[row] = p[k];
            splats.column_mut(Column::Colour, k)[row] = (points.rgb[i][k] - 0.5) / Y00;
        }
        for k in 0..scales {
            splats.column_mut(Column::LogScale, k)[row] = scale.ln();
        }
        if !config.isotropic {
            splats.column_mut(Column::Quat, 0)[row] = 1.0;
        }
        splats.column_mut(Column::Opacity, 0)[row] = logit;
    }
}

/// Middle and logarithm of the standard deviation, frames, of `count` rows of the time columns.
fn fill_time(splats: &mut Splats, first: usize, count: usize, (mean, log_sd): (f32, f32)) {
    splats.column_mut(Column::TimeMean, 0)[first..first + count].fill(mean);
    splats.column_mut(Column::LogTimeSd, 0)[first..first + count].fill(log_sd);
}

/// Time parameters: `(mean, log sd)` of standing points that fade, `log sd` of moving ones.
struct Spans {
    standing: (f32, f32),
    moving: f32,
}

fn spans(capture: &Capture, config: &InitConfig, moving: &[(f64, Centroids)]) -> Spans {
    let last = (capture.time_frames.max(2) - 1) as f32;
    let gap = match moving {
        [(first, _), .., (end, _)] => (end - first) as f32 / (moving.len() - 1) as f32,
        _ => 1.0,
    };
    match config.time_spread {
        TimeSpread::KeyframeGaps { factor, min_frames } => Spans {
            // Without a reference time axis, standing points that must fade do so as the reference does at D = 3.
            standing: (last / 3.0, (last / 3.0f32.sqrt()).ln()),
            moving: (factor * gap).max(min_frames).ln(),
        },
        TimeSpread::Reference { time_range } => Spans {
            standing: (
                if time_range >= 2.0 { last / 3.0 } else { last / 2.0 },
                (last / time_range.sqrt()).ln(),
            ),
            moving: 0.5 * (last / (10.0 * time_range)).ln(),
        },
    }
}
