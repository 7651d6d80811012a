//! Turns point clouds into splats.

use crate::init::{
    CellSize, InitConfig, InitError, TimeSpread, VelocityInit,
    carry::{CARRY_MARGIN, CARRY_REACH_PIXELS, Carry, MOST_CARRIED, Moving, hidden, is_seen},
    change::changes,
    cloud::{Clouds, Pixels, clouds},
    config::stopped,
    motion::{Fields, KeyframeTracks, NODE_PIXELS, Paths, REACH_PIXELS, View, fields},
    shell::{Shell, shell},
    surface::{Surface, surface},
    tracked::{self, Known},
    voxel::{Centroids, Grid, pixels_for},
    write::{BRIGHT, DARK, Writer, spacing},
};
use m4_core::{Capture, Column, Progress, SplatLayout, Splats};
use rayon::prelude::*;
use std::ops::Range;

/// Voxels are never smaller than this, pixels at the median depth: splats finer than the pixels leave cracks in views from the
/// side (measured: -0.4 dB inside moving parts at 0.5; docs/decisions/0004).
const MIN_PIXELS: f32 = 1.25;
/// Edge of voxels, pixels, that merge no two pixels of a frame.
const UNMERGED_PIXELS: f32 = 0.1;
/// Spacing of the splats that tint changed patches, pixels at the median depth (our rule).
const TINT_PIXELS: f32 = 5.0;
/// Radius of the shell, in units of the depth below which 99 of 100 pixels lie (our rule).
const SHELL_RADIUS: f32 = 2.0;

/// Where a training starts.
#[derive(Debug, Clone, PartialEq)]
pub struct FirstSplats {
    /// Static ones first; dynamic ones are in order of time.
    pub splats: Splats,
    /// Static rows that are drawn, but never trained or split: nothing that a frame shows is theirs, they only fill what no
    /// frame shows (docs/decisions/0020). Dynamic rows among them are trained.
    pub fixed: Range<usize>,
}

impl From<Splats> for FirstSplats {
    /// All of them are trained.
    fn from(splats: Splats) -> Self {
        Self { splats, fixed: 0..0 }
    }
}

/// The first splats of a capture.
///
/// Frames without a mask are static everywhere; frames without depth are skipped. Fails with [`InitError`] if a setting is
/// out of range, the capture has no frame or no usable depth, a camera is not finite, or `progress` asked to stop.
pub fn initialise(capture: &Capture, config: &InitConfig, progress: &dyn Progress) -> Result<FirstSplats, InitError> {
    config.check()?;
    if let Some(tracks) = capture.tracks.as_ref().filter(|t| t.frames() != capture.frames.len()) {
        return Err(InitError::Tracks { frames: capture.frames.len(), tracks: tracks.frames() });
    }
    let clouds = clouds(capture, config, progress)?;
    let (focal_px, median_depth) = (clouds.focal_px, clouds.median_depth);
    let centres: Vec<[f32; 3]> = every_nth(capture.frames.len(), 16)
        .map(|i| capture.frames[i].camera.centre())
        .map(|c| [c.x as f32, c.y as f32, c.z as f32])
        .collect();
    let origin = centres[0];
    let grid = |pixels| {
        let depth = match config.cells {
            CellSize::Constant => clouds.first_depth,
            CellSize::DepthProportional => median_depth,
        };
        Grid::new(config.cells, pixels, focal_px, depth, &centres, origin)
    };
    let points = |pixels: &Pixels| pixels.cloud(capture);

    let least = config.voxel_px.unwrap_or(MIN_PIXELS);
    let (static_grid, static_points) = if config.merge_surfaces {
        let Surface { cloud, count } = surface(capture, &clouds.static_points, progress)?;
        let grid = grid(pixels_for(config.max_static, least, |p| grid(p).occupied(&cloud)));
        let points = grid.merge_weighted(&cloud, &count);
        (grid, points)
    } else {
        let parts = &clouds.static_points;
        let grid = grid(pixels_for(config.max_static, least, |p| grid(p).occupied_by(parts, points)));
        let merged = grid.merge_all(parts, points);
        (grid, merged)
    };
    stopped(progress)?;
    progress.update("voxels", 1, 3, &format!("{} static", static_points.xyz.len()));

    let count = |p| {
        let grid = grid(p);
        clouds.moving.par_iter().map(|k| grid.occupied(&points(k))).sum()
    };
    let least = if config.voxel_px.is_some() { UNMERGED_PIXELS } else { MIN_PIXELS };
    let moving_grid = grid(pixels_for(config.max_dynamic, least, count));
    let moving: Vec<(f64, Centroids)> =
        clouds.moving.par_iter().map(|k| (capture.frames[k.frame].t, moving_grid.merge(&points(k)))).collect();
    stopped(progress)?;
    progress.update("voxels", 2, 3, &format!("{} static", static_points.xyz.len()));

    let fields = motions(capture, config, &clouds, &moving, &grid, progress)?;
    let frames: Vec<usize> = clouds.moving.iter().map(|k| k.frame).collect();
    let by = Carry {
        keyframes: match config.velocity {
            // What does not move is carried nowhere.
            VelocityInit::Zero => 0,
            VelocityInit::Register { .. } => config.carry_keyframes,
        },
        most: MOST_CARRIED,
        margin: CARRY_MARGIN,
        reach: (f64::from(CARRY_REACH_PIXELS) * median_depth / focal_px) as f32,
    };
    let hidden = hidden(capture, &frames, &moving, &fields, &moving_grid, by, progress)?;
    let known = Known {
        capture,
        frames: &frames,
        moving: &moving,
        carried: &hidden,
        grid: &moving_grid,
        depth_range: [clouds.near_depth, clouds.far_depth],
        median_depth,
    };
    stopped(progress)?;
    let tracked = tracked::tracked(&known, config);
    stopped(progress)?;
    let centre = |i: usize| capture.frames[frames[i]].camera.centre();
    let paths: Vec<Paths> = (0..moving.len()).map(|i| Paths::of(&moving, &fields, i, &centre(i))).collect();
    stopped(progress)?;
    let tint_grid = grid(TINT_PIXELS);
    let tints: Vec<Tints> = frames
        .par_iter()
        .map(|&frame| {
            if config.change_threshold <= 0.0 {
                return Tints::default();
            }
            let found = changes(&capture.frames[frame], config, &static_grid, &static_points);
            Tints { darker: tint_grid.merge(&found.darker), brighter: tint_grid.merge(&found.brighter) }
        })
        .collect();
    let shell = shell(capture, config.shell_splats, SHELL_RADIUS * clouds.far_depth as f32);
    let parts = Parts { static_points, shell, moving, paths, hidden, tracked, tints };
    let first = assemble(capture, config, &parts);
    let note = format!("{} static, {} dynamic", first.splats.n_static(), first.splats.n_dynamic());
    progress.update("voxels", 3, 3, &note);
    Ok(first)
}

