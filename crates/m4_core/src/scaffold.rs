//! Motion that many splats share: the nodes of a window of time, and the splats bound to them
//! (docs/spec/scaffold.md 1).
//!
//! A [`Window`] knows the position and the rotation of its nodes at some instants, its *keys*. A
//! splat that is bound to four nodes is stored as it is where no node has moved, and is carried by
//! the weighted mean of their motions ([`Binding`]):
//!
//! ```text
//! A(t) = sum w_j R_j(t)      b(t) = sum w_j (x_j(t) - R_j(t) a_j)      q(t) = sum +-w_j r_j(t)
//! m(t) = A (mean + velocity (t - time_mean)) + b                       Q(t) = q Q
//! ```
//!
//! `a_j` is where node j is when it has not moved, `x_j` its position, `r_j` its rotation and `R_j`
//! the same as a matrix. Signs bring the quaternions to the side of the first node's.

use crate::ShapeError;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Nodes that carry a splat.
pub const BINDING_NODES: usize = 4;

/// A node at a key.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// World units.
    pub position: [f32; 3],
    /// Rotation since it has not moved, `(w, x, y, z)`, of length 1.
    pub rotation: [f32; 4],
}

impl Pose {
    fn parts(&self) -> (Vector3<f32>, UnitQuaternion<f32>) {
        let [w, x, y, z] = self.rotation;
        (
            self.position.into(),
            UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
        )
    }

    fn new(position: Vector3<f32>, rotation: UnitQuaternion<f32>) -> Self {
        Self {
            position: position.into(),
            rotation: [rotation.w, rotation.i, rotation.j, rotation.k],
        }
    }
}

/// Nodes and their poses over a span of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    keys: Vec<f32>,
    anchors: Vec<[f32; 3]>,
    poses: Vec<Pose>,
}

/// What carries a splat, and when it lives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Binding {
    /// Index of its window.
    pub window: u32,
    /// Nodes of the window.
    pub nodes: [u16; BINDING_NODES],
    /// Their shares, which sum to 1.
    pub weights: [f32; BINDING_NODES],
    /// Begin and end, frames; infinite where it begins before the video or ends after it.
    pub life: [f32; 2],
}

impl Window {
    /// A window with `poses` `[keys][anchors]`; `keys` in frames, `anchors` (where nodes are when
    /// they have not moved) in world units. Fails with [`ShapeError`] if there is no key, keys do
    /// not rise, or there are more or fewer poses.
    pub fn new(
        keys: Vec<f32>,
        anchors: Vec<[f32; 3]>,
        poses: Vec<Pose>,
    ) -> Result<Self, ShapeError> {
        ShapeError::check("window: poses", keys.len() * anchors.len(), poses.len())?;
        let rising = 1 + keys.windows(2).take_while(|k| k[0] < k[1]).count();
        ShapeError::check(
            "window: rising keys",
            keys.len(),
            if keys.is_empty() { 1 } else { rising },
        )?;
        Ok(Self {
            keys,
            anchors,
            poses,
        })
    }

    /// Instants at which poses are known, frames, rising; at least one.
    pub fn keys(&self) -> &[f32] {
        &self.keys
    }

    /// Where nodes are when they have not moved, world units.
    pub fn anchors(&self) -> &[[f32; 3]] {
        &self.anchors
    }

    /// The poses of all nodes at a key.
    pub fn poses(&self, key: usize) -> &[Pose] {
        &self.poses[key * self.anchors.len()..][..self.anchors.len()]
    }

    /// The poses of all nodes at a key; rotations must keep their length.
    pub fn poses_mut(&mut self, key: usize) -> &mut [Pose] {
        let nodes = self.anchors.len();
        &mut self.poses[key * nodes..][..nodes]
    }

    /// The key at `t`, frames.
    pub fn key_at(&self, t: f32) -> Option<usize> {
        self.keys.iter().position(|&key| key == t)
    }

    /// Mean time between keys, frames; 1 for a lone key.
    pub fn gap(&self) -> f32 {
        match self.keys.len() {
            0 | 1 => 1.0,
            n => (self.keys[n - 1] - self.keys[0]) / (n - 1) as f32,
        }
    }

