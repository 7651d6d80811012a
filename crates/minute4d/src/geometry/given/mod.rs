//! Geometry that the user provides: intrinsics, poses, masks, depth; read, checked against the clip, and hashed.

mod error;
mod files;
mod lens;
mod poses;

pub use error::GivenError;

use super::GeometryOptions;
use crate::{Error, hash};
use files::Clip;
use m4_core::{Camera, DepthMap, Intrinsics, Mask, Plane, Video};
use m4_io::image::{read_depth, read_mask, read_rgb};
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;

/// Metres a step of a depth map.
const DEPTH_UNIT: f64 = 0.001;

/// Hashes of the files that were given: a part of the key of the stage.
#[derive(Debug, Default, Serialize)]
pub(super) struct Sources {
    #[serde(skip_serializing_if = "Option::is_none")]
    intrinsics: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    poses: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    masks: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<String>,
}

impl Sources {
    /// Of `options`.
    ///
    /// # Errors
    ///
    /// [`Error`] naming the option and the file that is missing or cannot be read.
    pub(super) fn of(options: &GeometryOptions) -> Result<Self, Error> {
        let of = |option: &'static str, path: Option<&Path>| -> Result<Option<String>, Error> {
            let Some(path) = path else { return Ok(None) };
            if !path.exists() {
                let path = path.to_path_buf();
                return Err(GivenError::Missing { option, path }.into());
            }
            hash::of_path(path).map(Some)
        };
        let lens_file = options
            .intrinsics
            .as_deref()
            .filter(|text| lens::numbers(text).is_none());
        Ok(Self {
            intrinsics: of("--intrinsics", lens_file.map(Path::new))?,
            poses: of("--poses", options.poses.as_deref())?,
            masks: of("--masks", options.masks.as_deref())?,
            depth: of("--depth", options.depth.as_deref())?,
        })
    }
}

/// What was given, for every frame of the clip.
#[derive(Debug, Default)]
pub(super) struct Given {
    /// The lens for frames of this clip's size.
    pub lens: Option<Intrinsics>,
    /// A camera a frame.
    pub cameras: Option<Vec<Camera>>,
    /// A mask per frame, 255 where something moves.
    pub masks: Option<Vec<Mask>>,
    /// Depth a frame, metres, 0 where unknown.
    pub depth: Option<Vec<DepthMap>>,
}

impl Given {
    /// Reads what `options` name for the clip `video` that came from `input`; `focal_px` of the frames where it is known
    /// otherwise.
    ///
    /// # Errors
    ///
    /// [`Error`] naming the file that is missing, damaged, or does not fit the clip.
    pub(super) fn read(
        options: &GeometryOptions,
        input: &Path,
        video: &Video,
        folder_fps: f64,
        focal_px: Option<f64>,
    ) -> Result<Self, Error> {
        if !options.any_given() {
            return Ok(Self::default());
        }
        let clip = Clip::of(input, video, folder_fps)?;
        let lens = options.intrinsics.as_deref();
        let lens = lens.map(|given| lens::read(given, clip.size)).transpose()?;
        let known = lens.or_else(|| focal_px.map(|f| Intrinsics::centred(clip.size.0, clip.size.1, f)));
        let cameras = match &options.poses {
            Some(path) => Some(poses::read(path, &clip, lens, known)?),
            None => None,
        };
        let masks = match &options.masks {
            Some(folder) => Some(each(&clip, "masks", folder, mask, |m: &Mask| m.size())?),
            None => None,
        };
        let depth = match &options.depth {
            Some(folder) => Some(each(&clip, "depth maps", folder, depth, |d: &DepthMap| d.size())?),
            None => None,
        };
        if let (Some(depth), Some(path)) = (&depth, &options.depth)
            && !depth.iter().flat_map(|d| d.data()).any(|&z| z > 0.0)
        {
            let path = path.clone();
            return Err(GivenError::NoDepth { path }.into());
        }
        Ok(Self {
            lens,
            cameras,
            masks,
            depth,
        })
    }

    /// Names of what was given, for the record.
    pub(super) fn names(&self) -> Vec<String> {
        let given = [
            ("intrinsics", self.lens.is_some()),
            ("poses", self.cameras.is_some()),
            ("masks", self.masks.is_some()),
            ("depth", self.depth.is_some()),
        ];
        given
            .iter()
            .filter(|(_, is)| *is)
            .map(|(name, _)| (*name).to_owned())
            .collect()
    }
}

/// Reads the file of every frame.
fn each<T: Send>(
    clip: &Clip,
    what: &'static str,
    folder: &Path,
    read: impl Fn(&Path) -> Result<T, Error> + Sync,
    size: impl Fn(&T) -> (usize, usize) + Sync,
) -> Result<Vec<T>, Error> {
    let files = clip.files(what, folder)?;
    let one = |path: &std::path::PathBuf| {
        let value = read(path)?;
        let found = size(&value);
        if !same_shape(found, clip.size) {
            let (path, frame) = (path.clone(), clip.size);
            return Err(GivenError::Size { path, found, frame }.into());
        }
        Ok(value)
    };
    // The first in order that fails is the one that is named, whatever the number of threads.
    let all: Vec<Result<T, Error>> = files.par_iter().map(one).collect();
    all.into_iter().collect()
}

/// True where both are the same image at some size.
fn same_shape(a: (usize, usize), b: (usize, usize)) -> bool {
    let ratio = |(w, h): (usize, usize)| w as f64 / h.max(1) as f64;
    a.0 > 0 && a.1 > 0 && (ratio(a) / ratio(b) - 1.0).abs() < 0.01
}

/// A mask: whatever is not black; in a JPEG file, which has no pure black, whatever is light.
fn mask(path: &Path) -> Result<Mask, Error> {
    let jpeg = path.extension().is_some_and(|e| !e.eq_ignore_ascii_case("png"));
    if jpeg {
        return Ok(read_mask(path)?.to_mask());
    }
    Ok(read_rgb(path)?.map(|rgb| if rgb.iter().any(|&v| v > 0) { 255 } else { 0 }))
}

fn depth(path: &Path) -> Result<DepthMap, Error> {
    let map: Plane<f32> = read_depth(path, DEPTH_UNIT)?.to_map();
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::same_shape;

    #[test]
    fn shapes_may_differ_by_rounding_alone() {
        assert!(same_shape((480, 360), (480, 360)) && same_shape((640, 360), (1920, 1080)));
        assert!(same_shape((427, 240), (854, 480)));
        assert!(!same_shape((480, 360), (360, 480)) && !same_shape((640, 480), (640, 360)));
        assert!(!same_shape((0, 0), (4, 3)));
    }
}