/// Splats that darken or brighten what is behind them, at one keyframe; the colour of a centroid is the
/// share of light that it takes away or adds.
#[derive(Debug, Default)]
struct Tints {
    darker: Centroids,
    brighter: Centroids,
}

/// Everything that splats are made of.
struct Parts {
    static_points: Centroids,
    shell: Shell,
    /// Time and points, one per keyframe.
    moving: Vec<(f64, Centroids)>,
    /// Motion of the points, one per keyframe.
    paths: Vec<Paths>,
    /// Points that a keyframe cannot see.
    hidden: Vec<Moving>,
    /// Points of tracks that each keyframe lacks.
    tracked: Vec<Moving>,
    /// One per keyframe.
    tints: Vec<Tints>,
}

/// A place behind the depth map by this share of the depth is not looked for in an image.
const HIDDEN_BEHIND: f32 = 0.05;

/// Motions between keyframes, found on a coarser grid; none where they are not asked for.
fn motions(
    capture: &Capture,
    config: &InitConfig,
    clouds: &Clouds,
    moving: &[(f64, Centroids)],
    grid: &impl Fn(f32) -> Grid,
    progress: &dyn Progress,
) -> Result<Vec<Fields>, InitError> {
    match config.velocity {
        VelocityInit::Zero => Ok(vec![Fields::default(); moving.len().saturating_sub(1)]),
        VelocityInit::Register { tracks } => {
            let coarse_grid = grid(NODE_PIXELS);
            let coarse = clouds.moving.par_iter().map(|k| coarse_grid.merge(&k.cloud(capture)));
            let coarse: Vec<Centroids> = coarse.collect();
            let reach = (f64::from(REACH_PIXELS) * clouds.median_depth / clouds.focal_px) as f32;
            let frames = || clouds.moving.iter().map(|k| &capture.frames[k.frame]);
            let sees: Vec<_> = frames().map(|frame| move |p| is_seen(frame, p, HIDDEN_BEHIND)).collect();
            let keyframes: Vec<View<'_>> = frames()
                .enumerate()
                .map(|(i, frame)| View { nodes: &coarse[i], points: &moving[i].1, frame: Some(frame), sees: &sees[i] })
                .collect();
            let frames: Vec<usize> = clouds.moving.iter().map(|k| k.frame).collect();
            let tracks = capture.tracks.as_ref().filter(|_| tracks).map(|tracks| KeyframeTracks {
                tracks,
                frames: &frames,
                reach,
            });
            fields(&keyframes, tracks, reach, progress)
        }
    }
}