    /// Where a node is at `t`, frames.
    ///
    /// Between two keys a cubic through the positions, with the slopes of the parabolas through
    /// three keys, and the shortest turn between the rotations; beyond the keys motion goes on as
    /// between the last two.
    pub fn pose(&self, node: usize, t: f32) -> Pose {
        let last = self.keys.len() - 1;
        let before = self.keys.partition_point(|&key| key <= t).saturating_sub(1);
        let at = |key: usize| self.poses[key * self.anchors.len() + node].parts();
        if last == 0 || t == self.keys[before] {
            return self.poses[before * self.anchors.len() + node];
        }
        let a = before.min(last - 1);
        let gap = self.keys[a + 1] - self.keys[a];
        let share = (t - self.keys[a]) / gap;
        let ((xa, ra), (xb, rb)) = (at(a), at(a + 1));
        let turn = (rb * ra.inverse()).scaled_axis() * share;
        let rotation = UnitQuaternion::from_scaled_axis(turn) * ra;
        if !(0.0..=1.0).contains(&share) {
            return Pose::new(xa + (xb - xa) * share, rotation);
        }
        let slope = |i: usize, j: usize| (at(j).0 - at(i).0) / (self.keys[j] - self.keys[i]);
        let tangent = |k: usize| match k {
            0 => slope(0, 1),
            k if k == last => slope(last - 1, last),
            k => {
                let (h, g) = (
                    self.keys[k] - self.keys[k - 1],
                    self.keys[k + 1] - self.keys[k],
                );
                (slope(k - 1, k) * g + slope(k, k + 1) * h) / (h + g)
            }
        };
        let (ma, mb) = (tangent(a) * gap, tangent(a + 1) * gap);
        let (s, s2, s3) = (share, share * share, share * share * share);
        let position = xa * (2.0 * s3 - 3.0 * s2 + 1.0)
            + ma * (s3 - 2.0 * s2 + s)
            + xb * (3.0 * s2 - 2.0 * s3)
            + mb * (s3 - s2);
        Pose::new(position, rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::{Pose, Window};
    use nalgebra::{UnitQuaternion, Vector3};

    /// Keys at unequal distances of a node that turns about z and falls.
    fn falling() -> Window {
        let keys = vec![0.0, 1.0, 3.0, 4.0, 6.0];
        let pose = |&t: &f32| {
            let q = UnitQuaternion::from_scaled_axis(Vector3::z() * (0.2 * t));
            Pose {
                position: place(t).into(),
                rotation: [q.w, q.i, q.j, q.k],
            }
        };
        let poses = keys.iter().map(pose).collect();
        Window::new(keys, vec![[0.0; 3]], poses).unwrap()
    }

    fn place(t: f32) -> Vector3<f32> {
        Vector3::new(2.0 + t, 1.0 - 0.5 * t, 0.3 * t * t)
    }

    fn off(window: &Window, t: f32) -> (f32, f32) {
        let pose = window.pose(0, t);
        let [w, x, y, z] = pose.rotation;
        let turn = 2.0 * (x * x + y * y + z * z).sqrt().atan2(w);
        (
            (Vector3::from(pose.position) - place(t)).norm(),
            (turn - 0.2 * t).abs(),
        )
    }

    #[test]
    fn keys_are_met_and_a_parabola_is_followed_between_them() {
        let window = falling();
        for (key, &t) in window.keys().iter().enumerate() {
            assert_eq!(window.pose(0, t), window.poses(key)[0]);
            assert_eq!(window.key_at(t), Some(key));
        }
        for t in [1.25, 1.5, 2.0, 3.5] {
            let (place, turn) = off(&window, t);
            assert!(place < 1e-5 && turn < 1e-5, "at {t}: {place}, {turn}");
        }
        assert!(
            off(&window, 5.0).0 < 0.31,
            "the last gap has one slope of two"
        );
        assert_eq!((window.key_at(2.0), window.gap()), (None, 1.5));
    }

    #[test]
    fn motion_goes_on_beyond_the_keys() {
        let window = falling();
        let ahead = window.pose(0, 7.0).position;
        let [four, six] = [4.0, 6.0].map(place);
        let want = six + (six - four) * 0.5;
        assert!((Vector3::from(ahead) - want).norm() < 1e-4, "{ahead:?}");
        let back = window.pose(0, -1.0).position;
        let want = place(0.0) * 2.0 - place(1.0);
        assert!((Vector3::from(back) - want).norm() < 1e-4, "{back:?}");
        assert!(off(&window, 7.0).1 < 1e-4 && window.pose(0, -1.0).rotation[3] < 0.0);
    }

    #[test]
    fn a_lone_key_stands_still_and_wrong_shapes_are_refused() {
        let pose = Pose {
            position: [1.0, 2.0, 3.0],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        let window = Window::new(vec![2.0], vec![[0.0; 3]], vec![pose]).unwrap();
        assert_eq!([window.pose(0, -5.0), window.pose(0, 9.0)], [pose; 2]);
        assert_eq!(window.gap(), 1.0);
        assert!(Window::new(Vec::new(), Vec::new(), Vec::new()).is_err());
        assert!(Window::new(vec![0.0, 0.0], vec![[0.0; 3]], vec![pose; 2]).is_err());
        assert!(Window::new(vec![0.0, 1.0], vec![[0.0; 3]], vec![pose]).is_err());
    }
}
