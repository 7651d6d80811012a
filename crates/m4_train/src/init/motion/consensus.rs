//! Offers the motion that most of an object agrees on to points whose own motion fits no better.
//!
//! Registration matches nearest points, starting from the motion before. The far ends of an object that rotates by a large angle from one keyframe to the
//! next are matched to wrong places, however well the rest is matched. What most of a connected object agrees on, a rigid motion, is then right
//! for the ends, too.

use super::rigid::Rigid;
use m4_core::nalgebra::Vector3;
use rayon::prelude::*;

/// Most rigid parts of one object.
const PARTS: usize = 3;
/// A part has at least this share of the points of its object.
const LEAST_SHARE: f32 = 0.15;
/// Points of an object, at equal steps, whose motions are tried as that of a part.
const TRIED: usize = 48;
/// Points of an object, at equal steps, that judge a motion which is tried.
const JUDGES: usize = 512;
/// Fits of a part, each with a smaller tolerance.
const FITS: usize = 4;
/// A motion is preferred to a point's own one unless its residual (squared distance to the matches, [`super::Registration`]'s units) is larger by more than this: a
/// hundredth is a tenth of the reach, or a tenth of the colour scale.
const SLACK: f32 = 0.01;

/// The rigid motions that large parts of the objects agree on.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Consensus {
    /// Number of the object of each point.
    body: Vec<usize>,
    /// Motions of the parts of each object, the largest part first.
    parts: Vec<Vec<Rigid>>,
}

impl Consensus {
    /// Finds the parts of the objects: `body` numbers the object of each of `points`, `motion` is the motion of each. Motions agree if they
    /// lead to places closer than `reach`, world units. Objects of fewer than `least` points have no parts.
    pub fn of(points: &[[f32; 3]], motion: &[Rigid], body: Vec<usize>, reach: f32, least: usize) -> Self {
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); body.iter().max().map_or(0, |m| m + 1)];
        for (i, &b) in body.iter().enumerate() {
            members[b].push(i);
        }
        let parts = members
            .par_iter()
            .map(|members| match members.len() < least {
                true => Vec::new(),
                false => parts(points, motion, members, reach),
            })
            .collect();
        Self { body, parts }
    }

    /// The motion of each point: its own, or that of a part of its object, whichever has the least mean residual over the `near` points; ties go to the parts.
    /// `residual(i, motion)` is that of point `i`; `None` where it cannot be seen.
    pub fn adopt(
        &self,
        motion: &[Rigid],
        near: &[Vec<u32>],
        neighbours: usize,
        residual: impl Fn(usize, &Rigid) -> Option<f32> + Sync,
    ) -> Vec<Rigid> {
        let residuals: Vec<[Option<f32>; PARTS + 1]> = motion
            .par_iter()
            .enumerate()
            .map(|(i, own)| {
                let mut all = [None; PARTS + 1];
                all[PARTS] = residual(i, own);
                for (found, part) in all.iter_mut().zip(&self.parts[self.body[i]]) {
                    *found = residual(i, part);
                }
                all
            })
            .collect();
        let mean = |i: usize, k: usize| {
            let near = near[i][..neighbours.min(near[i].len())].iter().map(|&j| j as usize);
            let known = near
                .filter(|&j| self.body[j] == self.body[i])
                .filter_map(|j| residuals[j][k]);
            let (sum, n) = known.fold((0.0f32, 0.0f32), |(sum, n), r| (sum + r, n + 1.0));
            (n > 0.0).then(|| sum / n)
        };
        let choose = |i: usize| {
            let parts = &self.parts[self.body[i]];
            let mut best = (motion[i], mean(i, PARTS).unwrap_or(f32::INFINITY) + SLACK);
            for (k, part) in parts.iter().enumerate() {
                let found = mean(i, k).filter(|found| *found < best.1);
                best = found.map_or(best, |found| (*part, found));
            }
            best.0
        };
        (0..motion.len()).into_par_iter().map(choose).collect()
    }
}

