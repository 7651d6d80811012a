//! The dense half from end to end.

use super::background_model::median_colours;
use super::mono::Mono;
use super::motion::{MotionCues, verdicts};
use super::motion_segmentation::{self, MotionSegmentation};
use super::shot::{Shot, sparse_points};
use super::sources::{DenseConfig, DenseError, Sources};
use super::working::{Ground, WorkingClip, each, mask_at_size, try_each};
use super::{DynamicObject, layers, moving_depth, rigid_objects, static_depth, tracks};
use crate::FrameRate;
use crate::classical::{CameraMotion, SparseReconstruction, check_count};
use crate::flow::{FlowPair, ScaledFrame};
use crate::resample::rgb_and_grey;
use crate::tracks::QueryGrid;
use m4_core::{DepthMap, Mask, Plane, Progress, RgbImage, Tracks};

/// Depth and motion of one frame, all of the size of the frame.
#[derive(Debug, Clone, PartialEq)]
pub struct DenseFrame {
    /// z-depth in the unit of the cameras, finite and above 0 everywhere.
    pub depth: DepthMap,
    /// 255 where the pixel shows something that moves, else 0.
    pub mask: Mask,
    /// How far the depth was measured and not made up, 0..1.
    pub confidence: Plane<f32>,
}

/// Depth and motion of a clip at the size of its frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Dense {
    /// One per frame.
    pub frames: Vec<DenseFrame>,
    /// Dynamic points, tracked through the clip, in the unit of the cameras; `None` where nothing
    /// could be tracked or tracks are disabled.
    pub tracks: Option<Tracks>,
    /// Dynamic objects whose distance was estimated, in order of their first frames.
    pub objects: Vec<DynamicObject>,
}

/// Fewer frames have no background that is seen most of the time.
const LEAST_BACKGROUND: usize = 8;

/// Depth and motion of a clip at the working size, which [`enlarge`](Self::enlarge) brings to the
/// size of the frames.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Estimate {
    size: (usize, usize),
    /// One over z-depth; all planes are `[frames][height][width]`.
    #[serde(with = "m4_core::packed::lists")]
    disparity: Vec<Vec<f32>>,
    /// How far the depth was measured, 0..1.
    #[serde(with = "m4_core::packed::lists")]
    confidence: Vec<Vec<f32>>,
    /// Above 0 in dynamic regions.
    #[serde(with = "m4_core::packed::lists")]
    moving: Vec<Vec<u8>>,
    tracks: Option<Tracks>,
    objects: Vec<DynamicObject>,
}

