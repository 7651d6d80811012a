//! The shape and the motion of a part, up to one factor, and how much of its relief is believed.

use super::edges::Blocks;
use super::silhouette::radius_px;
use super::{Tracklet, WorkingClip};
use m4_core::{Camera, Se3, quantile};
use nalgebra::Vector3;

/// Mean relief of things, in radii of their outlines (logarithm of depth over radius by distance):
/// measured 0.2 to 0.4 on rendered ones.
pub(super) const USUAL_RELIEF: f32 = 0.3;
/// Largest share of the relief that is kept: adjustment of small regions over few frames
/// exaggerates it, and the slope of the whole.
const MOST_SHARE: f32 = 0.5;
/// Reliefs count up to this logarithm of depth.
const MOST_RELIEF: f32 = 0.3;

/// What adjustment made of a part, up to one factor.
pub(super) struct Shape {
    pub blocks: Blocks,
    /// World to camera by frame of the tracklet, the world being fixed to the body.
    pub poses: Vec<Se3<f64>>,
    /// `[blocks]` by frame; 0 where nothing is known.
    pub disparity: Vec<Vec<f32>>,
    /// The part taken for one rigid body, where this is the shape of a piece of it.
    pub whole: Option<Whole>,
}

/// A part taken for one rigid body.
pub(super) struct Whole {
    pub shape: Box<Shape>,
    /// Disparities of the piece over those of the whole.
    pub ratio: f32,
}

impl Shape {
    /// The mean of all points, and their root mean square distance from it, in the frame of the
    /// body; the same weight for every frame.
    pub fn extent(&self, clip: &WorkingClip<'_>) -> Option<(Vector3<f64>, f64)> {
        let camera = clip.cameras.first()?;
        let (mut sum, mut squares, mut count) = (Vector3::zeros(), 0.0, 0.0);
        for (k, pose) in self.poses.iter().enumerate() {
            let to_body = pose.inverse();
            let (mut here, mut squares_here, mut n) = (Vector3::zeros(), 0.0, 0.0);
            for (p, d) in self.values(clip, k) {
                let (x, y) = (p as usize % clip.width, p as usize / clip.width);
                let point = to_body.transform(&(ray(camera, x, y) / f64::from(d)));
                here += point;
                squares_here += point.norm_squared();
                n += 1.0;
            }
            if n > 0.0 {
                sum += here / n;
                squares += squares_here / n;
                count += 1.0;
            }
        }
        let mean = sum / count;
        let variance = squares / count - mean.norm_squared();
        (count > 0.0 && variance > 0.0).then(|| (mean, variance.sqrt()))
    }

    /// The pixels of a frame with a value, and the value.
    pub fn values<'a>(
        &'a self,
        clip: &'a WorkingClip<'_>,
        k: usize,
    ) -> impl Iterator<Item = (u32, f32)> + 'a {
        self.disparity[k]
            .iter()
            .enumerate()
            .filter(|(_, d)| **d > 0.0)
            .map(move |(g, d)| {
                let (x, y) = self.blocks.pixel(g);
                ((y * clip.width + x) as u32, *d)
            })
    }
}

/// The direction of a pixel in the camera, of z 1.
pub(super) fn ray(camera: &Camera, x: usize, y: usize) -> Vector3<f64> {
    let k = &camera.intrinsics;
    Vector3::new(
        (x as f64 + 0.5 - k.cx) / k.fx,
        (y as f64 + 0.5 - k.cy) / k.fy,
        1.0,
    )
}

/// Draws disparities, `[frames][blocks]` with 0 where unknown, of a part towards the median of
/// each frame: by its variance, relief that is larger than usual for the size of the part is mostly
/// noise.
pub(super) fn shrink_relief(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    disparity: &mut [Vec<f32>],
) {
    let Some(camera) = clip.cameras.get(tracklet.first) else {
        return;
    };
    let medians: Vec<Option<f32>> = disparity
        .iter()
        .map(|d| {
            quantile(
                &mut d.iter().copied().filter(|d| *d > 0.0).collect::<Vec<_>>(),
                0.5,
            )
        })
        .collect();
    let (mut relief, mut usual, mut count) = (0.0f32, 0.0f32, 0.0f32);
    for ((disparity, median), part) in disparity.iter().zip(&medians).zip(&tracklet.parts) {
        let Some(median) = median else { continue };
        let radius = (radius_px(part.len()) / camera.intrinsics.fx) as f32;
        for d in disparity.iter().filter(|d| **d > 0.0) {
            relief += (d / median).ln().abs().min(MOST_RELIEF);
            usual += USUAL_RELIEF * radius;
            count += 1.0;
        }
    }
    if count == 0.0 || relief <= 0.0 {
        return;
    }
    let share = (usual / relief).powi(2).min(MOST_SHARE);
    for (disparity, median) in disparity.iter_mut().zip(medians) {
        let Some(median) = median else { continue };
        for d in disparity.iter_mut().filter(|d| **d > 0.0) {
            *d = median + share * (*d - median);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Tracklet, shrink_relief};
    use crate::classical::dense::working::ClipData;
    use m4_core::{Camera, Intrinsics, Se3};

    #[test]
    fn relief_that_is_too_large_for_the_outline_is_drawn_to_the_median() {
        let data = ClipData {
            size: (100, 100),
            cameras: vec![Camera {
                intrinsics: Intrinsics::centred(100, 100, 100.0),
                c2w: Se3::identity(),
            }],
            dynamic: Vec::new(),
            disparity: Vec::new(),
            flows: Vec::new(),
        };
        // A disc of radius 10 px: a relief of 0.03 is usual.
        let tracklet = Tracklet {
            first: 0,
            parts: vec![(0..314).collect()],
        };
        let kept = |relief: f32| {
            let mut disparity = vec![vec![1.0 - relief, 1.0, 0.0, 1.0, 1.0 + relief]];
            shrink_relief(&data.clip(), &tracklet, &mut disparity);
            assert_eq!([disparity[0][1], disparity[0][2]], [1.0, 0.0]);
            (disparity[0][4] - 1.0) / relief
        };
        assert!((kept(0.02) - 0.5).abs() < 0.01);
        assert!((kept(0.2) - 0.09).abs() < 0.02, "{}", kept(0.2));
    }
}
