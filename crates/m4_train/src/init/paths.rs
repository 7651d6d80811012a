//! How the points of a keyframe move: their velocity, and how far their path bends away from a straight line.

use crate::init::{
    motion::{Field, Fields},
    voxel::Centroids,
};
use m4_core::nalgebra::Vector3;

/// Motion of the points of a keyframe.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Paths {
    /// World units per frame: half the displacement from the keyframe before to the one after; one side at the ends; 0 for a
    /// lone keyframe.
    pub velocity: Vec<[f32; 3]>,
    /// Distance between the path and the straight line one keyframe away, across the viewing ray of the keyframe, world units. Along
    /// the ray, depth is too uncertain to tell; 0 at the ends.
    pub bend: Vec<f32>,
}

impl Paths {
    /// Of the points of keyframe `i` of `moving` (time in frames, points), seen from `centre`; `fields` leads from each keyframe
    /// to the next.
    pub fn of(moving: &[(f64, Centroids)], fields: &[Fields], i: usize, centre: &Vector3<f64>) -> Self {
        let (t, points) = &moving[i];
        // a keyframe of the same instant, from another camera, says nothing of velocities
        let side = |field: &Field, other: f64| -> Option<(f32, Vec<Vector3<f32>>)> {
            let gap = (other - t) as f32;
            let places = (gap != 0.0).then(|| field.places(&points.xyz))?;
            let pairs = places.iter().zip(&points.xyz);
            Some((gap, pairs.map(|(q, p)| (Vector3::from(*q) - Vector3::from(*p)) / gap).collect()))
        };
        let before = i.checked_sub(1).and_then(|j| side(&fields[j].backward, moving[j].0));
        let after = moving.get(i + 1).and_then(|next| side(&fields[i].forward, next.0));
        let straight =
            |v: Vec<Vector3<f32>>| Self { bend: vec![0.0; v.len()], velocity: v.into_iter().map(Into::into).collect() };
        match (before, after) {
            (Some((back, a)), Some((ahead, b))) => {
                let gap = 0.5 * (ahead - back);
                let centre = centre.cast::<f32>();
                let bend = a.iter().zip(&b).zip(&points.xyz).map(|((a, b), p)| {
                    let ray = Vector3::from(*p) - centre;
                    let off = (b - a) * (0.5 * gap);
                    (off - ray * (off.dot(&ray) / ray.norm_squared().max(f32::MIN_POSITIVE))).norm()
                });
                Self { bend: bend.collect(), velocity: a.iter().zip(&b).map(|(a, b)| (0.5 * (a + b)).into()).collect() }
            }
            (Some((_, v)), None) | (None, Some((_, v))) => straight(v),
            (None, None) => straight(vec![Vector3::zeros(); points.xyz.len()]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Paths;
    use crate::init::{
        motion::{Field, Fields, Rigid},
        voxel::Centroids,
    };
    use m4_core::nalgebra::Vector3;

    fn to(from: [f32; 3], to: [f32; 3]) -> Field {
        Field { nodes: vec![from], motion: vec![Rigid::shift(from, to)] }
    }

    fn paths(steps: [[f32; 3]; 3], times: [f64; 3]) -> Paths {
        let [a, b, c] = steps;
        let point = |xyz| Centroids { xyz: vec![xyz], rgb: vec![[0.5; 3]], edge: vec![0.1], key: vec![(0, 0)] };
        let between = |a, b| Fields { forward: to(a, b), backward: to(b, a) };
        let moving = [(times[0], point(a)), (times[1], point(b)), (times[2], point(c))];
        Paths::of(&moving, &[between(a, b), between(b, c)], 1, &Vector3::zeros())
    }

    #[test]
    fn a_circle_bends_by_its_radius_times_half_the_squared_angle() {
        // before the camera, 0.1 rad from keyframe to keyframe, which are 4 frames apart
        let at = |k: f32| [2.0 * (0.1 * k).sin(), 2.0 * (0.1 * k).cos() - 2.0, 10.0];
        let found = paths([at(-1.0), at(0.0), at(1.0)], [0.0, 4.0, 8.0]);
        assert!((found.bend[0] - 2.0 * 0.1 * 0.1 / 2.0).abs() < 1e-4, "{found:?}");
        let v = Vector3::from(found.velocity[0]);
        assert!((v - Vector3::new(2.0 * 0.1f32.sin() / 4.0, 0.0, 0.0)).norm() < 1e-5, "{found:?}");
    }

    #[test]
    fn a_line_does_not_bend_and_depth_that_jumps_does_not_count() {
        assert!(paths([[0.0; 3], [1.0, 0.0, 5.0], [2.0, 0.0, 10.0]], [0.0, 1.0, 2.0]).bend[0] < 1e-5);
        let jump = paths([[0.0, 0.0, 9.0], [0.0, 0.0, 10.0], [0.0, 0.0, 9.0]], [0.0, 1.0, 2.0]);
        assert!(jump.bend[0] < 1e-5, "{jump:?}");
    }
}