/// Estimates depth, motion masks and confidence of every frame and tracks of dynamic objects, given
/// cameras and feature tracks, with the methods of `sources`. `rate` is that of `frames`; `masks`
/// has one mask per frame, of any size, above 0 in dynamic regions; motion is not estimated then.
///
/// # Errors
///
/// [`DenseError`] if frames and cameras do not fit, a setting is out of range, a source fails, or
/// the user stopped it.
pub fn estimate(
    frames: &[&RgbImage],
    rate: FrameRate,
    sparse: &SparseReconstruction,
    sources: &Sources<'_>,
    masks: Option<&[Mask]>,
    config: &DenseConfig,
    progress: &dyn Progress,
) -> Result<Estimate, DenseError> {
    let ground = Ground::of(frames, sparse, sources, masks, config, progress)?;
    let (count, (w, h)) = (frames.len(), ground.size);
    let parallax = sparse.camera_motion == CameraMotion::Parallax;
    let mono = match sources.mono {
        Some(mono) => Mono {
            kind: mono.kind,
            frames: each(count, "reading depth", progress, |i| {
                mono.at_size(i, (w, h))
            })?,
        },
        None => Mono::default(),
    };
    let working = each(count, "shrinking frames", progress, |i| {
        ScaledFrame::new(frames[i], (w, h))
    })?;
    let flows = try_each(count - 1, "computing flow", progress, |i| {
        let both = (sources.flow)(i, &working[i], &working[i + 1]);
        let (forward, backward) = both.map_err(|source| DenseError::Flow { frame: i, source })?;
        Ok(FlowPair { forward, backward })
    })?;
    let points = sparse_points(sparse, w, h);
    let shots = each(count, "preparing frames", progress, |i| {
        Shot::new(working[i].clone(), &ground.cameras, i, &points, parallax)
    })?;
    let swept = each(count, "sweeping depth", progress, |i| {
        static_depth::sweep(&shots, i)
    })?;
    let still = sparse.camera_motion == CameraMotion::Static && count >= LEAST_BACKGROUND;
    let clues = MotionCues {
        rate,
        cameras: ground.cameras,
        verdicts: verdicts(sparse, w, h),
        background: still.then(|| median_colours(&working)),
    };
    drop(working);
    let clip = motion_segmentation::Segmentation {
        width: w,
        height: h,
        parallax,
        frames,
        shots: &shots,
        flows: &flows,
        mono: &mono,
        clues: &clues,
        sources,
        progress,
    };
    let input_masks =
        masks.map(|masks| masks.iter().map(|mask| mask_at_size(mask, w, h)).collect());
    let MotionSegmentation {
        dynamic,
        measured,
        filled,
        refined,
    } = clip.segment_motion(swept, input_masks)?;
    let scene = WorkingClip {
        width: w,
        height: h,
        rate,
        cameras: &clues.cameras,
        dynamic: &dynamic,
        disparity: &filled,
        flows: &flows,
    };
    let mut disparity = if parallax || !mono.is_empty() {
        moving_depth::place(&scene)
    } else {
        layers::place(&scene, &shots)
    };
    let mut objects = match parallax && ground.one_lens {
        true => rigid_objects::place(&scene, |i| clip.smoother(i), &mut disparity, progress)?,
        false => Vec::new(),
    };
    for ((disparity, refined), dynamic) in disparity.iter_mut().zip(refined).zip(&dynamic) {
        for ((d, refined), _) in disparity
            .iter_mut()
            .zip(refined)
            .zip(dynamic)
            .filter(|(_, moves)| **moves == 0)
        {
            *d = refined;
        }
    }
    for i in 0..count {
        if parallax {
            mono.place_dynamic(i, &measured[i], &filled[i], &dynamic[i], &mut disparity[i]);
        }
        mono.overrule(i, &mut disparity[i]);
    }
    if !mono.is_empty() {
        objects.clear(); // their depth is that of the prior
    }
    let scene = WorkingClip {
        disparity: &disparity,
        ..scene
    };
    let tracks = match config.tracks {
        true => tracks::tracks(&scene, &QueryGrid::chains(), progress)?,
        false => None,
    };
    let confidence = measured
        .into_iter()
        .map(|measured| measured.confidence)
        .collect();
    Ok(Estimate {
        size: (w, h),
        disparity,
        confidence,
        moving: dynamic,
        tracks,
        objects,
    })
}

impl Estimate {
    /// Returns depth, masks and confidence at the size of `frames`, those that the estimate was
    /// made of.
    ///
    /// # Errors
    ///
    /// [`DenseError`] for another number of frames, or if the user stopped it.
    pub fn enlarge(
        self,
        frames: &[&RgbImage],
        progress: &dyn Progress,
    ) -> Result<Dense, DenseError> {
        check_count("estimated depth maps", self.disparity.len(), frames.len())
            .map_err(DenseError::Input)?;
        let (width, height) = self.size;
        let frames = each(frames.len(), "enlarging depth", progress, |i| {
            let small = Small {
                size: self.size,
                rgb: &rgb_and_grey(frames[i], width, height).0,
                disparity: &self.disparity[i],
                dynamic: &self.moving[i],
                confidence: &self.confidence[i],
            };
            enlarge(frames[i], &small)
        })?;
        Ok(Dense {
            frames,
            tracks: self.tracks,
            objects: self.objects,
        })
    }
}

/// Colour difference at which a neighbour counts half, 0..255.
const COLOUR: f32 = 8.0;
/// Disparities that differ by less than this share are of one surface and may be averaged.
const SAME_SURFACE: f32 = 0.03;

/// What the working size knows of one frame; planes are `[height][width]`.
struct Small<'a> {
    /// Columns and rows.
    size: (usize, usize),
    /// Colours, 0..255.
    rgb: &'a [[u8; 3]],
    disparity: &'a [f32],
    dynamic: &'a [u8],
    confidence: &'a [f32],
}

