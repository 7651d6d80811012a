//! Turns point clouds into splats.

use crate::init::{
    CellSize, InitConfig, InitError, LEAST_STATIC, VelocityInit,
    change::changes,
    cloud::{Clouds, Pixels, clouds},
    config::stopped,
    lives::{LifeInputs, Lives, lives},
    motion::{Fields, KeyframeTracks, KeyframeView, NODE_PIXELS, Paths, REACH_PIXELS, fields},
    rows::{Parts, Tints, rows},
    shell::shell,
    surface::{Surface, surface},
    tracked::{self, TrackContext},
    visible::is_visible,
    voxel::{Centroids, Grid, pixels_for},
};
use m4_core::{Capture, Progress, Splats};
use rayon::prelude::*;
use std::ops::Range;

/// Voxels are never smaller than this, pixels at the median depth: splats finer than the pixels
/// leave cracks in views from the side (measured: -0.4 dB inside dynamic parts at 0.5;
/// docs/decisions/0004).
const MIN_PIXELS: f32 = 1.25;
/// Edge of static voxels, pixels, where no number of splats is asked for; it is smaller, down to
/// [`MIN_PIXELS`], where there would be fewer than [`LEAST_STATIC`], and larger where there would
/// be more than [`MOST_STATIC`] (docs/decisions/0028-first-splats-by-clip.md).
const STATIC_PIXELS: f32 = 3.0;
/// Static splats of a clip that shows many.
const MOST_STATIC: usize = 250_000;
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
    /// Static rows that are drawn, but never trained or split: nothing that a frame shows is
    /// theirs, they only fill what no frame shows (docs/decisions/0020). Dynamic rows among them
    /// are trained.
    pub fixed: Range<usize>,
}

impl From<Splats> for FirstSplats {
    /// All of them are trained.
    fn from(splats: Splats) -> Self {
        Self {
            splats,
            fixed: 0..0,
        }
    }
}

/// The first splats of a capture.
///
/// Frames without a mask are static everywhere; frames without depth are skipped. Fails with
/// [`InitError`] if a setting is out of range, the capture has no frame or no usable depth, a
/// camera is not finite, or `progress` asked to stop.
pub fn initialise(
    capture: &Capture,
    config: &InitConfig,
    progress: &dyn Progress,
) -> Result<FirstSplats, InitError> {
    config.check()?;
    if let Some(tracks) = capture
        .tracks
        .as_ref()
        .filter(|t| t.frames() != capture.frames.len())
    {
        return Err(InitError::Tracks {
            frames: capture.frames.len(),
            tracks: tracks.frames(),
        });
    }
    let clouds = clouds(capture, config, progress)?;
    let median_depth = clouds.median_depth;
    let grid = |pixels| grid(capture, config, &clouds, pixels);
    let (static_grid, static_points) = if config.merge_surfaces {
        let Surface { cloud, weight } = surface(capture, &clouds.static_points, progress)?;
        let grid = grid(static_pixels(config, |p| grid(p).occupied(&cloud)));
        let points = grid.merge_weighted(&cloud, &weight);
        (grid, points)
    } else {
        let parts = &clouds.static_points;
        let points = |pixels: &Pixels| pixels.cloud(capture);
        let grid = grid(static_pixels(config, |p| {
            grid(p).occupied_by(parts, points)
        }));
        let merged = grid.merge_all(parts, points);
        (grid, merged)
    };
    stopped(progress)?;
    progress.update(
        "voxels",
        1,
        3,
        &format!("{} static", static_points.xyz.len()),
    );
    let DynamicPart {
        grid: dynamic_grid,
        frames,
        dynamic,
        fields,
    } = dynamic_part(capture, config, &clouds, progress)?;
    progress.update(
        "voxels",
        2,
        3,
        &format!("{} static", static_points.xyz.len()),
    );
    let clip = LifeInputs {
        capture,
        frames: &frames,
        dynamic: &dynamic,
        fields: &fields,
    };
    let lives = match config.velocity {
        VelocityInit::Zero => Lives::free(&dynamic),
        VelocityInit::Register { .. } => lives(clip, progress)?,
    };
    let context = TrackContext {
        capture,
        frames: &frames,
        dynamic: &dynamic,
        grid: &dynamic_grid,
        depth_range: [clouds.near_depth, clouds.far_depth],
        median_depth,
    };
    stopped(progress)?;
    let tracked = tracked::tracked(&context, config);
    stopped(progress)?;
    let tint_grid = grid(TINT_PIXELS);
    let tints: Vec<Tints> = frames
        .par_iter()
        .map(|&frame| {
            if config.change_threshold <= 0.0 {
                return Tints::default();
            }
            let change = changes(&capture.frames[frame], config, &static_grid, &static_points);
            Tints {
                darker: tint_grid.merge(&change.darker),
                brighter: tint_grid.merge(&change.brighter),
            }
        })
        .collect();
    let shell = shell(
        capture,
        config.shell_splats,
        SHELL_RADIUS * clouds.far_depth as f32,
    );
    let centre = |i: usize| capture.frames[frames[i]].camera.centre();
    let paths = (0..dynamic.len())
        .map(|i| Paths::of(&dynamic, &fields, i, &centre(i)))
        .collect();
    let parts = Parts {
        static_points,
        shell,
        dynamic,
        paths,
        lives,
        tracked,
        tints,
    };
    let first = rows(capture, config, parts)?;
    let note = format!(
        "{} static, {} dynamic",
        first.splats.n_static(),
        first.splats.n_dynamic()
    );
    progress.update("voxels", 3, 3, &note);
    Ok(first)
}

