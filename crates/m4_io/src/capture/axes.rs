//! The axis convention of cameras in a file.

use m4_core::Se3;
use serde::{Deserialize, Serialize};

/// Axes of a camera-to-world matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axes {
    /// x right, y up, z towards the viewer: nerfstudio, Blender.
    #[default]
    OpenGl,
    /// x right, y down, z forward: COLMAP and this program.
    OpenCv,
}

impl Axes {
    /// A pose in these axes as a pose in OpenCV axes, or back: both ways the camera's y and z turn round.
    #[must_use]
    pub fn to_opencv(self, c2w: &Se3<f64>) -> Se3<f64> {
        let mut turned = *c2w;
        if self == Self::OpenGl {
            turned.rotation.column_mut(1).neg_mut();
            turned.rotation.column_mut(2).neg_mut();
        }
        turned
    }
}

#[cfg(test)]
mod tests {
    use super::Axes;
    use m4_core::{Se3, nalgebra::Vector3};

    #[test]
    fn an_opengl_camera_looks_along_minus_z() {
        let c2w = Axes::OpenGl.to_opencv(&Se3::identity());
        // Forward (OpenCV z) and down (OpenCV y) in the world of an OpenGL camera at rest.
        assert_eq!(c2w.transform(&Vector3::z()), -Vector3::z());
        assert_eq!(c2w.transform(&Vector3::y()), -Vector3::y());
        assert_eq!(c2w.transform(&Vector3::x()), Vector3::x());
        assert!((c2w.rotation.determinant() - 1.0).abs() < 1e-15);
        assert_eq!(Axes::OpenGl.to_opencv(&c2w), Se3::identity());
    }
}
