//! Unprojects depth maps to coloured points in the world.

use crate::init::{InitConfig, InitError, config::stopped, free_space};
use m4_core::{Capture, CaptureFrame, CompactMask, DepthMap, Progress, dilated, nalgebra::Vector3};
use rayon::prelude::*;

/// A pixel is dropped when its depth lies between those of two opposite neighbours and differs from
/// both by more than this share: it hangs in the air between two surfaces (our rule;
/// docs/decisions/0004).
const EDGE_JUMP: f32 = 0.05;

/// Coloured points of the world.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Cloud {
    /// World units.
    pub xyz: Vec<[f32; 3]>,
    /// sRGB.
    pub rgb: Vec<[u8; 3]>,
}

impl Cloud {
    fn push(&mut self, p: Vector3<f64>, rgb: [u8; 3]) {
        self.xyz.push([p.x as f32, p.y as f32, p.z as f32]);
        self.rgb.push(rgb);
    }
}

/// Points of one frame that are made when they are looked at: a bit per pixel instead of 15 bytes
/// per point, which for all frames together would be a good part of the memory of a run.
#[derive(Debug, Clone)]
pub(crate) struct Pixels {
    /// Which frame of the capture it is.
    pub frame: usize,
    /// Pixels of its depth map that are points.
    pub mask: CompactMask,
}

impl Pixels {
    /// The points, row by row (Minute4D Eq. 4).
    pub fn cloud(&self, capture: &Capture) -> Cloud {
        let frame = &capture.frames[self.frame];
        let mut out = Cloud::default();
        let Some(depth) = &frame.depth else {
            return out;
        };
        let ((w, h), (rgb_w, rgb_h)) = (depth.size(), frame.rgb.size());
        let camera = frame.camera.resized(w, h);
        let count = self.mask.count();
        out.xyz.reserve_exact(count);
        out.rgb.reserve_exact(count);
        for (x, y) in self.mask.set_pixels() {
            let p = camera.unproject(x as f64, y as f64, f64::from(depth.at(x, y)));
            out.push(
                p,
                frame.rgb[((2 * x + 1) * rgb_w / (2 * w), (2 * y + 1) * rgb_h / (2 * h))],
            );
        }
        out
    }
}

/// Everything that the depth maps say.
#[derive(Debug)]
pub(crate) struct Clouds {
    /// The static part, in the frames that it is taken from.
    pub static_points: Vec<Pixels>,
    /// The dynamic part, one per keyframe, in order of time; keyframes without dynamic pixels
    /// included.
    pub dynamic: Vec<Pixels>,
    /// Median z-depth of the sampled pixels, world units.
    pub median_depth: f64,
    /// Mean z-depth of the first frame with depth, world units.
    pub first_depth: f64,
    /// Depth above which 99 of 100 pixels lie, world units.
    pub near_depth: f64,
    /// Depth below which 99 of 100 pixels lie, world units.
    pub far_depth: f64,
    /// Focal length at the size of the depth maps, pixels (mean of both axes and of the frames).
    pub focal_px: f64,
}