/// Edge of static voxels, pixels: the least for at most as many voxels as `config` allows, or as
/// follow from the clip. `count` says how many voxels of an edge hold a point.
fn static_pixels(config: &InitConfig, count: impl Fn(f32) -> usize) -> f32 {
    let most = match (config.max_static, config.voxel_px) {
        (Some(most), _) => most,
        (None, Some(_)) => MOST_STATIC,
        (None, None) => count(STATIC_PIXELS).clamp(LEAST_STATIC, MOST_STATIC),
    };
    pixels_for(most, config.voxel_px.unwrap_or(MIN_PIXELS), count)
}

/// The dynamic points of a clip.
pub(crate) struct DynamicPart {
    /// Of the points.
    pub grid: Grid,
    /// The frame of each keyframe.
    pub frames: Vec<usize>,
    /// Time in frames, and points.
    pub dynamic: Vec<(f64, Centroids)>,
    /// Motions from each keyframe to the next.
    pub fields: Vec<Fields>,
}

/// The dynamic points of a clip and how they move.
pub(crate) fn dynamic_part(
    capture: &Capture,
    config: &InitConfig,
    clouds: &Clouds,
    progress: &dyn Progress,
) -> Result<DynamicPart, InitError> {
    let grid = |pixels| grid(capture, config, clouds, pixels);
    let points = |pixels: &Pixels| pixels.cloud(capture);
    let count = |p| {
        let grid = grid(p);
        clouds
            .dynamic
            .par_iter()
            .map(|k| grid.occupied(&points(k)))
            .sum()
    };
    let least = if config.voxel_px.is_some() {
        UNMERGED_PIXELS
    } else {
        MIN_PIXELS
    };
    let dynamic_grid = grid(pixels_for(config.max_dynamic, least, count));
    let dynamic: Vec<(f64, Centroids)> = clouds
        .dynamic
        .par_iter()
        .map(|k| (capture.frames[k.frame].t, dynamic_grid.merge(&points(k))))
        .collect();
    stopped(progress)?;
    let fields = motions(capture, config, clouds, &dynamic, &grid, progress)?;
    let frames = clouds.dynamic.iter().map(|k| k.frame).collect();
    Ok(DynamicPart {
        grid: dynamic_grid,
        frames,
        dynamic,
        fields,
    })
}

/// Cameras that the distance of a point is measured from: closer together than what a walk passes.
const CENTRES: usize = 64;

