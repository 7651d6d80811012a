//! Propagates dynamic points to keyframes in which they are occluded, from keyframes that see them.
//!
//! What leaves the image, or goes behind something, is still there: a view from beside the video may
//! see it (docs/spec/optimiser.md 2.6: occluded samples are kept). Points move on with what can be seen of the body that they
//! belong to, or, where nothing of it can be seen, as they moved last. In every keyframe they pass through, those that the camera would see are dropped, since the keyframe's own
//! points are better; so are those that would float in front of something.

use crate::init::{
    InitError,
    config::stopped,
    motion::{Field, Fields, bodies},
    voxel::{Centroids, Grid},
};
use m4_core::{Capture, CaptureFrame, Progress};
use rayon::prelude::*;

/// Most points that are carried, all keyframes together; those carried the longest way are left out. Depth that does not agree
/// from frame to frame makes many of them (our rule).
pub(crate) const MOST_CARRIED: usize = 300_000;
/// A carried point behind the depth map by more than this share of the depth is hidden; one nearer to it may be a point of the visible surface itself,
/// as precisely as points are carried. docs/spec/optimiser.md 2.6 has 0.05; limbs are thinner than that (docs/decisions/0004).
pub(crate) const CARRY_MARGIN: f32 = 0.02;
/// Points closer than this, pixels at the median depth, belong to one body (our rule).
pub(crate) const CARRY_REACH_PIXELS: f32 = 6.0;

/// What is carried, and how far.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Carry {
    /// Keyframes that a point is carried on from the one that saw it.
    pub keyframes: usize,
    /// Most points, all keyframes together; those carried the longest way are left out.
    pub most: usize,
    /// A point behind the depth map by more than this share of the depth is hidden.
    pub margin: f32,
    /// Points closer than this, world units, belong to one body; a hidden point goes with what is seen of its body
    /// within this distance at least.
    pub reach: f32,
}

/// Points of one keyframe with their velocities, world units per frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Moving {
    pub points: Centroids,
    pub velocity: Vec<[f32; 3]>,
}

#[derive(Debug, Clone, Copy)]
struct Point {
    xyz: [f32; 3],
    rgb: [f32; 3],
    edge: f32,
    velocity: [f32; 3],
    age: usize,
}

impl Point {
    /// The point after one more keyframe, `gap` frames on; one of the same instant says nothing of its velocity.
    fn moved(self, to: [f32; 3], gap: f32) -> Self {
        Self {
            xyz: to,
            velocity: match gap {
                0.0 => self.velocity,
                _ => [0, 1, 2].map(|k| (to[k] - self.xyz[k]) / gap),
            },
            age: self.age + 1,
            ..self
        }
    }
}

/// For every keyframe the points of others that it cannot see; `frames` are the frames of the keyframes,
/// `fields` the motions between them.
pub(crate) fn hidden(
    capture: &Capture,
    frames: &[usize],
    moving: &[(f64, Centroids)],
    fields: &[Fields],
    grid: &Grid,
    by: Carry,
    progress: &dyn Progress,
) -> Result<Vec<Moving>, InitError> {
    let n = moving.len();
    if by.keyframes == 0 {
        return Ok(vec![Moving::default(); n]);
    }
    let along = |forward: bool| -> Result<Vec<Vec<Point>>, InitError> {
        let mut out: Vec<Vec<Point>> = vec![Vec::new(); n];
        let mut carried: Vec<Point> = Vec::new();
        for step in 1..n {
            stopped(progress)?;
            let (from, to, field) = if forward {
                (step - 1, step, &fields[step - 1].forward)
            } else {
                (n - step, n - 1 - step, &fields[n - 1 - step].backward)
            };
            let gap = (moving[to].0 - moving[from].0) as f32;
            let points = &moving[from].1;
            let own = points.xyz.iter().zip(field.places(&points.xyz)).enumerate().map(|(i, (&xyz, to))| {
                let point = Point { xyz, rgb: points.rgb[i], edge: points.edge[i], velocity: [0.0; 3], age: 0 };
                point.moved(to, gap)
            });
            let frame = &capture.frames[frames[to]];
            let moved = own.chain(go_on(&carried, field, gap, by.reach));
            let unseen = moved.filter(|p| p.age <= by.keyframes && !is_seen(frame, p.xyz, by.margin));
            carried = youngest(unseen.collect(), grid);
            out[to].clone_from(&carried);
        }
        Ok(out)
    };
    let (onwards, back) = rayon::join(|| along(true), || along(false));
    let both = onwards?.into_par_iter().zip(back?);
    let mut out: Vec<Vec<Point>> = both.map(|(a, b)| youngest([a, b].concat(), grid)).collect();
    let oldest = oldest_kept(out.iter().flatten().map(|p| p.age), by);
    for points in &mut out {
        points.retain(|p| p.age <= oldest);
    }
    Ok(out.into_iter().map(collect).collect())
}

