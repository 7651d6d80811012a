//! Reads intrinsics from the command line or a JSON file, and poses from `transforms.json` of our
//! own captures and of nerfstudio.

use super::{ClipFiles, other_shape, same_shape};
use crate::{Error, Refusal};
use m4_core::{Camera, Intrinsics};
use m4_io::dataset::{Lens, nerfstudio::lens_in};
use m4_io::{files, range, trajectory};
use std::path::Path;

/// Largest file with intrinsics that is read, bytes: `transforms.json` lists every frame besides.
const MAX_LENS_BYTES: u64 = 256 << 20;

/// `fx,fy,cx,cy`; `None` for the name of a file.
pub fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',')
        .map(|part| part.trim().parse().ok())
        .collect()
}

/// Reads the lens for frames of `size`; refuses one that is incomplete, or of images of another
/// shape.
pub fn lens(text: &str, size: (usize, usize)) -> Result<Lens, Error> {
    let bad = |reason: String| {
        Refusal::bad_input(format!(
            "the intrinsics {text:?} cannot be used: {reason}; give fx,fy,cx,cy in pixels of the frames, or a JSON file with \
             fl_x, fl_y, cx, cy, w and h"
        ))
    };
    let lens = match numbers(text) {
        Some(numbers) => match numbers[..] {
            [fx, fy, cx, cy] => Lens::pinhole(Intrinsics {
                width: size.0,
                height: size.1,
                fx,
                fy,
                cx,
                cy,
            }),
            _ => {
                return Err(bad(format!("{} numbers where 4 were expected", numbers.len())).into());
            }
        },
        None => {
            let path = Path::new(text);
            let bytes = files::read(path, MAX_LENS_BYTES).map_err(Error::read(path))?;
            let file = lens_in(files::without_mark(&bytes), size)
                .map_err(|fault| bad(fault.to_string()))?;
            let k = &file.intrinsics;
            if !same_shape((k.width, k.height), size) {
                return Err(bad(format!(
                    "it is of images of {} x {} pixels, another aspect ratio than that of the frames, {} x {}",
                    k.width, k.height, size.0, size.1
                ))
                .into());
            }
            Lens {
                intrinsics: k.resized(size.0, size.1),
                ..file
            }
        }
    };
    let k = &lens.intrinsics;
    if let Some(what) = range::of_lens(k) {
        return Err(bad(what).into());
    }
    let inside = |c: f64, side: usize| c > 0.0 && c < side as f64;
    if !inside(k.cx, size.0) || !inside(k.cy, size.1) {
        return Err(bad(format!(
            "its principal point {}, {} lies outside the frames of {} x {} pixels",
            k.cx, k.cy, size.0, size.1
        ))
        .into());
    }
    Ok(lens)
}

/// A camera per frame. `lens` replaces the lenses of the file. Fails if the file cannot be read or
/// has another number of poses.
pub fn poses(
    path: &Path,
    clip: &ClipFiles,
    lens: Option<Intrinsics>,
) -> Result<Vec<Camera>, Error> {
    let mut cameras = trajectory::read(path, clip.frames)?;
    cameras.sort_by(|a, b| a.1.total_cmp(&b.1));
    let cameras = cameras.into_iter().map(|(camera, _)| camera).collect();
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

#[cfg(test)]
mod tests {
    use super::lens;
    use m4_io::dataset::Distortion;

    #[test]
    fn numbers_are_of_the_frames() {
        let actual = lens("500, 510,310,250", (640, 480)).unwrap();
        assert_eq!(actual.distortion, Distortion::None);
        let actual = actual.intrinsics;
        assert_eq!(
            (actual.fx, actual.fy, actual.cx, actual.cy),
            (500.0, 510.0, 310.0, 250.0)
        );
        for (bad, word) in [
            ("500,510,310", "3 numbers"),
            ("500,510,700,250", "outside"),
            ("-5,510,310,250", "focal"),
            ("nan,510,310,250", "focal"),
            ("no_such_lens.json", "no_such_lens.json"),
        ] {
            let text = lens(bad, (640, 480)).unwrap_err().to_string();
            assert!(text.contains(word), "{text}");
        }
    }

    #[test]
    fn a_file_is_brought_to_the_size_of_the_frames() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("lens.json");
        let write = |text: &str| std::fs::write(&path, text).unwrap();
        let name = path.to_str().unwrap();
        write(r#"{"fl_x": 1000, "fl_y": 1010, "cx": 620, "w": 1280, "h": 960}"#);
        let actual = lens(name, (640, 480)).unwrap().intrinsics;
        assert_eq!(
            (actual.fx, actual.fy, actual.cx, actual.cy),
            (500.0, 505.0, 310.0, 240.0)
        );
        write(
            r#"{"fl_x": 1000, "w": 1280, "h": 960, "camera_model": "OPENCV_FISHEYE", "k1": 0.1}"#,
        );
        let bent = lens(name, (640, 480)).unwrap();
        let k = [0.1, 0.0, 0.0, 0.0];
        assert_eq!(bent.distortion, Distortion::Fisheye { k });
        assert_eq!(bent.intrinsics.fx, 500.0);
        for (text, word) in [
            (r#"{"fl_x": 1000, "k4": 0.1}"#, "k4 = 0.1"),
            (r#"{"fl_x": 1000, "w": -3}"#, "w = -3"),
            (r#"{"fl_x": 1000, "w": 480, "h": 640}"#, "aspect ratio"),
            (r#"{"cx": 3}"#, "fl_x, the focal length"),
            ("[]", "JSON"),
        ] {
            write(text);
            let message = lens(name, (640, 480)).unwrap_err().to_string();
            assert!(
                message.contains(word) && message.contains("lens.json"),
                "{message}"
            );
        }
    }
}
