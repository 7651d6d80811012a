//! Motion fields between keyframes, and the velocity and bend of the paths of their points.

use crate::init::{
    InitError,
    config::stopped,
    motion::{
        register::{Guess, Keyframe, KeyframeTracks, KeyframeView, register},
        rigid::Rigid,
    },
    voxel::Centroids,
};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::{
    Progress,
    nalgebra::{UnitQuaternion, Vector3},
};
use rayon::prelude::*;
use std::num::NonZero;

/// How points move from one keyframe to a neighbour: known around some places, asked for at others.
#[derive(Debug, Clone, Default)]
pub(crate) struct Field {
    /// Places where the motion is known, world units.
    pub nodes: Vec<[f32; 3]>,
    /// The motion around each.
    pub motion: Vec<Rigid>,
}

/// Motions to the next keyframe and, from there, back.
#[derive(Debug, Clone, Default)]
pub(crate) struct Fields {
    pub forward: Field,
    pub backward: Field,
}

/// Motions between every keyframe and the next; refined by `tracks`. Fails with
/// [`InitError::Stopped`].
pub(crate) fn fields(
    keyframes: &[KeyframeView<'_>],
    tracks: Option<KeyframeTracks<'_>>,
    reach: f32,
    progress: &dyn Progress,
) -> Result<Vec<Fields>, InitError> {
    let shifts_between = |from, to| tracks.and_then(|w| w.between(from, to));
    // three at a time: trees of all would take much memory
    let prepared = |i: usize| keyframes.get(i).map(|view| Keyframe::new(*view, reach));
    let places = |keyframe: &Keyframe<'_>| keyframe.view.nodes.xyz.clone();
    // Motion continues: the last one is a good first guess.
    let forward = |last: Option<&Field>, (i, from): (usize, &Keyframe<'_>), to: &Keyframe<'_>| {
        let nodes = places(from);
        let guess = last.map_or_else(
            || shifts(&nodes, &nodes),
            |last| shifts(&nodes, &last.onward(&nodes)),
        );
        Field {
            motion: register(
                from,
                to,
                shifts_between(i, i + 1),
                Guess::Rough(guess),
                reach,
            ),
            nodes,
        }
    };
    let backward = |ahead: &Field, from: &Keyframe<'_>, (i, to): (usize, &Keyframe<'_>)| {
        let nodes = places(to);
        let guess = shifts(&nodes, &ahead.inverse().places(&nodes));
        Field {
            motion: register(
                to,
                from,
                shifts_between(i, i - 1),
                Guess::Close(guess),
                reach,
            ),
            nodes,
        }
    };
    let mut out: Vec<Fields> = Vec::new();
    let (Some(first), Some(second)) = (prepared(0), prepared(1)) else {
        return Ok(out);
    };
    let mut ahead = forward(None, (0, &first), &second);
    let (mut behind, mut here) = (first, second);
    for i in 1..keyframes.len() {
        stopped(progress)?;
        progress.update("motions", i - 1, keyframes.len() - 1, "");
        // the way back of this pair beside the way forward of the next
        let (back, next) = rayon::join(
            || backward(&ahead, &behind, (i, &here)),
            || prepared(i + 1).map(|next| (forward(Some(&ahead), (i, &here), &next), next)),
        );
        let Some((onward, next)) = next else {
            out.push(Fields {
                forward: ahead,
                backward: back,
            });
            break;
        };
        out.push(Fields {
            forward: std::mem::replace(&mut ahead, onward),
            backward: back,
        });
        behind = std::mem::replace(&mut here, next);
    }
    Ok(out)
}

fn shifts(from: &[[f32; 3]], to: &[[f32; 3]]) -> Vec<Rigid> {
    from.iter()
        .zip(to)
        .map(|(p, q)| Rigid::shift(*p, *q))
        .collect()
}

impl Field {
    /// The motion back, known where this one leads.
    pub fn inverse(&self) -> Self {
        Self {
            nodes: self
                .nodes
                .iter()
                .zip(&self.motion)
                .map(|(p, m)| m.apply(*p))
                .collect(),
            motion: self.motion.iter().map(Rigid::inverse).collect(),
        }
    }

    /// The same displacement once more, at points of the keyframe that this motion leads to.
    fn onward(&self, at: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let back = self.inverse().places(at);
        at.iter()
            .zip(back)
            .map(|(p, q)| [0, 1, 2].map(|k| 2.0 * p[k] - q[k]))
            .collect()
    }

    /// Where points among the nodes go: by the motions of the three nearest nodes, weighted by the
    /// inverse distance. Without nodes nothing moves.
    pub fn places(&self, at: &[[f32; 3]]) -> Vec<[f32; 3]> {
        const THREE: NonZero<usize> = NonZero::new(3).unwrap();
        let tree = match ImmutableKdTree::<f32, 3>::new_from_slice(&self.nodes) {
            Ok(tree) if !self.nodes.is_empty() => tree,
            _ => return at.to_vec(),
        };
        at.par_iter()
            .map(|p| {
                let (mut sum, mut total) = ([0.0f32; 3], 0.0f32);
                for n in tree
                    .query(p)
                    .nearest_n::<SquaredEuclidean<f32>>(THREE)
                    .execute()
                {
                    let weight = 1.0 / n.distance.sqrt().max(1e-6);
                    let q = self.motion[n.item as usize].apply(*p);
                    (0..3).for_each(|k| sum[k] += weight * q[k]);
                    total += weight;
                }
                sum.map(|s| s / total.max(1e-9))
            })
            .collect()
    }

    /// The motions around points among the nodes: turned as the nearest node is, placed as
    /// [`places`](Self::places) says.
    pub fn motions(&self, at: &[[f32; 3]]) -> Vec<Rigid> {
        let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&self.nodes)
            .ok()
            .filter(|_| !self.nodes.is_empty());
        let places = self.places(at);
        at.par_iter()
            .zip(places)
            .map(|(p, q)| {
                let nearest = tree
                    .as_ref()
                    .map(|t| t.query(p).nearest_one::<SquaredEuclidean<f32>>().execute());
                let rotation = nearest.map_or_else(UnitQuaternion::identity, |n| {
                    self.motion[n.item as usize].rotation
                });
                Rigid {
                    rotation,
                    from: (*p).into(),
                    to: q.into(),
                }
            })
            .collect()
    }
}