/// The age up to which all points together are no more than may be kept.
fn oldest_kept(ages: impl Iterator<Item = usize>, by: Carry) -> usize {
    let mut count = vec![0usize; by.keyframes + 1];
    for age in ages {
        count[age.min(by.keyframes)] += 1;
    }
    let mut sum = 0;
    for (age, n) in count.iter().enumerate() {
        sum += n;
        if sum > by.most {
            return age.saturating_sub(1);
        }
    }
    by.keyframes
}

/// Occluded points, moved with their rigid objects.
fn go_on(carried: &[Point], field: &Field, gap: f32, reach: f32) -> Vec<Point> {
    let n = field.nodes.len();
    let all = field.nodes.iter().copied().chain(carried.iter().map(|p| p.xyz));
    let body = bodies(all, reach);
    let mut seen: Vec<Vec<u32>> = vec![Vec::new(); body.iter().max().map_or(0, |m| m + 1)];
    for (i, &b) in body[..n].iter().enumerate() {
        seen[b].push(i as u32);
    }
    carried
        .par_iter()
        .zip(&body[n..])
        .map(|(p, &b)| {
            let on = || [0, 1, 2].map(|k| p.xyz[k] + gap * p.velocity[k]);
            p.moved(field.place_beyond(&seen[b], p.xyz, reach).unwrap_or_else(on), gap)
        })
        .collect()
}

/// One point a cell: the one carried the shortest way.
fn youngest(points: Vec<Point>, grid: &Grid) -> Vec<Point> {
    let mut keys: Vec<((i16, u64), usize, usize)> =
        points.iter().enumerate().map(|(i, p)| (grid.key(p.xyz), p.age, i)).collect();
    keys.sort_unstable();
    keys.dedup_by_key(|k| k.0);
    keys.iter().map(|&(_, _, i)| points[i]).collect()
}

fn collect(points: Vec<Point>) -> Moving {
    let mut out = Moving::default();
    for p in points {
        out.points.xyz.push(p.xyz);
        out.points.rgb.push(p.rgb);
        out.points.edge.push(p.edge);
        out.velocity.push(p.velocity);
    }
    out
}

/// True where the camera of `frame` looks at or through the point: inside the image and not behind
/// the depth map. A frame without depth sees everything inside its image.
pub(crate) fn is_seen(frame: &CaptureFrame, p: [f32; 3], margin: f32) -> bool {
    let ([u, v], z) = frame.camera.project(&p.map(f64::from).into());
    let (w, h) = frame.rgb.size();
    let inside = z > 0.0 && u > -0.5 && v > -0.5 && u < w as f64 - 0.5 && v < h as f64 - 0.5;
    if !inside {
        return false;
    }
    frame.depth.as_ref().is_none_or(|depth| {
        let (dw, dh) = depth.size();
        let x = ((u + 0.5) * dw as f64 / w as f64) as usize;
        let y = ((v + 0.5) * dh as f64 / h as f64) as usize;
        let surface = depth.at(x.min(dw - 1), y.min(dh - 1));
        // nothing known there: as likely seen as not
        !(surface > 0.0 && z as f32 > surface * (1.0 + margin))
    })
}

