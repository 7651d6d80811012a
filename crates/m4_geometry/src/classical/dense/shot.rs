//! One frame with everything that the geometry of its neighbours needs, and where its pixels appear
//! in another.

use super::sweep::{Range, census};
use super::working::observed;
use crate::classical::{Motion, SparseReconstruction};
use crate::flow::ScaledFrame;
use m4_core::{
    Camera,
    nalgebra::{Matrix3, Vector3},
    quantile,
};

/// Disparities tried between the farthest and the nearest surface.
const HYPOTHESES: usize = 64;
/// Parallax of a point at median depth between a frame and its partners on each side, pixels at the
/// working size: one partner per target and side. At the widest a step between hypotheses is about
/// a pixel, which tells the two sides of an edge apart; the narrowest sees what thin objects hide
/// from the others.
const PARALLAX_PX: [f64; 3] = [6.0, 12.0, 24.0];
/// How much wider the parallax of another frame may be than the widest that is asked for, as the
/// camera jumps.
const WIDER: f64 = 1.5;
/// Least parallax of a partner, pixels at the working size.
const LEAST_PARALLAX_PX: f64 = 1.5;

/// A sparse point in a frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct SparsePoint {
    /// Pixel index at the working size.
    pub pixel: usize,
    pub disparity: f32,
}

/// One frame, ready for the plane sweep.
pub(super) struct Shot {
    pub frame: ScaledFrame,
    pub census: Vec<u32>,
    pub points: Vec<SparsePoint>,
    /// Frames to compare with, and the way there.
    pub partners: Vec<(usize, Pair)>,
    pub range: Range,
    /// Median disparity of the sparse points.
    pub median: f32,
}

/// Sparse points per frame, at the working size.
pub(super) fn sparse_points(
    sparse: &SparseReconstruction,
    width: usize,
    height: usize,
) -> Vec<Vec<SparsePoint>> {
    let mut out = vec![Vec::new(); sparse.cameras.len()];
    for (frame, pixel, track) in
        observed(sparse, width, height).filter(|(.., t)| t.motion != Motion::Dynamic)
    {
        let z = track
            .point
            .map_or(0.0, |point| sparse.cameras[frame].project(&point).1);
        if z > 0.0 && z.is_finite() {
            out[frame].push(SparsePoint {
                pixel,
                disparity: (1.0 / z) as f32,
            });
        }
    }
    out
}

/// Disparities worth trying: those of the points in the frame and around it in time, with room for
/// nearer and farther surfaces that no point lies on.
fn range(points: &[Vec<SparsePoint>], i: usize) -> (Range, f32) {
    const WINDOW: usize = 8;
    const ENOUGH: usize = 50;
    let collect = |from: usize, to: usize| -> Vec<f32> {
        points[from..to]
            .iter()
            .flatten()
            .map(|p| p.disparity)
            .collect()
    };
    let mut values = collect(i.saturating_sub(WINDOW), (i + WINDOW + 1).min(points.len()));
    if values.len() < ENOUGH {
        values = collect(0, points.len());
    }
    let median = quantile(&mut values, 0.5).unwrap_or(1.0);
    let far = quantile(&mut values, 0.01).unwrap_or(0.5);
    let near = quantile(&mut values, 0.99).unwrap_or(2.0);
    let (least, most) = (0.6 * far, 1.4 * near.max(1.2 * median));
    let range = Range {
        least,
        step: (most - least) / (HYPOTHESES - 1) as f32,
        count: HYPOTHESES,
    };
    (range, median)
}

/// On each side in time, the frame whose parallax comes nearest to each target; where the clip
/// ends, the other side serves twice as many.
fn partners(cameras: &[Camera], i: usize, median: f32) -> Vec<(usize, Pair)> {
    let parallax = |j: usize| parallax_px(&cameras[i], &cameras[j], f64::from(median));
    let widest = WIDER * PARALLAX_PX.into_iter().fold(0.0, f64::max);
    // in time, away from the frame; where the camera pauses, until it moves
    let side = |later: bool| -> Vec<(usize, f64)> {
        let mut beyond = false;
        (1..cameras.len())
            .map_while(|k| {
                if later {
                    (i + k < cameras.len()).then_some(i + k)
                } else {
                    i.checked_sub(k)
                }
            })
            .map(|j| (j, parallax(j)))
            .take_while(|&(_, p)| !std::mem::replace(&mut beyond, p > widest))
            .filter(|&(_, p)| p >= LEAST_PARALLAX_PX)
            .collect()
    };
    let (before, after) = (side(false), side(true));
    let mut chosen: Vec<usize> = Vec::new();
    for target in PARALLAX_PX {
        for side in [&before, &after] {
            // On a side that is too short for this target, another parallax on the other side
            // serves.
            let reaches = side.iter().any(|&(_, p)| p >= 0.7 * target);
            let (side, target) = match (reaches, side == &before) {
                (true, _) => (side, target),
                (false, true) => (&after, 1.4 * target),
                (false, false) => (&before, 1.4 * target),
            };
            let free = side.iter().filter(|(j, _)| !chosen.contains(j));
            let miss = |p: f64| (p / target).ln().abs();
            if let Some(&(j, _)) = free.min_by(|a, b| miss(a.1).total_cmp(&miss(b.1))) {
                chosen.push(j);
            }
        }
    }
    chosen.sort_unstable();
    chosen
        .into_iter()
        .map(|j| (j, Pair::new(&cameras[i], &cameras[j])))
        .collect()
}