/// At most `count` indices below `n`, evenly spread.
fn every_nth(n: usize, count: usize) -> impl Iterator<Item = usize> {
    (0..n).step_by(n.div_ceil(count).max(1))
}

fn assemble(capture: &Capture, config: &InitConfig, parts: &Parts) -> FirstSplats {
    let layout = SplatLayout { isotropic: config.isotropic, sh_degree: 0, time_degree: 0 };
    let n_moving: usize = parts.moving.iter().map(|(_, c)| c.xyz.len()).sum();
    let unseen = || parts.hidden.iter().chain(&parts.tracked);
    let n_hidden: usize = unseen().map(|m| m.points.xyz.len()).sum();
    let n_tints: usize = parts.tints.iter().map(|t| t.darker.xyz.len() + t.brighter.xyz.len()).sum();
    let n_background = parts.static_points.xyz.len() + parts.shell.xyz.len();
    let n_static = if config.static_fade { 0 } else { n_background };
    let mut splats = Splats::zeros(layout, n_static, n_background - n_static + n_moving + n_hidden + n_tints);

    let mut writer = Writer { splats: &mut splats, config, row: 0 };
    writer.surface(&parts.static_points);
    writer.shell(&parts.shell);
    let fixed = writer.row - parts.shell.filling..writer.row;
    let times: Vec<f64> = parts.moving.iter().map(|(t, _)| *t).collect();
    if config.static_fade {
        writer.time(0, static_life(capture, config));
    }
    for (i, (t, points)) in parts.moving.iter().enumerate() {
        let first = writer.row;
        writer.surface(points);
        writer.velocity(first, &parts.paths[i].velocity);
        for unseen in [&parts.hidden[i], &parts.tracked[i]] {
            let first = writer.row;
            writer.surface(&unseen.points);
            writer.velocity(first, &unseen.velocity);
        }
        writer.tint(&parts.tints[i].darker, DARK);
        writer.tint(&parts.tints[i].brighter, BRIGHT);
        writer.time(first, (*t as f32, log_time_sd(capture, config, &times, i)));
        if let TimeSpread::KeyframeGaps { .. } = config.time_spread {
            writer.shorten(first, &parts.paths[i].bend);
        }
    }
    if config.isotropic {
        space_all(&mut splats, config);
    }
    FirstSplats { splats, fixed }
}

/// Sizes splats by their neighbours among all of them, of whatever time (Instant4D; docs/spec/optimiser.md 2.5).
fn space_all(splats: &mut Splats, config: &InitConfig) {
    let means: Vec<[f32; 3]> =
        (0..splats.n()).map(|row| [0, 1, 2].map(|k| splats.column(Column::Mean, k)[row])).collect();
    let own: Vec<f32> = splats.column(Column::LogScale, 0).iter().map(|log| log.exp() / config.scale_factor).collect();
    let spacing = spacing(&means, &own);
    for (log, size) in splats.column_mut(Column::LogScale, 0).iter_mut().zip(spacing) {
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
    let middle = if time_range >= 2.0 { last / 3.0 } else { last / 2.0 };
    (middle, (last / time_range.sqrt()).ln())
}

/// Logarithm of the standard deviation in time, frames, of the points of keyframe `i`; `times` are those of all
/// keyframes, in order.
fn log_time_sd(capture: &Capture, config: &InitConfig, times: &[f64], i: usize) -> f32 {
    match config.time_spread {
        TimeSpread::KeyframeGaps { factor } => (factor * gap(times, i) as f32).ln(),
        TimeSpread::Reference { time_range } => {
            let last = (capture.time_frames.max(2) - 1) as f32;
            0.5 * (last / (10.0 * time_range)).ln()
        }
    }
}

/// Mean of the frames from keyframe `i` to its neighbours in time; 1 for a lone one. Keyframes of the same instant, from another
/// camera, are no neighbours.
fn gap(times: &[f64], i: usize) -> f64 {
    let before = times[..i].iter().rev().map(|t| times[i] - t).find(|gap| *gap > 0.0);
    let after = times[i..].iter().map(|t| t - times[i]).find(|gap| *gap > 0.0);
    match (before, after) {
        (Some(before), Some(after)) => 0.5 * (before + after),
        (Some(gap), None) | (None, Some(gap)) => gap,
        (None, None) => 1.0,
    }
}