/// Motion of the points of a keyframe.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Paths {
    /// World units per frame: half the displacement from the keyframe before to the one after; one
    /// side at the ends; 0 for a lone keyframe.
    pub velocity: Vec<[f32; 3]>,
    /// Distance between the path and the straight line one keyframe away, across the viewing ray of
    /// the keyframe, world units. Along the ray, depth is too uncertain to tell; 0 at the ends.
    pub bend: Vec<f32>,
}

impl Paths {
    /// Those of some of the points.
    pub fn of_points(&self, points: &[u32]) -> Self {
        let all = || points.iter().map(|&k| k as usize);
        Self {
            velocity: all().map(|k| self.velocity[k]).collect(),
            bend: all().map(|k| self.bend[k]).collect(),
        }
    }

    /// Of the points of keyframe `i` of `dynamic` (time in frames, points), seen from `centre`;
    /// `fields` leads from each keyframe to the next.
    pub fn of(
        dynamic: &[(f64, Centroids)],
        fields: &[Fields],
        i: usize,
        centre: &Vector3<f64>,
    ) -> Self {
        let (t, points) = &dynamic[i];
        // a keyframe of the same instant, from another camera, says nothing of velocities
        let side = |field: &Field, other: f64| -> Option<(f32, Vec<Vector3<f32>>)> {
            let gap = (other - t) as f32;
            let places = (gap != 0.0).then(|| field.places(&points.xyz))?;
            let pairs = places.iter().zip(&points.xyz);
            Some((
                gap,
                pairs
                    .map(|(q, p)| (Vector3::from(*q) - Vector3::from(*p)) / gap)
                    .collect(),
            ))
        };
        let before = i
            .checked_sub(1)
            .and_then(|j| side(&fields[j].backward, dynamic[j].0));
        let after = dynamic
            .get(i + 1)
            .and_then(|next| side(&fields[i].forward, next.0));
        let straight = |v: Vec<Vector3<f32>>| Self {
            bend: vec![0.0; v.len()],
            velocity: v.into_iter().map(Into::into).collect(),
        };
        match (before, after) {
            (Some((back, a)), Some((ahead, b))) => {
                let gap = 0.5 * (ahead - back);
                let centre = centre.cast::<f32>();
                let bend = a.iter().zip(&b).zip(&points.xyz).map(|((a, b), p)| {
                    let ray = Vector3::from(*p) - centre;
                    let off = (b - a) * (0.5 * gap);
                    (off - ray * (off.dot(&ray) / ray.norm_squared().max(f32::MIN_POSITIVE))).norm()
                });
                Self {
                    bend: bend.collect(),
                    velocity: a
                        .iter()
                        .zip(&b)
                        .map(|(a, b)| (0.5 * (a + b)).into())
                        .collect(),
                }
            }
            (Some((_, v)), None) | (None, Some((_, v))) => straight(v),
            (None, None) => straight(vec![Vector3::zeros(); points.xyz.len()]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Field, Fields, KeyframeView, Paths, Rigid, fields};
    use crate::init::voxel::Centroids;
    use m4_core::{
        CounterRng, Silent,
        nalgebra::{UnitQuaternion, Vector3},
    };

    /// Points of a unit cube, with colours that change smoothly over it.
    fn cloud() -> Centroids {
        let mut rng = CounterRng::new(5, 0, 0);
        let mut still = Centroids::default();
        for _ in 0..600 {
            let p = [0, 1, 2].map(|_| rng.uniform() as f32);
            still.xyz.push(p);
            still
                .rgb
                .push([0, 1, 2].map(|k| 0.5 + 0.4 * (5.0 * p[k] + k as f32).sin()));
            still.edge.push(0.05);
        }
        still
    }

    fn moved(still: &Centroids, by: impl Fn([f32; 3]) -> [f32; 3]) -> Centroids {
        let mut out = still.clone();
        out.xyz.iter_mut().for_each(|p| *p = by(*p));
        out
    }

    fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
        (Vector3::from(a) - Vector3::from(b)).norm()
    }

    fn between(clouds: &[Centroids], sees: &(dyn Fn([f32; 3]) -> bool + Sync)) -> Vec<Fields> {
        let view = |c| KeyframeView {
            nodes: c,
            points: c,
            sees,
        };
        fields(
            &clouds.iter().map(view).collect::<Vec<_>>(),
            None,
            0.1,
            &Silent,
        )
        .unwrap()
    }

    fn turn(p: [f32; 3], rad: f32) -> [f32; 3] {
        let centre = Vector3::new(0.5, 0.5, 0.5);
        let about = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.3 * rad, rad));
        (about * (Vector3::from(p) - centre) + centre).into()
    }

    #[test]
    fn a_cloud_that_turns_and_drifts_is_followed_both_ways() {
        let still = cloud();
        let at = |t: f32| {
            moved(&still, |p| {
                let p = turn(p, 0.1 * t);
                [p[0] + 0.03 * t, p[1] - 0.02 * t, p[2]]
            })
        };
        let clouds: Vec<_> = (0..4).map(|t| at(t as f32)).collect();
        let fields = between(&clouds, &|_| true);
        for (i, f) in fields.iter().enumerate().skip(1) {
            let ahead = f.forward.places(&clouds[i].xyz);
            let good = ahead
                .iter()
                .zip(&clouds[i + 1].xyz)
                .filter(|(a, b)| distance(**a, **b) < 0.01);
            assert!(good.count() > 560, "forward from {i}");
            let back = f.backward.places(&clouds[i + 1].xyz);
            let good = back
                .iter()
                .zip(&clouds[i].xyz)
                .filter(|(a, b)| distance(**a, **b) < 0.01);
            assert!(good.count() > 560, "back to {i}");
        }
    }

    /// Half of the cloud leaves the image: what is left must not be pulled back to the border.
    #[test]
    fn points_that_leave_the_image_follow_their_neighbours() {
        let still = cloud();
        let all = [0.0f32, 0.1, 0.2, 0.3].map(|x| moved(&still, |p| [p[0] + x, p[1], p[2]]));
        let in_image = |p: &[f32; 3]| p[0] < 0.9;
        let clouds: Vec<Centroids> = all
            .iter()
            .map(|c| {
                let keep: Vec<usize> = (0..600).filter(|&i| in_image(&c.xyz[i])).collect();
                Centroids {
                    xyz: keep.iter().map(|&i| c.xyz[i]).collect(),
                    rgb: keep.iter().map(|&i| c.rgb[i]).collect(),
                    edge: vec![0.05; keep.len()],
                    key: Vec::new(),
                }
            })
            .collect();
        let fields = between(&clouds, &|p| in_image(&p));
        let field = &fields[2].forward;
        let leaving: Vec<[f32; 3]> = clouds[2]
            .xyz
            .iter()
            .copied()
            .filter(|p| p[0] > 0.8)
            .collect();
        let places = field.places(&leaving);
        let off: f32 = leaving
            .iter()
            .zip(&places)
            .map(|(p, q)| distance([p[0] + 0.1, p[1], p[2]], *q))
            .sum();
        assert!(
            off / (leaving.len() as f32) < 0.02,
            "{}",
            off / leaving.len() as f32
        );
    }

    #[test]
    fn empty_keyframes_move_nothing() {
        let fields = between(&[cloud(), Centroids::default(), cloud()], &|_| true);
        let places = fields[0].forward.places(&[[0.5; 3]]);
        assert!(distance(places[0], [0.5; 3]) < 1e-5);
        assert!(fields[1].forward.nodes.is_empty());
    }

    fn to(from: [f32; 3], to: [f32; 3]) -> Field {
        Field {
            nodes: vec![from],
            motion: vec![Rigid::shift(from, to)],
        }
    }

    fn paths(steps: [[f32; 3]; 3], times: [f64; 3]) -> Paths {
        let [a, b, c] = steps;
        let point = |xyz| Centroids {
            xyz: vec![xyz],
            rgb: vec![[0.5; 3]],
            edge: vec![0.1],
            key: vec![(0, 0)],
        };
        let between = |a, b| Fields {
            forward: to(a, b),
            backward: to(b, a),
        };
        let moving = [
            (times[0], point(a)),
            (times[1], point(b)),
            (times[2], point(c)),
        ];
        Paths::of(
            &moving,
            &[between(a, b), between(b, c)],
            1,
            &Vector3::zeros(),
        )
    }

    #[test]
    fn a_circle_bends_by_its_radius_times_half_the_squared_angle() {
        // before the camera, 0.1 rad from keyframe to keyframe, which are 4 frames apart
        let at = |k: f32| [2.0 * (0.1 * k).sin(), 2.0 * (0.1 * k).cos() - 2.0, 10.0];
        let paths = paths([at(-1.0), at(0.0), at(1.0)], [0.0, 4.0, 8.0]);
        assert!(
            (paths.bend[0] - 2.0 * 0.1 * 0.1 / 2.0).abs() < 1e-4,
            "{paths:?}"
        );
        let v = Vector3::from(paths.velocity[0]);
        assert!(
            (v - Vector3::new(2.0 * 0.1f32.sin() / 4.0, 0.0, 0.0)).norm() < 1e-5,
            "{paths:?}"
        );
    }

    #[test]
    fn a_line_does_not_bend_and_depth_that_jumps_does_not_count() {
        assert!(
            paths(
                [[0.0; 3], [1.0, 0.0, 5.0], [2.0, 0.0, 10.0]],
                [0.0, 1.0, 2.0]
            )
            .bend[0]
                < 1e-5
        );
        let jump = paths(
            [[0.0, 0.0, 9.0], [0.0, 0.0, 10.0], [0.0, 0.0, 9.0]],
            [0.0, 1.0, 2.0],
        );
        assert!(jump.bend[0] < 1e-5, "{jump:?}");
    }
}
