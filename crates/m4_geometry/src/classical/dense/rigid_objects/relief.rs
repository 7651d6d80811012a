//! The relief of a rigid piece: held to a plane by its variance where motion shows it weakly, and
//! carried on to what is not rigid.

use super::BLOCK_PX;
use super::edges::Part;
use super::residual::{offset_px, ray_at};
use super::shape::{USUAL_RELIEF, ray};
use super::silhouette::radius_px;
use crate::classical::dense::working::pixel_at;
use crate::dba::{Factor, Geometry, WEIGHT_SCALE};
use m4_core::quantile;
use nalgebra::Vector3;

/// How many times the prior of relief counts: noise of the flow is alike in neighbouring blocks and
/// over the spans of an edge. On eight of nine scenes 1 and 4 are as good.
const ALIKE: f64 = 2.0;
/// Median length of a two-dimensional residual of standard deviation 1.
const MEDIAN_LENGTH: f64 = 1.18;
/// Blocks of which an edge has less are not counted.
const LEAST_WEIGHT: f32 = 0.1;
/// Time over which what is no piece is averaged, on each side, seconds.
const AROUND_S: f64 = 1.0 / 6.0;
/// How often disparities are averaged along the edges, and the largest change (logarithm).
const AGREEMENTS: usize = 4;
const MOST_CHANGE: f32 = 0.3;
/// Neighbours count by one over their distance to this power: what hangs on a piece is as far as
/// the nearest of it, and what is far from it is as far as its mean.
const FADING: f32 = 3.0;
/// Least disparity of an upright plane at unit distance, times that distance: in the middle of an
/// image, the cosine of how far the camera looks down. Such a plane is too oblique to say anything.
const LEAST_LEVEL: f64 = 0.25;
/// Most blocks of a piece that others are filled from; of more, every nth is taken.
const MOST_BLOCKS: usize = 500;

/// Weight of a prior that holds each disparity (in the part's own unit) to that of a plane: noise
/// of the flow, from the residuals, over the usual relief of a thing of this size.
pub(super) fn prior(
    part: &Part<'_>,
    geometry: &Geometry<f32>,
    edges: &[&Factor<f32>],
) -> Option<f64> {
    let parts = &part.tracklet.parts;
    let radius: f64 = parts.iter().map(|p| radius_px(p.len())).sum::<f64>() / parts.len() as f64;
    let camera = part.clip.cameras.get(part.tracklet.first)?;
    let usual = f64::from(USUAL_RELIEF) * radius / camera.intrinsics.fx;
    Some(ALIKE * WEIGHT_SCALE * (noise_px(geometry, edges)? / usual).powi(2))
}

/// Standard deviation of the residuals, pixels of the grid: the median over edges.
fn noise_px(geometry: &Geometry<f32>, edges: &[&Factor<f32>]) -> Option<f64> {
    let of_edge = |edge: &&Factor<f32>| {
        let relative = geometry.relative(edge.source, edge.target);
        let mut off: Vec<f64> = (0..geometry.grid.len())
            .filter(|&g| edge.weight[0][g] >= LEAST_WEIGHT && geometry.sensor[edge.source][g] > 0.0)
            .map(|g| {
                let [x, y] = offset_px(geometry, edge, &relative, g);
                x.hypot(y)
            })
            .collect();
        quantile(&mut off, 0.5)
    };
    let mut all: Vec<f64> = edges.iter().filter_map(of_edge).collect();
    Some(quantile(&mut all, 0.5)? / MEDIAN_LENGTH)
}

/// Sets the prior of each frame to a plane at its median disparity.
pub(super) fn flatten(geometry: &mut Geometry<f32>) {
    for (sensor, disparity) in geometry.sensor.iter_mut().zip(&geometry.disparity) {
        let own = || {
            disparity
                .iter()
                .zip(sensor.iter())
                .filter(|(_, s)| **s > 0.0)
        };
        let mut values: Vec<f32> = own().map(|(d, _)| *d).collect();
        let Some(median) = quantile(&mut values, 0.5) else {
            continue;
        };
        sensor
            .iter_mut()
            .filter(|s| **s > 0.0)
            .for_each(|s| *s = median);
    }
}

