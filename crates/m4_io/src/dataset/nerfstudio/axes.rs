//! Which axes the cameras of a file have.

use super::{Frame, Transforms};
use crate::pose::Axes;
use m4_core::Progress;

/// The axes by the file, or the keys that it has; see the module.
pub(super) fn axes_of(
    file: &Transforms,
    frames: &[(usize, Frame)],
    progress: &dyn Progress,
) -> Axes {
    if let Some(axes) = file.axes {
        return axes;
    }
    let of_opengl = file.lens.camera_angle_x.is_some()
        || file.lens.camera_model.is_some()
        || file.lens.is_fisheye.is_some()
        || file.applied_transform.is_some()
        || file.orientation_override.is_some()
        || file.aabb_scale.is_some()
        || file.ply_file_path.is_some()
        || frames.iter().any(|(_, frame)| {
            frame.lens.camera_angle_x.is_some() || frame.lens.camera_model.is_some()
        });
    if of_opengl || !frames.iter().all(|(_, frame)| frame.time.is_some()) {
        return Axes::OpenGl;
    }
    progress.warn(
        "transforms.json is laid out as those of Instant4D and does not name its axes; OpenCV axes were assumed (if everything is \
         behind the cameras, they are OpenGL's: add \"camera_model\": \"OPENCV\" to the file, as nerfstudio does)",
    );
    Axes::OpenCv
}
