//! Reads poses: `transforms.json` of our own captures and of nerfstudio, or a trajectory in the format of the TUM benchmark.

use super::{Clip, other_shape, same_shape};
use crate::{Error, Refusal};
use m4_core::{Camera, Intrinsics, Se3};
use m4_io::trajectory;
use std::fs;
use std::path::Path;

/// A camera a frame. `lens` replaces the lenses of the file; `known` is used where the file has none.
///
/// # Errors
///
/// [`Error`] naming the file if it cannot be read, has another number of poses, or there is no lens.
pub fn read(
    path: &Path,
    clip: &Clip,
    lens: Option<Intrinsics>,
    known: Option<Intrinsics>,
) -> Result<Vec<Camera>, Error> {
    let json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    let cameras = if json {
        let mut cameras = trajectory::read(path, clip.frames)?;
        cameras.sort_by(|a, b| a.1.total_cmp(&b.1));
        cameras.into_iter().map(|(camera, _)| camera).collect()
    } else {
        let text = fs::read_to_string(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
        let bad = |(line, what): (usize, String)| {
            Refusal::bad_input(format!(
                "{}, line {line}: {what}; each line is `t tx ty tz qx qy qz qw`, camera to world",
                path.display()
            ))
        };
        let poses = trajectory_lines(&text).map_err(bad)?;
        let Some(intrinsics) = known else {
            return Err(Refusal::bad_input(format!(
                "{} has poses without intrinsics; give --intrinsics, or --fov with the horizontal field of view",
                path.display()
            ))
            .into());
        };
        poses.into_iter().map(|c2w| Camera { intrinsics, c2w }).collect()
    };
    let mut cameras = clip.in_order("poses", path, cameras)?;
    for camera in &mut cameras {
        let k = &camera.intrinsics;
        if lens.is_none() && !same_shape((k.width, k.height), clip.size) {
            return Err(other_shape(path, (k.width, k.height), clip.size).into());
        }
        camera.intrinsics = lens.unwrap_or_else(|| k.resized(clip.size.0, clip.size.1));
    }
    Ok(cameras)
}

/// Lines `t tx ty tz qx qy qz qw` in order of time; empty ones and those that begin with `#` are skipped.
fn trajectory_lines(text: &str) -> Result<Vec<Se3<f64>>, (usize, String)> {
    let mut poses = Vec::new();
    let mut last = f64::NEG_INFINITY;
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let bad = |what: String| (i + 1, what);
        let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
        let numbers = numbers.map_err(|e| bad(format!("{e}")))?;
        let [t, pose @ ..] = numbers.as_slice() else {
            return Err(bad("no number".to_owned()));
        };
        let pose: [f64; 7] =
            pose.try_into().map_err(|_| bad(format!("{} numbers where 8 were expected", numbers.len())))?;
        if !numbers.iter().all(|v| v.is_finite()) {
            return Err(bad("a number is not finite".to_owned()));
        }
        if *t <= last {
            return Err(bad(format!("its time {t} is not after {last}, that of the line before")));
        }
        last = *t;
        let norm = pose[3..].iter().map(|q| q * q).sum::<f64>().sqrt();
        if (norm - 1.0).abs() > 0.01 {
            return Err(bad(format!("its quaternion has the length {norm:.3} instead of 1")));
        }
        let mut unit = pose;
        for q in &mut unit[3..] {
            *q /= norm;
        }
        poses.push(Se3::from_translation_quaternion(&unit));
    }
    Ok(poses)
}

#[cfg(test)]
mod tests {
    use super::trajectory_lines;
    use m4_core::nalgebra::Vector3;

    #[test]
    fn lines_are_poses_from_camera_to_world() {
        let half = 0.5_f64.sqrt();
        let text = format!("# t tx ty tz qx qy qz qw\n\n0 0 0 0 0 0 0 1\n0.1 1 2 3 0 {half} 0 {half}\n");
        let poses = trajectory_lines(&text).unwrap();
        // a quarter turn about y takes z to x
        let ahead = poses[1].transform(&Vector3::new(0.0, 0.0, 1.0));
        assert_eq!(poses.len(), 2);
        assert!((ahead - Vector3::new(2.0, 2.0, 3.0)).norm() < 1e-12, "{ahead}");
    }

    #[test]
    fn malformed_pose_files_are_rejected_with_the_line() {
        for (text, line, word) in [
            ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 1", 2, "7 numbers"),
            ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", 2, "not after"),
            ("0 0 0 0 0 0 0 2", 1, "length 2.000"),
            ("0 0 x 0 0 0 0 1", 1, "invalid"),
            ("0 0 inf 0 0 0 0 1", 1, "finite"),
        ] {
            let (at, what) = trajectory_lines(text).unwrap_err();
            assert!(at == line && what.contains(word), "{text:?}: {at} {what}");
        }
    }
}