/// Gives the piece one shape: each disparity becomes the mean of those of the same place in the
/// frames of its edges, carried by the motion of the piece.
pub(super) fn agree(geometry: &mut Geometry<f32>, edges: &[&Factor<f32>]) {
    let grid = geometry.grid;
    for _ in 0..AGREEMENTS {
        let mut sums = geometry.disparity.clone();
        let mut weights: Vec<Vec<f32>> = sums.iter().map(|d| vec![1.0; d.len()]).collect();
        for edge in edges {
            let back = geometry.relative(edge.target, edge.source);
            for g in 0..grid.len() {
                let weight = edge.weight[0][g];
                if weight < LEAST_WEIGHT || geometry.sensor[edge.source][g] <= 0.0 {
                    continue;
                }
                let [x, y] = [edge.target_px[0][g], edge.target_px[1][g]];
                let Some(there) = pixel_at(grid.width, grid.height, x, y) else {
                    continue;
                };
                if geometry.sensor[edge.target][there] <= 0.0 {
                    continue;
                }
                let d = geometry.disparity[edge.target][there];
                let ray = ray_at(geometry, f64::from(x), f64::from(y));
                let p = back.rotation * ray + back.translation * f64::from(d);
                let carried = d / p.z as f32;
                let own = geometry.disparity[edge.source][g];
                if p.z > 0.0 && (carried / own).ln().abs() < MOST_CHANGE {
                    sums[edge.source][g] += weight * carried;
                    weights[edge.source][g] += weight;
                }
            }
        }
        for ((disparity, sum), weight) in (geometry.disparity.iter_mut()).zip(&sums).zip(&weights) {
            for ((d, sum), weight) in disparity.iter_mut().zip(sum).zip(weight) {
                *d = sum / weight;
            }
        }
    }
}

/// Gives every block of the part a disparity: those without one, 0, that of the piece, near blocks
/// the more; averaged over a sixth of a second before and after, so that blocks at the edge of the
/// piece stay at one distance. Legs hang below a trunk and a head is above it: they lie on an
/// upright plane with it (of [`upright`], by frame), not at one z-depth, which a camera that looks
/// down has greater below.
pub(super) fn fill(part: &Part<'_>, upright: &[Vec<f32>], disparity: &mut [Vec<f32>]) {
    let piece = disparity.to_vec();
    for (k, disparity) in disparity.iter_mut().enumerate() {
        let others: Vec<usize> = (0..disparity.len())
            .filter(|&g| disparity[g] <= 0.0 && part.has(k, g))
            .collect();
        let values = carried(part.blocks.grid.width, &upright[k], &piece[k], &others);
        for (g, value) in others.into_iter().zip(values) {
            disparity[g] = value;
        }
    }
    let filled = disparity.to_vec();
    let (grid, [left, top]) = (part.blocks.grid, part.blocks.corner.map(|c| c as f32));
    let block = BLOCK_PX as f32;
    let reach = part.clip.rate.frames(AROUND_S);
    for (k, disparity) in disparity.iter_mut().enumerate() {
        let mut weights = vec![1.0f32; disparity.len()];
        for later in [true, false] {
            part.walk(k, later, reach, |step| {
                for g in (0..weights.len()).filter(|&g| step.miss[g].is_finite()) {
                    let (x, y) = (step.px[g] / block - left, step.py[g] / block - top);
                    let there = pixel_at(grid.width, grid.height, x, y)
                        .map_or(0.0, |there| filled[step.frame][there]);
                    if piece[k][g] <= 0.0 && there > 0.0 {
                        disparity[g] += there;
                        weights[g] += 1.0;
                    }
                }
            });
        }
        disparity
            .iter_mut()
            .zip(&weights)
            .for_each(|(d, weight)| *d /= weight);
    }
}

/// By block of frame `k`, the disparity of an upright plane that faces the camera at unit distance
/// along the horizon; 1 where `down` is not known or the camera looks too steeply for one to be in
/// view.
pub(super) fn upright(part: &Part<'_>, k: usize, down: Option<&Vector3<f64>>) -> Vec<f32> {
    let blocks = 0..part.blocks.grid.len();
    let camera = part.clip.cameras.get(part.tracklet.first + k);
    let (Some(camera), Some(down)) = (camera, down) else {
        return vec![1.0; blocks.len()];
    };
    let down = camera.c2w.rotation.transpose() * down;
    // of the optical axis, what is level
    let level = Vector3::z() - down.z * down;
    let disparity = |g: usize| {
        let (x, y) = part.blocks.pixel(g);
        level.dot(&ray(camera, x, y))
    };
    let in_view = blocks.clone().filter(|&g| part.has(k, g));
    if in_view.map(disparity).any(|d| d < LEAST_LEVEL) {
        return vec![1.0; blocks.len()];
    }
    blocks
        .map(|g| disparity(g).max(LEAST_LEVEL) as f32)
        .collect()
}