/// Voxels of an edge of `pixels`.
fn grid(capture: &Capture, config: &InitConfig, clouds: &Clouds, pixels: f32) -> Grid {
    let centres: Vec<[f32; 3]> = every_nth(capture.frames.len(), CENTRES)
        .map(|i| capture.frames[i].camera.centre())
        .map(|c| [c.x as f32, c.y as f32, c.z as f32])
        .collect();
    let depth = match config.cells {
        CellSize::Constant => clouds.first_depth,
        CellSize::DepthProportional => clouds.median_depth,
    };
    Grid::new(
        config.cells,
        pixels,
        clouds.focal_px,
        depth,
        &centres,
        centres[0],
    )
}

/// A place behind the depth map by this share of the depth is not looked for in an image.
const HIDDEN_BEHIND: f32 = 0.05;

/// Motions between keyframes, found on a coarser grid; none where they are not asked for.
fn motions(
    capture: &Capture,
    config: &InitConfig,
    clouds: &Clouds,
    dynamic: &[(f64, Centroids)],
    grid: &impl Fn(f32) -> Grid,
    progress: &dyn Progress,
) -> Result<Vec<Fields>, InitError> {
    match config.velocity {
        VelocityInit::Zero => Ok(vec![Fields::default(); dynamic.len().saturating_sub(1)]),
        VelocityInit::Register { tracks } => {
            let coarse_grid = grid(NODE_PIXELS);
            let coarse = clouds
                .dynamic
                .par_iter()
                .map(|k| coarse_grid.merge(&k.cloud(capture)));
            let coarse: Vec<Centroids> = coarse.collect();
            let reach = (f64::from(REACH_PIXELS) * clouds.median_depth / clouds.focal_px) as f32;
            let frames = || clouds.dynamic.iter().map(|k| &capture.frames[k.frame]);
            let sees: Vec<_> = frames()
                .map(|frame| move |p| is_visible(frame, p, HIDDEN_BEHIND))
                .collect();
            let keyframes: Vec<KeyframeView<'_>> = (0..dynamic.len())
                .map(|i| KeyframeView {
                    nodes: &coarse[i],
                    points: &dynamic[i].1,
                    sees: &sees[i],
                })
                .collect();
            let frames: Vec<usize> = clouds.dynamic.iter().map(|k| k.frame).collect();
            let tracks = capture
                .tracks
                .as_ref()
                .filter(|_| tracks)
                .map(|tracks| KeyframeTracks {
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

#[cfg(test)]
mod tests {
    use super::{LEAST_STATIC, MIN_PIXELS, MOST_STATIC, STATIC_PIXELS, static_pixels};
    use crate::init::InitConfig;

    /// Voxels of an edge that a surface of `pixels` pixels fills.
    fn voxels(pixels: f32) -> impl Fn(f32) -> usize {
        move |edge| (pixels / (edge * edge)) as usize
    }

    #[test]
    fn static_splats_follow_from_the_surface_that_a_clip_shows() {
        let by_clip = InitConfig::fast();
        let edge = |pixels| static_pixels(&by_clip, voxels(pixels));
        // a clip with few pixels, one place, several, a walk
        assert_eq!(edge(1.25 * 1.25 * 60_000.0), MIN_PIXELS);
        for (pixels, want) in [
            (500_000.0, LEAST_STATIC),
            (1_500_000.0, (1_500_000.0 / STATIC_PIXELS.powi(2)) as usize),
            (9_000_000.0, MOST_STATIC),
        ] {
            let n = voxels(pixels)(edge(pixels));
            assert!(n <= want && n * 100 >= want * 96, "{n} for {want}");
        }
        let asked = InitConfig {
            max_static: Some(2000),
            ..InitConfig::fast()
        };
        let n = voxels(9e6)(static_pixels(&asked, voxels(9e6)));
        assert!((1900..=2000).contains(&n), "{n}");
        let fine = InitConfig {
            voxel_px: Some(2.0),
            ..InitConfig::fast()
        };
        assert_eq!(static_pixels(&fine, voxels(900_000.0)), 2.0);
    }
}