#[cfg(test)]
mod tests {
    use super::{Carry, hidden};
    use crate::init::{
        CellSize,
        motion::{Field, Fields, Rigid},
        voxel::{Centroids, Grid},
    };
    use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane, Se3, Silent};

    /// A point at depth 3 moves to the right by 0.5 a frame: it leaves the image after frame 3, and a
    /// pillar at depth 1 hides it in frame 2.
    #[test]
    fn points_are_carried_where_they_cannot_be_seen() {
        let camera = Camera { intrinsics: Intrinsics::centred(40, 20, 30.0), c2w: Se3::identity() };
        let x_at = |t: usize| -0.5 + 0.5 * t as f32;
        let seen = |t: usize| t != 2 && t < 5;
        let frame = |t: usize| CaptureFrame {
            name: t.to_string(),
            camera,
            t: t as f64,
            rgb: Plane::filled(40, 20, [0; 3]),
            depth: Some(Plane::from_fn(40, 20, |x, _| if (22..28).contains(&x) { 1.0 } else { 3.0 }).into()),
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
        };
        let capture = Capture {
            frames: (0..8).map(frame).collect(),
            time_frames: 8,
            duration_s: None,
            metric: true,
            tracks: None,
        };
        let moving: Vec<(f64, Centroids)> = (0..8)
            .map(|t| {
                let mut points = Centroids::default();
                if seen(t) {
                    points.xyz.push([x_at(t), 0.0, 3.0]);
                    points.rgb.push([0.1 * t as f32; 3]);
                    points.edge.push(0.1);
                }
                (t as f64, points)
            })
            .collect();
        let field = |t: usize, step: f32| {
            let nodes = moving[t].1.xyz.clone();
            let motion = nodes.iter().map(|p| Rigid::shift(*p, [p[0] + step, p[1], p[2]])).collect();
            Field { nodes, motion }
        };
        let fields: Vec<Fields> =
            (0..7).map(|t| Fields { forward: field(t, 0.5), backward: field(t + 1, -0.5) }).collect();
        let grid = Grid::new(CellSize::Constant, 3.0, 30.0, 3.0, &[], [0.0; 3]);
        let frames: Vec<usize> = (0..8).collect();
        let by = |keyframes| Carry { keyframes, most: usize::MAX, margin: 0.05, reach: 0.3 };
        let got = hidden(&capture, &frames, &moving, &fields, &grid, by(2), &Silent).unwrap();
        let counts: Vec<usize> = got.iter().map(|m| m.points.xyz.len()).collect();
        assert_eq!(counts, [0, 0, 1, 0, 0, 1, 1, 0], "hidden in 2, outside from 5 on, carried at most twice");
        for t in [2, 5, 6] {
            assert!((got[t].points.xyz[0][0] - x_at(t)).abs() < 1e-5);
        }
        assert_eq!(got[6].points.rgb[0][0], 0.4, "from the last keyframe that saw it");
        // keyframes of one instant, from several cameras: points are handed on, and have no endless velocity
        let at_once: Vec<(f64, Centroids)> = moving.iter().map(|(_, points)| (0.0, points.clone())).collect();
        let got_at_once = hidden(&capture, &frames, &at_once, &fields, &grid, by(2), &Silent).unwrap();
        let all: Vec<&[f32; 3]> = got_at_once.iter().flat_map(|m| &m.velocity).collect();
        assert!(!all.is_empty());
        assert!(all.iter().all(|v| **v == [0.0; 3]), "{all:?}");
        let few = Carry { most: 2, ..by(2) };
        let got = hidden(&capture, &frames, &moving, &fields, &grid, few, &Silent).unwrap();
        let counts: Vec<usize> = got.iter().map(|m| m.points.xyz.len()).collect();
        assert_eq!(counts, [0, 0, 1, 0, 0, 1, 0, 0], "those carried twice are one too many");
        let none = hidden(&capture, &frames, &moving, &fields, &grid, by(0), &Silent).unwrap();
        assert!(none.iter().all(|m| m.points.xyz.is_empty()));
    }
}