/// Of each target parallax the nearest of `frames` in time, on each side of frame `i`, that reaches
/// it; none where the clip ends before. Parallax is that of a point at median depth, pixels at the
/// working size. Where these are fewer than `least`, frames of the widest parallax that is left
/// make up for it: a path that is short for its depth has many of them. `frames` are in order of
/// time.
pub(super) fn at_parallax(
    cameras: &[Camera],
    frames: &[usize],
    i: usize,
    median: f32,
    targets: &[f64],
    least: usize,
) -> Vec<usize> {
    /// Share of the widest parallax below which a frame adds nothing.
    const NARROW: f64 = 0.5;
    let parallax: Vec<f64> = cameras
        .iter()
        .map(|camera| parallax_px(&cameras[i], camera, f64::from(median)))
        .collect();
    let mut out = Vec::new();
    for &target in targets {
        let reaches = |j: &&usize| parallax[**j] >= target;
        let (before, after) = frames.split_at(frames.partition_point(|&j| j < i));
        let sides = [
            before.iter().rev().find(reaches),
            after.iter().find(reaches),
        ];
        for &j in sides.into_iter().flatten() {
            if parallax[j] < WIDER * target && !out.contains(&j) {
                out.push(j);
            }
        }
    }
    if out.len() < least {
        let most = WIDER * targets.iter().copied().fold(0.0, f64::max);
        let mut rest: Vec<usize> = frames
            .iter()
            .copied()
            .filter(|&j| j != i && parallax[j] < most)
            .collect();
        rest.sort_by(|&a, &b| parallax[b].total_cmp(&parallax[a]));
        let enough = NARROW * rest.first().map_or(0.0, |&j| parallax[j]);
        let chosen = out.len();
        let more = rest
            .into_iter()
            .filter(|j| parallax[*j] > enough && !out[..chosen].contains(j));
        let more: Vec<usize> = more.take(least - chosen).collect();
        out.extend(more);
    }
    out
}

impl Shot {
    pub fn new(
        frame: ScaledFrame,
        cameras: &[Camera],
        i: usize,
        points: &[Vec<SparsePoint>],
        parallax: bool,
    ) -> Self {
        let (range, median) = range(points, i);
        Self {
            census: census(frame.width, frame.height, &frame.grey),
            points: points[i].clone(),
            partners: if parallax {
                partners(cameras, i, median)
            } else {
                Vec::new()
            },
            range,
            median,
            frame,
        }
    }

    /// A clip of a textured wall at `disparity`, an integer number of pixels of parallax at 1, by
    /// cameras that go to the right by one unit a frame.
    #[cfg(test)]
    pub fn of_wall(
        count: usize,
        (w, h): (usize, usize),
        disparity: f32,
    ) -> (Vec<Self>, Vec<Camera>) {
        use m4_core::{Intrinsics, Se3};
        let grey = |x: f32, y: f32| {
            128.0 + 50.0 * (0.9 * x + 0.3 * y).sin() + 40.0 * (0.37 * x - 0.8 * y).cos()
        };
        let camera = |i: usize| Camera {
            intrinsics: Intrinsics::centred(w, h, 1.0),
            c2w: Se3 {
                translation: Vector3::new(i as f64, 0.0, 0.0),
                ..Se3::identity()
            },
        };
        let cameras: Vec<Camera> = (0..count).map(camera).collect();
        let shot = |i: usize| {
            let grey: Vec<f32> = (0..w * h)
                .map(|p| grey((p % w) as f32 + i as f32 * disparity, (p / w) as f32))
                .collect();
            let frame = ScaledFrame {
                width: w,
                height: h,
                rgb: vec![[0; 3]; w * h],
                grey,
            };
            let range = Range {
                least: 0.5 * disparity,
                step: disparity / 20.0,
                count: 31,
            };
            Self {
                frame,
                census: Vec::new(),
                points: Vec::new(),
                partners: Vec::new(),
                range,
                median: disparity,
            }
        };
        ((0..count).map(shot).collect(), cameras)
    }