/// Disparities of `blocks` of a grid of this width, beside a `piece` (0 elsewhere) on the planes of
/// `profile`: of the piece its own, of others those of the piece, near ones the more. None where
/// there is no piece.
pub(super) fn carried(width: usize, profile: &[f32], piece: &[f32], blocks: &[usize]) -> Vec<f32> {
    let place = |g: usize| [(g % width) as f32, (g / width) as f32];
    let own: Vec<usize> = (0..piece.len()).filter(|&g| piece[g] > 0.0).collect();
    let known: Vec<([f32; 2], f32)> = (own.iter())
        .step_by(own.len().div_ceil(MOST_BLOCKS).max(1))
        .map(|&g| (place(g), piece[g] / profile[g]))
        .collect();
    if known.is_empty() {
        return Vec::new();
    }
    let value = |&g: &usize| {
        if piece[g] > 0.0 {
            return piece[g];
        }
        let [x, y] = place(g);
        let (mut sum, mut weight) = (0.0, 0.0);
        for ([u, v], d) in &known {
            let near = (u - x).hypot(v - y).powf(-FADING);
            sum += near * d;
            weight += near;
        }
        profile[g] * sum / weight
    };
    blocks.iter().map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Tracklet;
    use super::{Factor, Geometry, Part, agree, fill, flatten, noise_px, ray, upright};
    use crate::classical::dense::working::ClipData;
    use crate::dba::{Grid, Pinhole};
    use crate::flow::FlowPair;
    use m4_core::{Camera, Flow, Intrinsics, Se3};
    use nalgebra::{Rotation3, Vector3};

    const SIDE: usize = 40;
    const FRAMES: usize = 3;

    /// Blocks of a frame.
    const BLOCKS: usize = 16;

    /// The edge of a part that does not move, with flow that is off by this.
    fn edge((source, target): (usize, usize), off_px: f32) -> Factor<f32> {
        Factor {
            source,
            target,
            target_px: [
                (0..BLOCKS).map(|g| (g % 4) as f32 + off_px).collect(),
                (0..BLOCKS).map(|g| (g / 4) as f32).collect(),
            ],
            weight: [vec![1.0; BLOCKS], vec![1.0; BLOCKS]],
        }
    }

    /// A plane that faces the camera, with these disparities by frame; one block is no piece.
    fn geometry(disparity: &[f32]) -> Geometry<f32> {
        let mut sensor = vec![vec![1.0f32; BLOCKS]; disparity.len()];
        sensor[0][3] = 0.0;
        Geometry {
            grid: Grid {
                width: 4,
                height: 4,
            },
            lens: Pinhole {
                fx: 10.0,
                fy: 10.0,
                cx: 1.5,
                cy: 1.5,
            },
            poses: vec![Se3::identity(); disparity.len()],
            disparity: disparity.iter().map(|d| vec![*d; BLOCKS]).collect(),
            sensor,
        }
    }

    #[test]
    fn noise_is_that_of_the_residuals_and_the_prior_follows_the_piece() {
        let mut geometry = geometry(&[1.0, 1.0]);
        let edges = [edge((0, 1), 0.118), edge((1, 0), 0.118)];
        let noise = noise_px(&geometry, &edges.iter().collect::<Vec<_>>()).unwrap();
        assert!((noise - 0.1).abs() < 1e-4, "{noise}");
        assert_eq!(noise_px(&geometry, &[]), None);
        geometry.disparity[1][..4].copy_from_slice(&[9.0, 0.5, 0.8, 9.0]);
        geometry.disparity[1][4..].fill(0.7);
        flatten(&mut geometry);
        assert_eq!(geometry.sensor[1], vec![0.7; BLOCKS]);
        assert_eq!((geometry.sensor[0][0], geometry.sensor[0][3]), (1.0, 0.0));
    }

    #[test]
    fn a_piece_gets_the_mean_shape_of_its_frames() {
        let edges: Vec<Factor<f32>> = [(0, 1), (1, 0), (1, 2), (2, 1), (0, 2), (2, 0)]
            .map(|frames| edge(frames, 0.0))
            .into();
        let mut geometry = geometry(&[0.9, 1.0, 1.1]);
        agree(&mut geometry, &edges.iter().collect::<Vec<_>>());
        for disparity in &geometry.disparity {
            assert!((disparity[5] - 1.0).abs() < 1e-3, "{disparity:?}");
        }
        // What is no piece is left alone, and does not count.
        assert_eq!(geometry.disparity[0][3], 0.9);
        assert!((geometry.disparity[1][3] - 1.05).abs() < 1e-3);
    }

    /// A clip in which nothing moves, and a part that is all of it.
    fn still(cameras: Vec<Camera>) -> (ClipData, Tracklet) {
        let flow = || Flow {
            width: SIDE,
            height: SIDE,
            u: vec![0.0; SIDE * SIDE],
            v: vec![0.0; SIDE * SIDE],
        };
        let data = ClipData {
            size: (SIDE, SIDE),
            cameras,
            dynamic: Vec::new(),
            disparity: Vec::new(),
            flows: (1..FRAMES)
                .map(|_| FlowPair {
                    forward: flow(),
                    backward: flow(),
                })
                .collect(),
        };
        let tracklet = Tracklet {
            first: 0,
            parts: vec![(0..(SIDE * SIDE) as u32).collect(); FRAMES],
        };
        (data, tracklet)
    }

    #[test]
    fn legs_hang_below_a_trunk_though_the_camera_looks_down() {
        let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), -0.3).into_inner();
        let camera = Camera {
            intrinsics: Intrinsics::centred(SIDE, SIDE, 50.0),
            c2w: Se3 {
                rotation: turn,
                translation: Vector3::zeros(),
            },
        };
        let (data, tracklet) = still(vec![camera; FRAMES]);
        let clip = data.clip();
        let part = Part::of(&clip, &tracklet);
        // of a wall three units ahead along the horizon
        let wall = |g: usize| {
            let (x, y) = part.blocks.pixel(g);
            (turn * ray(&camera, x, y)).z as f32 / 3.0
        };
        let (blocks, width) = (0..part.blocks.grid.len(), part.blocks.grid.width);
        let upper = |g: usize| if g / width < 4 { wall(g) } else { 0.0 };
        let upper: Vec<f32> = blocks.clone().map(upper).collect();
        let mut disparity = vec![upper; FRAMES];
        let upright: Vec<Vec<f32>> = (0..FRAMES)
            .map(|k| upright(&part, k, Some(&Vector3::y())))
            .collect();
        fill(&part, &upright, &mut disparity);
        for g in blocks {
            let off = (disparity[1][g] / wall(g)).ln();
            assert!(off.abs() < 1e-4, "block {g}: {off}");
        }
        // it differs from one z-depth
        assert!((wall(0) / wall(width * (width - 1))).ln() > 0.15);
    }

    #[test]
    fn what_is_no_piece_is_as_far_as_the_nearest_of_it() {
        let (data, tracklet) = still(Vec::new());
        let clip = data.clip();
        let part = Part::of(&clip, &tracklet);
        let width = part.blocks.grid.width;
        // Near on the left, far on the right, unknown below; the frame in between has no value on
        // the left.
        let of_frame = |k: usize| -> Vec<f32> {
            let value = |g: usize| match (g % width, g / width) {
                (_, 3..) => 0.0,
                (0..5, _) if k == 1 => 0.0,
                (0..5, _) => 2.0,
                _ => 1.0,
            };
            (0..part.blocks.grid.len()).map(value).collect()
        };
        let mut disparity: Vec<Vec<f32>> = (0..FRAMES).map(of_frame).collect();
        let flat = vec![vec![1.0; disparity[0].len()]; FRAMES];
        fill(&part, &flat, &mut disparity);
        let [left, right] = [0, width - 1].map(|x| disparity[0][4 * width + x]);
        assert!(left > 1.5 && right < 1.5 && right > 1.0, "{left} {right}");
        assert_eq!(disparity[0][0], 2.0);
        let between = disparity[1][0];
        assert!(between > 1.2 && between < 2.0, "{between}");
    }
}