/// The rigid motions that large parts of one object agree on, the largest part first.
fn parts(points: &[[f32; 3]], motion: &[Rigid], members: &[usize], reach: f32) -> Vec<Rigid> {
    let ends: Vec<(Vector3<f32>, Vector3<f32>)> = members
        .iter()
        .map(|&i| (points[i].into(), motion[i].apply(points[i]).into()))
        .collect();
    let agreement = |m: &Rigid, (p, q): &(Vector3<f32>, Vector3<f32>), reach: f32| {
        let off = (Vector3::from(m.apply((*p).into())) - q).norm_squared() / (reach * reach);
        1.0 / (1.0 + off).powi(2)
    };
    let every = |most: usize| (0..members.len()).step_by(members.len().div_ceil(most).max(1));
    // what no part explains yet
    let mut left = vec![1.0f32; members.len()];
    let mut parts = Vec::new();
    while parts.len() < PARTS {
        let judged = |m: &Rigid| {
            every(JUDGES)
                .map(|i| left[i] * agreement(m, &ends[i], reach))
                .sum::<f32>()
        };
        let tried = every(TRIED).map(|i| motion[members[i]]).map(|m| (judged(&m), m));
        let Some((_, mut part)) = tried.max_by(|a, b| a.0.total_cmp(&b.0)) else {
            break;
        };
        for fit in 0..FITS {
            let reach = reach * 0.5f32.powi(fit as i32);
            let pairs = ends.iter().zip(&left);
            let pairs = pairs.map(|(end, left)| (end.0, end.1, left * agreement(&part, end, reach)));
            part = Rigid::fit(pairs, part.rotation).unwrap_or(part);
        }
        let explained: Vec<f32> = ends.iter().map(|end| agreement(&part, end, 0.25 * reach)).collect();
        let share = explained.iter().zip(&left).map(|(e, l)| e * l).sum::<f32>() / members.len() as f32;
        if share < LEAST_SHARE {
            break;
        }
        left.iter_mut().zip(explained).for_each(|(left, e)| *left *= 1.0 - e);
        parts.push(part);
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::Consensus;
    use crate::init::motion::Rigid;
    use m4_core::{
        CounterRng,
        nalgebra::{UnitQuaternion, Vector3},
    };

    fn rotation(angle: f32, centre: [f32; 3]) -> Rigid {
        Rigid {
            rotation: UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, angle)),
            from: centre.into(),
            to: centre.into(),
        }
    }

    /// A bar of length 2 that rotates by half a radian, and whose outer third is registered as if it stood still; with noise.
    fn bar() -> (Vec<[f32; 3]>, Vec<Rigid>, Rigid) {
        let truth = rotation(0.5, [0.0; 3]);
        let mut rng = CounterRng::new(3, 1, 4);
        let points: Vec<[f32; 3]> = (0..900)
            .map(|_| [2.0 * rng.uniform() as f32, 0.2 * rng.uniform() as f32, 0.0])
            .collect();
        let motion = points
            .iter()
            .map(|p| {
                let noise = [0, 1, 2].map(|_| 0.005 * rng.normal() as f32);
                let q = if p[0] < 1.4 { truth.apply(*p) } else { *p };
                Rigid::shift(*p, [0, 1, 2].map(|k| q[k] + noise[k]))
            })
            .map(|m| Rigid {
                rotation: if m.from.x < 1.4 { truth.rotation } else { m.rotation },
                ..m
            })
            .collect();
        (points, motion, truth)
    }

    fn near(points: &[[f32; 3]]) -> Vec<Vec<u32>> {
        let close = |p: &[f32; 3], q: &[f32; 3]| (p[0] - q[0]).hypot(p[1] - q[1]) < 0.1;
        let of = |p| {
            (0..points.len() as u32)
                .filter(|&j| close(p, &points[j as usize]))
                .collect()
        };
        points.iter().map(of).collect()
    }

    fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
        (Vector3::from(a) - Vector3::from(b)).norm()
    }

    #[test]
    fn the_end_of_a_bar_follows_its_rotation_where_the_data_allow_it() {
        let (points, motion, truth) = bar();
        let consensus = Consensus::of(&points, &motion, vec![0; points.len()], 0.1, 20);
        let found = consensus.parts[0][0];
        assert!(distance(found.apply([2.0, 0.0, 0.0]), truth.apply([2.0, 0.0, 0.0])) < 0.02);
        // the data say nothing: all follow the rotation
        let adopted = consensus.adopt(&motion, &near(&points), 20, |_, _| Some(0.3));
        let worst = |truth: &dyn Fn([f32; 3]) -> [f32; 3], adopted: &[Rigid]| {
            let off = points
                .iter()
                .zip(adopted)
                .map(|(p, m)| distance(m.apply(*p), truth(*p)));
            off.fold(0.0, f32::max)
        };
        assert!(worst(&|p| truth.apply(p), &adopted) < 0.03);
        // the outer third is static: it keeps its own motion
        let real = |p: [f32; 3]| if p[0] < 1.4 { truth.apply(p) } else { p };
        let residual = |i: usize, m: &Rigid| Some((distance(m.apply(points[i]), real(points[i])) / 0.1).powi(2));
        let adopted = consensus.adopt(&motion, &near(&points), 20, residual);
        let far_off = |i: usize| distance(adopted[i].apply(points[i]), real(points[i])) > 0.1;
        let wrong = (0..points.len()).filter(|&i| far_off(i)).count();
        assert!(wrong < points.len() / 20, "{wrong}");
    }

    #[test]
    fn two_parts_of_an_object_are_both_found_and_small_objects_have_none() {
        let mut rng = CounterRng::new(3, 1, 5);
        let points: Vec<[f32; 3]> = (0..600).map(|_| [0, 1, 2].map(|_| rng.uniform() as f32)).collect();
        let two = [rotation(0.4, [0.5; 3]), Rigid::shift([0.0; 3], [0.0, 0.0, 0.7])];
        let motion: Vec<Rigid> = points.iter().map(|p| two[usize::from(p[0] > 0.6)]).collect();
        let consensus = Consensus::of(&points, &motion, vec![0; 600], 0.05, 20);
        for truth in two {
            let found = |m: &Rigid| distance(m.apply([0.1, 0.9, 0.3]), truth.apply([0.1, 0.9, 0.3])) < 0.01;
            assert!(consensus.parts[0].iter().any(found), "{consensus:?}");
        }
        let adopted = consensus.adopt(&motion, &vec![Vec::new(); 600], 20, |_, _| None);
        assert_eq!(adopted, motion);
        let few = Consensus::of(&points[..10], &motion[..10], vec![0; 10], 0.05, 20);
        assert!(few.parts[0].is_empty());
        let none = Consensus::of(&[], &[], Vec::new(), 0.05, 20);
        assert!(none.adopt(&[], &[], 20, |_, _| None).is_empty());
    }
}