    /// A frame of which the colours alone are asked for.
    #[cfg(test)]
    pub fn of_colours(image: &m4_core::RgbImage) -> Self {
        let range = Range {
            least: 1.0,
            step: 1.0,
            count: 1,
        };
        let frame = ScaledFrame::new(image, image.size());
        Self {
            frame,
            census: Vec::new(),
            points: Vec::new(),
            partners: Vec::new(),
            range,
            median: 1.0,
        }
    }
}

/// `q ~ a (x, y, 1) + disparity b`, pixel coordinates with the centre of the first pixel at 0, 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub a: [[f32; 3]; 3],
    pub b: [f32; 3],
}

/// A pixel with a disparity, seen from the other camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reprojected {
    pub x: f32,
    pub y: f32,
    /// Of the same point in the other camera; not above 0 when it lies behind that camera.
    pub disparity: f32,
}

fn intrinsics(camera: &Camera) -> Matrix3<f64> {
    let k = &camera.intrinsics;
    Matrix3::new(k.fx, 0.0, k.cx - 0.5, 0.0, k.fy, k.cy - 0.5, 0.0, 0.0, 1.0)
}

fn inverse_intrinsics(camera: &Camera) -> Matrix3<f64> {
    let k = &camera.intrinsics;
    let (x, y) = ((k.cx - 0.5) / k.fx, (k.cy - 0.5) / k.fy);
    Matrix3::new(1.0 / k.fx, 0.0, -x, 0.0, 1.0 / k.fy, -y, 0.0, 0.0, 1.0)
}

impl Pair {
    pub fn new(from: &Camera, to: &Camera) -> Self {
        let motion = to.w2c().compose(&from.c2w);
        let a = intrinsics(to) * motion.rotation * inverse_intrinsics(from);
        let b: Vector3<f64> = intrinsics(to) * motion.translation;
        Self {
            a: std::array::from_fn(|r| std::array::from_fn(|c| a[(r, c)] as f32)),
            b: std::array::from_fn(|r| b[r] as f32),
        }
    }

    /// The part that does not depend on disparity.
    pub fn ray(&self, x: f32, y: f32) -> [f32; 3] {
        self.a.map(|row| row[0] * x + row[1] * y + row[2])
    }

    pub fn project(&self, x: f32, y: f32, disparity: f32) -> Reprojected {
        self.project_with_slope(x, y, disparity).0
    }

    /// The same, and the derivative of the place by the disparity.
    pub fn project_with_slope(&self, x: f32, y: f32, disparity: f32) -> (Reprojected, [f32; 2]) {
        let r = self.ray(x, y);
        let z = 1.0 / (r[2] + disparity * self.b[2]);
        let (x, y) = (
            (r[0] + disparity * self.b[0]) * z,
            (r[1] + disparity * self.b[1]) * z,
        );
        let slope = [
            (self.b[0] - x * self.b[2]) * z,
            (self.b[1] - y * self.b[2]) * z,
        ];
        (
            Reprojected {
                x,
                y,
                disparity: disparity * z,
            },
            slope,
        )
    }
}

/// Displacement of a point at disparity `disparity` in the middle of the image because of the
/// translation between two cameras alone, pixels.
pub(super) fn parallax_px(from: &Camera, to: &Camera, disparity: f64) -> f64 {
    let pair = Pair::new(from, to);
    let k = &from.intrinsics;
    let (x, y) = ((k.width as f32 - 1.0) / 2.0, (k.height as f32 - 1.0) / 2.0);
    let (far, near) = (
        pair.project(x, y, 0.0),
        pair.project(x, y, disparity as f32),
    );
    if far.disparity.is_finite() && near.disparity > 0.0 {
        f64::from((near.x - far.x).hypot(near.y - far.y))
    } else {
        0.0
    }
}

