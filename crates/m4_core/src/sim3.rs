//! Similarities: what is left undetermined when geometry is reconstructed from images alone.

use crate::Se3;
use nalgebra::{Matrix3, Vector3};

/// A similarity `x -> scale * rotation * x + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sim3 {
    /// Above 0: units of the target frame in one unit of the source frame.
    pub scale: f64,
    /// Orthonormal, determinant 1.
    pub rotation: Matrix3<f64>,
    /// In the units of the target frame.
    pub translation: Vector3<f64>,
}

impl Sim3 {
    /// The similarity that moves nothing.
    pub fn identity() -> Self {
        Self {
            scale: 1.0,
            rotation: Matrix3::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// The similarity that minimises `sum |target - S(source)|^2` (Umeyama 1991, equations 34-42).
    ///
    /// Points on a line leave the rotation about that line undetermined: one of the minimisers is
    /// returned. `None` when the slices differ in length, hold fewer than two points, hold a value
    /// that is not finite, or when either set has no extent.
    pub fn umeyama(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Option<Self> {
        if source.len() != target.len() || source.len() < 2 {
            return None;
        }
        let n = source.len() as f64;
        let mean_source = source.iter().sum::<Vector3<f64>>() / n;
        let mean_target = target.iter().sum::<Vector3<f64>>() / n;
        let mut covariance = Matrix3::zeros();
        let (mut variance_source, mut variance_target) = (0.0, 0.0);
        for (s, t) in source.iter().zip(target) {
            let (s, t) = (s - mean_source, t - mean_target);
            covariance += t * s.transpose() / n;
            variance_source += s.norm_squared() / n;
            variance_target += t.norm_squared() / n;
        }
        let usable = |variance: f64| variance.is_finite() && variance > 0.0;
        if !usable(variance_source) || !usable(variance_target) {
            return None;
        }
        let svd = covariance.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        // The sign goes to the least singular value, which nalgebra sorts last.
        let mut sign = Vector3::new(1.0, 1.0, 1.0);
        if u.determinant() * v_t.determinant() < 0.0 {
            sign.z = -1.0;
        }
        let rotation = u * Matrix3::from_diagonal(&sign) * v_t;
        let scale = svd.singular_values.dot(&sign) / variance_source;
        if !(scale.is_finite() && scale > 0.0) {
            return None;
        }
        Some(Self {
            scale,
            rotation,
            translation: mean_target - rotation * mean_source * scale,
        })
    }

    /// The image of a point.
    pub fn transform(&self, x: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * x * self.scale + self.translation
    }

    /// The image of a camera-to-world pose: its centre is moved, its axes are turned. Depths seen
    /// from the camera must be multiplied by [`Self::scale`].
    pub fn transform_pose(&self, c2w: &Se3<f64>) -> Se3<f64> {
        Se3 {
            rotation: self.rotation * c2w.rotation,
            translation: self.transform(&c2w.translation),
        }
    }

    /// The similarity that undoes this one.
    pub fn inverse(&self) -> Self {
        let (rotation, scale) = (self.rotation.transpose(), 1.0 / self.scale);
        Self {
            scale,
            rotation,
            translation: -(rotation * self.translation * scale),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Sim3;
    use crate::{Se3, exp_so3};
    use nalgebra::Vector3;

    fn cloud() -> Vec<Vector3<f64>> {
        (0..12)
            .map(f64::from)
            .map(|i| {
                Vector3::new(
                    (i * 1.3).sin(),
                    (i * 0.7).cos() * 2.0,
                    (i * 2.1).sin() - 0.4 * i,
                )
            })
            .collect()
    }

    fn some() -> Sim3 {
        Sim3 {
            scale: 2.7,
            rotation: exp_so3(&Vector3::new(0.4, -1.1, 2.0)),
            translation: Vector3::new(3.0, -1.0, 0.5),
        }
    }

    #[test]
    fn a_similarity_is_recovered_from_its_effect() {
        let (source, want) = (cloud(), some());
        let target: Vec<_> = source.iter().map(|x| want.transform(x)).collect();
        let got = Sim3::umeyama(&source, &target).expect("points with extent");
        assert!(
            (got.scale - want.scale).abs() < 1e-12 && (got.rotation - want.rotation).norm() < 1e-12
        );
        assert!((got.translation - want.translation).norm() < 1e-12);
    }

    #[test]
    fn reflections_give_a_rotation() {
        let source = cloud();
        let target: Vec<_> = source
            .iter()
            .map(|x| Vector3::new(-x.x, x.y, x.z))
            .collect();
        let got = Sim3::umeyama(&source, &target).expect("points with extent");
        assert!((got.rotation.determinant() - 1.0).abs() < 1e-12 && got.scale > 0.0);
    }

    #[test]
    fn the_fit_is_the_minimum() {
        let source = cloud();
        let target: Vec<_> = (0..source.len())
            .map(|i| {
                some().transform(&source[i])
                    + Vector3::new((i as f64 * 3.1).sin(), 0.2, (i as f64).cos()) * 0.3
            })
            .collect();
        let cost = |s: &Sim3| {
            let errors = source
                .iter()
                .zip(&target)
                .map(|(a, b)| (s.transform(a) - b).norm_squared());
            errors.sum::<f64>()
        };
        let best = Sim3::umeyama(&source, &target).expect("points with extent");
        for k in 0..3 {
            for h in [-1e-3, 1e-3] {
                let mut step = Vector3::zeros();
                step[k] = h;
                let turned = Sim3 {
                    rotation: exp_so3(&step) * best.rotation,
                    ..best
                };
                let moved = Sim3 {
                    translation: best.translation + step,
                    ..best
                };
                let scaled = Sim3 {
                    scale: best.scale * (1.0 + h),
                    ..best
                };
                for other in [turned, moved, scaled] {
                    assert!(cost(&other) > cost(&best));
                }
            }
        }
    }

    #[test]
    fn no_extent_no_fit() {
        let same = vec![Vector3::new(1.0, 2.0, 3.0); 4];
        assert!(Sim3::umeyama(&same, &cloud()[..4]).is_none());
        assert!(Sim3::umeyama(&cloud(), &cloud()[..4]).is_none());
        let mut broken = cloud();
        broken[2].y = f64::NAN;
        assert!(Sim3::umeyama(&broken, &cloud()).is_none());
    }

    #[test]
    fn inverse_and_poses_agree_with_points() {
        let (s, x) = (some(), Vector3::new(0.3, -2.0, 1.0));
        assert!((s.inverse().transform(&s.transform(&x)) - x).norm() < 1e-12);
        let pose = Se3 {
            rotation: exp_so3(&Vector3::new(0.1, 0.9, -0.3)),
            translation: Vector3::new(1.0, 0.0, 2.0),
        };
        // A point at camera coordinates c is seen at s.scale * c after the similarity.
        let (c, moved) = (Vector3::new(0.2, 0.1, 4.0), s.transform_pose(&pose));
        assert!(
            (moved.transform(&(c * s.scale)) - s.transform(&pose.transform(&c))).norm() < 1e-12
        );
    }
}