/// Back-projects the frames that `config` picks.
pub(crate) fn clouds(
    capture: &Capture,
    config: &InitConfig,
    progress: &dyn Progress,
) -> Result<Clouds, InitError> {
    if capture.frames.is_empty() {
        return Err(InitError::NoFrames);
    }
    if let Some(frame) = capture.frames.iter().find(|f| !camera_is_usable(f)) {
        return Err(InitError::BadCamera {
            frame: frame.name.clone(),
        });
    }
    let with_depth: Vec<usize> = (0..capture.frames.len())
        .filter(|&i| capture.frames[i].depth.is_some())
        .collect();
    if with_depth.is_empty() {
        return Err(InitError::NoDepth {
            frames: capture.frames.len(),
        });
    }
    let picked = with_depth.len().min(config.static_frames);
    let static_rank: Vec<usize> = (0..picked)
        .map(|i| {
            if picked == 1 {
                with_depth.len() / 2
            } else {
                i * (with_depth.len() - 1) / (picked - 1)
            }
        })
        .collect();

    let mut out = Clouds {
        static_points: Vec::new(),
        dynamic: Vec::new(),
        median_depth: 0.0,
        first_depth: 0.0,
        near_depth: 0.0,
        far_depth: 0.0,
        focal_px: 0.0,
    };
    let (mut depths, mut points) = (Vec::new(), 0);
    // A few frames at a time: in parallel, joined in order, without a second copy of everything.
    const BATCH: usize = 8;
    for (b, batch) in with_depth.chunks(BATCH).enumerate() {
        stopped(progress)?;
        let parts: Vec<FramePixels> = batch
            .par_iter()
            .enumerate()
            .map(|(i, &frame)| {
                let static_points = static_rank.binary_search(&(b * BATCH + i)).is_ok();
                classify_pixels(&capture.frames[frame], config, static_points)
            })
            .collect();
        for (i, part) in parts.into_iter().enumerate() {
            if depths.is_empty() && !part.depths.is_empty() {
                let sum: f64 = part.depths.iter().map(|&z| f64::from(z)).sum();
                out.first_depth = sum / part.depths.len() as f64;
            }
            depths.extend_from_slice(&part.depths);
            out.focal_px += part.focal_px / with_depth.len() as f64;
            let frame = batch[i];
            let pixels = |mask| Pixels { frame, mask };
            points += part.static_points.as_ref().map_or(0, CompactMask::count);
            out.static_points.extend(part.static_points.map(pixels));
            out.dynamic.extend(part.dynamic.map(pixels));
        }
        let note = format!("{points} points");
        progress.update(
            "points",
            (b * BATCH + batch.len()).min(with_depth.len()),
            with_depth.len(),
            &note,
        );
    }
    if depths.is_empty() {
        return Err(InitError::EmptyDepth {
            frames: with_depth.len(),
            first_frame: capture.frames[with_depth[0]].name.clone(),
        });
    }
    free_space::clear(capture, &mut out.static_points, config, progress)?;
    let last = depths.len() - 1;
    let mut at = |rank: usize| f64::from(*depths.select_nth_unstable_by(rank, f32::total_cmp).1);
    (out.median_depth, out.near_depth, out.far_depth) =
        (at(last.div_ceil(2)), at(last / 100), at(last * 99 / 100));
    Ok(out)
}

fn camera_is_usable(frame: &CaptureFrame) -> bool {
    let (k, pose) = (&frame.camera.intrinsics, &frame.camera.c2w);
    [k.fx, k.fy, k.cx, k.cy].iter().all(|v| v.is_finite())
        && k.fx > 0.0
        && k.fy > 0.0
        && pose
            .rotation
            .iter()
            .chain(pose.translation.iter())
            .all(|v| v.is_finite())
}

/// What one frame contributes.
struct FramePixels {
    /// Static pixels that are points, where they are asked for.
    static_points: Option<CompactMask>,
    /// Dynamic pixels that are points; `None` without depth.
    dynamic: Option<CompactMask>,
    /// Every 16th usable depth, for the median.
    depths: Vec<f32>,
    focal_px: f64,
}

fn classify_pixels(frame: &CaptureFrame, config: &InitConfig, want_static: bool) -> FramePixels {
    let mut part = FramePixels {
        static_points: None,
        dynamic: None,
        depths: Vec::new(),
        focal_px: 0.0,
    };
    let Some(depth) = &frame.depth else {
        return part;
    };
    let depth = &depth.to_map();
    let (w, h) = depth.size();
    let camera = frame.camera.resized(w, h);
    part.focal_px = 0.5 * (camera.intrinsics.fx + camera.intrinsics.fy);
    let usable: Vec<bool> = (0..w * h)
        .map(|i| is_depth(depth.data()[i]) && !is_depth_edge(depth, i % w, i / w))
        .collect();
    let sampled = (0..w * h).step_by(16).filter(|&i| usable[i]);
    part.depths = sampled.map(|i| depth.data()[i]).collect();
    let moves = moving_pixels(frame, w, h);
    if want_static {
        let near_moving = dilated(&moves, w, h, config.mask_margin_px);
        let still = |i: usize| usable[i] && !near_moving[i];
        part.static_points = Some(CompactMask::from_fn(w, h, |x, y| still(y * w + x)));
    }
    let dynamic = |i: usize| usable[i] && moves[i];
    part.dynamic = Some(CompactMask::from_fn(w, h, |x, y| dynamic(y * w + x)));
    part
}

