//! Reads intrinsics from the command line or a JSON file, and poses from `transforms.json` of our
//! own captures and of nerfstudio.

use super::{ClipFiles, other_shape, same_shape};
use crate::{Error, Refusal};
use m4_core::{Camera, Intrinsics};
use m4_io::{files, range, trajectory};
use serde::Deserialize;
use std::path::Path;

/// Largest file with intrinsics that is read, bytes: `transforms.json` lists every frame besides.
const MAX_LENS_BYTES: u64 = 256 << 20;

/// The keys of `transforms.json` that are read.
#[derive(Deserialize)]
struct File {
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// `fx,fy,cx,cy`; `None` for the name of a file.
pub fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',')
        .map(|part| part.trim().parse().ok())
        .collect()
}

/// The lens for frames of `size`; refused if it is incomplete, distorted, or of images of another
/// shape.
pub fn lens(text: &str, size: (usize, usize)) -> Result<Intrinsics, Error> {
    let bad = |reason: String| {
        Refusal::bad_input(format!(
            "the intrinsics {text:?} cannot be used: {reason}; give fx,fy,cx,cy in pixels of the frames, or a JSON file with \
             fl_x, fl_y, cx, cy, w and h"
        ))
    };
    let lens = match numbers(text) {
        Some(numbers) => match numbers[..] {
            [fx, fy, cx, cy] => Intrinsics {
                width: size.0,
                height: size.1,
                fx,
                fy,
                cx,
                cy,
            },
            _ => {
                return Err(bad(format!("{} numbers where 4 were expected", numbers.len())).into());
            }
        },
        None => {
            let bytes = files::read(Path::new(text), MAX_LENS_BYTES)
                .map_err(Error::read(Path::new(text)))?;
            let file: File = serde_json::from_slice(files::without_mark(&bytes))
                .map_err(|e| bad(format!("it is not such JSON ({e})")))?;
            of_file(&file, size).map_err(bad)?
        }
    };
    if let Some(what) = range::of_lens(&lens) {
        return Err(bad(what).into());
    }
    let inside = |c: f64, side: usize| c > 0.0 && c < side as f64;
    if !inside(lens.cx, size.0) || !inside(lens.cy, size.1) {
        return Err(bad(format!(
            "its principal point {}, {} lies outside the frames of {} x {} pixels",
            lens.cx, lens.cy, size.0, size.1
        ))
        .into());
    }
    Ok(lens)
}

fn of_file(file: &File, size: (usize, usize)) -> Result<Intrinsics, String> {
    let bent = [file.k1, file.k2, file.k3, file.k4, file.p1, file.p2];
    if bent.into_iter().flatten().any(|k| k != 0.0) {
        return Err("it has distortion; undistort the frames first".to_owned());
    }
    let fx = file.fl_x.ok_or("fl_x is missing")?;
    let side = |value: Option<f64>, frame: usize| match value {
        Some(side) if (1.0..=65_536.0).contains(&side) => Ok(side as usize),
        Some(side) => Err(format!("a side of {side} pixels")),
        None => Ok(frame),
    };
    let (width, height) = (side(file.w, size.0)?, side(file.h, size.1)?);
    if !same_shape((width, height), size) {
        return Err(format!(
            "it is of images of {width} x {height} pixels, another aspect ratio than that of the frames, {} x {}",
            size.0, size.1
        ));
    }
    let lens = Intrinsics {
        width,
        height,
        fx,
        fy: file.fl_y.unwrap_or(fx),
        cx: file.cx.unwrap_or(width as f64 / 2.0),
        cy: file.cy.unwrap_or(height as f64 / 2.0),
    };
    Ok(lens.resized(size.0, size.1))
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

    #[test]
    fn numbers_are_of_the_frames() {
        let actual = lens("500, 510,310,250", (640, 480)).unwrap();
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
        let actual = lens(name, (640, 480)).unwrap();
        assert_eq!(
            (actual.fx, actual.fy, actual.cx, actual.cy),
            (500.0, 505.0, 310.0, 240.0)
        );
        for (text, word) in [
            (r#"{"fl_x": 1000, "k1": 0.1}"#, "distortion"),
            (r#"{"fl_x": 1000, "w": 480, "h": 640}"#, "aspect ratio"),
            (r#"{"cx": 3}"#, "fl_x is missing"),
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