/// Frames that are `px` pixels of parallax apart, of a point at median depth, at the working size;
/// the first and the last are among them.
pub(super) fn keyframes(cameras: &[Camera], shots: &[Shot], px: f64) -> Vec<usize> {
    let mut out = vec![0];
    for i in 1..cameras.len() {
        let last = out[out.len() - 1];
        if i + 1 == cameras.len()
            || parallax_px(&cameras[last], &cameras[i], f64::from(shots[last].median)) >= px
        {
            out.push(i);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{Pair, Shot, at_parallax, keyframes, parallax_px, partners};
    use m4_core::{Camera, Intrinsics, Se3, nalgebra::Vector6};

    #[test]
    fn projects_as_the_cameras_do() {
        let camera = |twist: Vector6<f64>| Camera {
            intrinsics: Intrinsics {
                cx: 30.0,
                ..Intrinsics::centred(64, 48, 50.0)
            },
            c2w: Se3::identity().retract(&twist),
        };
        let a = camera(Vector6::new(0.1, 0.0, -0.2, 0.05, 0.1, 0.0));
        let b = camera(Vector6::new(-0.2, 0.3, 0.1, -0.1, 0.02, 0.2));
        let (x, y, z) = (20.0, 31.0, 2.5);
        let ([u, v], depth) = b.project(&a.unproject(x, y, z));
        let target = Pair::new(&a, &b).project(x as f32, y as f32, (1.0 / z) as f32);
        assert!(
            (f64::from(target.x) - u).abs() < 1e-3 && (f64::from(target.y) - v).abs() < 1e-3,
            "{target:?} {u} {v}"
        );
        assert!((1.0 / f64::from(target.disparity) - depth).abs() < 1e-4);
    }

    #[test]
    fn partners_are_chosen_by_parallax_at_every_frame_rate() {
        let chosen = |count: usize, px: f32, i: usize| -> Vec<usize> {
            let (_, cameras) = Shot::of_wall(count, (64, 48), px);
            partners(&cameras, i, px)
                .into_iter()
                .map(|(j, _)| j)
                .collect()
        };
        assert_eq!(chosen(61, 2.0, 30), [18, 24, 27, 33, 36, 42]);
        assert_eq!(chosen(241, 0.5, 120), [72, 96, 108, 132, 144, 168]);
        // a side that is too short: another parallax of the other side serves
        assert_eq!(chosen(61, 2.0, 0), [3, 4, 6, 8, 12, 17]);
        // a pause
        let (_, mut cameras) = Shot::of_wall(61, (64, 48), 2.0);
        let still = cameras[0];
        cameras.splice(0..0, vec![still; 60]);
        let later: Vec<usize> = partners(&cameras, 10, 2.0)
            .into_iter()
            .map(|(j, _)| j)
            .collect();
        assert_eq!(later, [63, 64, 66, 68, 72, 77]);
    }

    #[test]
    fn short_paths_have_as_many_frames_as_wide_ones() {
        // 2 px of parallax from one frame to the next
        let (_, cameras) = Shot::of_wall(9, (64, 48), 2.0);
        let all: Vec<usize> = (0..9).collect();
        let chosen = |i: usize, targets: &[f64], least: usize| {
            at_parallax(&cameras, &all, i, 2.0, targets, least)
        };
        assert_eq!(chosen(4, &[4.0, 8.0], 4), [2, 6, 0, 8]);
        assert_eq!(chosen(0, &[12.0, 24.0], 0), [6]);
        // the widest first, none below half of the widest, none beyond what was asked for
        assert_eq!(chosen(0, &[12.0, 24.0], 4), [6, 8, 7, 5]);
        assert_eq!(chosen(0, &[12.0, 24.0], 9), [6, 8, 7, 5]);
        assert_eq!(chosen(0, &[6.0], 3), [3, 4]);
        // of the frames that are asked for, whether or not the frame itself is one of them
        assert_eq!(
            at_parallax(&cameras, &[0, 3, 6, 8], 4, 2.0, &[4.0, 8.0], 4),
            [6, 0, 8]
        );
    }

    #[test]
    fn keyframes_are_as_far_apart_at_every_frame_rate_and_none_is_in_a_pause() {
        let keys = |count: usize, px: f32| {
            let (shots, cameras) = Shot::of_wall(count, (64, 48), px);
            keyframes(&cameras, &shots, 3.0)
        };
        assert_eq!(keys(10, 1.0), [0, 3, 6, 9]);
        assert_eq!(keys(20, 0.5), [0, 6, 12, 18, 19]);
        assert_eq!(keys(4, 8.0), [0, 1, 2, 3]);
        let (shots, mut cameras) = Shot::of_wall(10, (64, 48), 1.0);
        let still = cameras[6];
        cameras[6..].fill(still);
        assert_eq!(keyframes(&cameras, &shots, 3.0), [0, 3, 6, 9]);
    }

    #[test]
    fn parallax_is_focal_times_baseline_times_disparity() {
        let still = Camera {
            intrinsics: Intrinsics::centred(64, 48, 50.0),
            c2w: Se3::identity(),
        };
        let aside = Camera {
            c2w: still
                .c2w
                .retract(&Vector6::new(0.3, 0.0, 0.0, 0.0, 0.0, 0.0)),
            ..still
        };
        assert!((parallax_px(&still, &aside, 0.5) - 50.0 * 0.3 * 0.5).abs() < 1e-3);
        assert_eq!(parallax_px(&still, &still, 0.5), 0.0);
    }
}