/// Calls `visit(x, y, world point, colour)` for every `step`-th pixel of every `step`-th row of the
/// depth map that is static and is not near a dynamic one.
pub(crate) fn visit_static_pixels(
    frame: &CaptureFrame,
    config: &InitConfig,
    step: usize,
    visit: &mut dyn FnMut(usize, usize, Vector3<f64>, [u8; 3]),
) {
    let Some(depth) = &frame.depth else { return };
    let depth = &depth.to_map();
    let (w, h) = depth.size();
    let camera = frame.camera.resized(w, h);
    let near_moving = dilated(&moving_pixels(frame, w, h), w, h, config.mask_margin_px);
    let (rgb_w, rgb_h) = frame.rgb.size();
    for y in (0..h).step_by(step) {
        for x in (0..w).step_by(step) {
            let z = depth[(x, y)];
            if !near_moving[y * w + x] && is_depth(z) && !is_depth_edge(depth, x, y) {
                let colour =
                    frame.rgb[((2 * x + 1) * rgb_w / (2 * w), (2 * y + 1) * rgb_h / (2 * h))];
                visit(
                    x,
                    y,
                    camera.unproject(x as f64, y as f64, f64::from(z)),
                    colour,
                );
            }
        }
    }
}

pub(crate) fn is_depth(z: f32) -> bool {
    z.is_finite() && z > 0.0
}

/// True where the depth lies strictly between two opposite neighbours and is far from both: such
/// pixels are blends of two surfaces. A clean step keeps both of its sides.
fn is_depth_edge(depth: &DepthMap, x: usize, y: usize) -> bool {
    let z = depth[(x, y)];
    let between = |a: f32, b: f32| {
        let (low, high) = (a.min(b), a.max(b));
        is_depth(a) && is_depth(b) && z - low > EDGE_JUMP * z && high - z > EDGE_JUMP * z
    };
    let (w, h) = depth.size();
    (x > 0 && x + 1 < w && between(depth[(x - 1, y)], depth[(x + 1, y)]))
        || (y > 0 && y + 1 < h && between(depth[(x, y - 1)], depth[(x, y + 1)]))
}

/// The mask at the size of the depth map; nothing moves where there is none.
pub(crate) fn moving_pixels(frame: &CaptureFrame, w: usize, h: usize) -> Vec<bool> {
    let Some(mask) = &frame.mask else {
        return vec![false; w * h];
    };
    let (mw, mh) = mask.size();
    (0..w * h)
        .map(|i| {
            mask.at(
                (2 * (i % w) + 1) * mw / (2 * w),
                (2 * (i / w) + 1) * mh / (2 * h),
            )
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::is_depth_edge;
    use m4_core::Plane;

    #[test]
    fn a_clean_step_stays_and_a_blended_pixel_goes() {
        let step = Plane::from_vec(4, 1, vec![2.0, 2.0, 5.0, 5.0]).unwrap();
        assert!((0..4).all(|x| !is_depth_edge(&step, x, 0)));
        let blend = Plane::from_vec(5, 1, vec![2.0, 2.0, 3.3, 5.0, 5.0]).unwrap();
        let dropped: Vec<bool> = (0..5).map(|x| is_depth_edge(&blend, x, 0)).collect();
        assert_eq!(dropped, [false, false, true, false, false]);
    }
}