/// Every pixel takes mask and depth from those of the nine nearest small pixels that resemble it in
/// colour. Depth is averaged over one surface only, so that nothing floats between two.
fn enlarge(image: &RgbImage, small: &Small<'_>) -> DenseFrame {
    let (width, height) = image.size();
    let (sx, sy) = (
        small.size.0 as f32 / width as f32,
        small.size.1 as f32 / height as f32,
    );
    let mut depth = Plane::filled(width, height, 1.0f32);
    let mut mask = Plane::filled(width, height, 0u8);
    let mut confidence = Plane::filled(width, height, 0.0f32);
    for y in 0..height {
        for x in 0..width {
            let at = ((x as f32 + 0.5) * sx - 0.5, (y as f32 + 0.5) * sy - 0.5);
            let near = neighbours(small, at, image[(x, y)]);
            let (mut moves, mut total) = (0.0, 0.0);
            for (i, w) in near {
                total += w;
                moves += if small.dynamic[i] > 0 { w } else { 0.0 };
            }
            let dynamic = moves > 0.5 * total;
            let fits = |i: usize| (small.dynamic[i] > 0) == dynamic;
            let (mut best, mut most) = (near[4].0, 0.0f32);
            for (i, w) in near {
                if fits(i) && w > most {
                    (best, most) = (i, w);
                }
            }
            let surface = small.disparity[best];
            let (mut sum, mut sure, mut weight) = (0.0, 0.0, 0.0);
            for (i, w) in near {
                if fits(i) && (small.disparity[i] - surface).abs() <= SAME_SURFACE * surface {
                    sum += w * small.disparity[i];
                    sure += w * small.confidence[i];
                    weight += w;
                }
            }
            depth[(x, y)] = if weight > 0.0 {
                weight / sum
            } else {
                1.0 / surface
            };
            mask[(x, y)] = if dynamic { 255 } else { 0 };
            confidence[(x, y)] = if dynamic || weight == 0.0 {
                0.0
            } else {
                (sure / weight).min(1.0)
            };
        }
    }
    DenseFrame {
        depth,
        mask,
        confidence,
    }
}

/// The 3x3 pixels around a position and their weights, 0 outside the image.
fn neighbours(small: &Small<'_>, (x, y): (f32, f32), colour: [u8; 3]) -> [(usize, f32); 9] {
    let (w, h) = (small.size.0 as isize, small.size.1 as isize);
    let clamp = |v: f32, n: isize| (v.round() as isize).clamp(0, n - 1);
    let (cx, cy) = (clamp(x, w), clamp(y, h));
    std::array::from_fn(|k| {
        let (nx, ny) = (cx + k as isize % 3 - 1, cy + k as isize / 3 - 1);
        let i = (ny.clamp(0, h - 1) * w + nx.clamp(0, w - 1)) as usize;
        if nx < 0 || ny < 0 || nx >= w || ny >= h {
            return (i, 0.0);
        }
        // A tent two pixels wide, never 0, times the likeness of the colours.
        let (dx, dy) = (x - nx as f32, y - ny as f32);
        let space = (1.6 - dx.abs()).max(0.05) * (1.6 - dy.abs()).max(0.05);
        let differences = small.rgb[i]
            .iter()
            .zip(&colour)
            .map(|(a, b)| a.abs_diff(*b));
        let difference = f32::from(differences.fold(0, u8::max));
        (i, space / (1.0 + (difference / COLOUR).powi(2)))
    })
}

#[cfg(test)]
mod tests {
    use super::{Small, enlarge};
    use crate::resample::rgb_and_grey;
    use m4_core::Plane;

    #[test]
    fn an_edge_is_found_again_and_nothing_floats() {
        // The edge lies at full-size column 22, inside small pixel 5 of 16 (columns 20 to 23).
        let image = Plane::from_fn(64, 48, |x, _| if x < 22 { [30; 3] } else { [200; 3] });
        let (rgb, _) = rgb_and_grey(&image, 16, 12);
        let disparity: Vec<f32> = (0..16 * 12)
            .map(|i| if i % 16 < 5 { 0.25 } else { 1.0 })
            .collect();
        let dynamic: Vec<u8> = (0..16 * 12)
            .map(|i| if i % 16 < 5 { 0 } else { 255 })
            .collect();
        let confidence = vec![1.0; 16 * 12];
        let small = Small {
            size: (16, 12),
            rgb: &rgb,
            disparity: &disparity,
            dynamic: &dynamic,
            confidence: &confidence,
        };
        let out = enlarge(&image, &small);
        for x in 0..64 {
            let (z, m) = (out.depth[(x, 20)], out.mask[(x, 20)]);
            assert!(
                (z - 4.0).abs() < 1e-3 || (z - 1.0).abs() < 1e-3,
                "column {x}: {z}"
            );
            let near = x >= 22;
            assert_eq!((z < 2.0, m > 0), (near, near), "column {x}");
        }
    }
}
