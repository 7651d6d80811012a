//! Geometry that the user provides: intrinsics, poses, masks, depth; read, checked against the
//! clip, and hashed.

mod cameras;

use super::GeometryOptions;
use crate::{Category, Error, Refusal, Settings, hash};
use m4_core::{Camera, DepthMap, Mask, Plane, Video};
use m4_geometry::clip_depth::ClipDepth;
use m4_io::dataset::Lens;
use m4_io::image::{read_depth, read_mask, read_rgb};
use m4_io::video::image_files;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

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
    /// Of `options`; fails with the file that is missing or cannot be read.
    pub(super) fn of(options: &GeometryOptions) -> Result<Self, Error> {
        let of = |what: &'static str, path: Option<&Path>| -> Result<Option<String>, Error> {
            let Some(path) = path else { return Ok(None) };
            if !path.exists() {
                let message = format!(
                    "there is nothing at {}, which was given as {what}",
                    path.display()
                );
                return Err(Refusal::new(Category::NoInput, message).into());
            }
            hash::of_path(path).map(Some)
        };
        let lens_file = options
            .intrinsics
            .as_deref()
            .filter(|text| cameras::numbers(text).is_none());
        Ok(Self {
            intrinsics: of("intrinsics", lens_file.map(Path::new))?,
            poses: of("poses", options.poses.as_deref())?,
            masks: of("masks", options.masks.as_deref())?,
            depth: of("depth", options.depth.as_deref())?,
        })
    }
}

/// What was given, for every frame of the clip.
#[derive(Debug, Default)]
pub(super) struct Given {
    /// The lens for frames of this clip's size.
    pub lens: Option<Lens>,
    /// A camera a frame.
    pub cameras: Option<Vec<Camera>>,
    /// A mask per frame, 255 where something moves.
    pub masks: Option<Vec<Mask>>,
    /// Depth a frame.
    pub depth: Option<ClipDepth>,
}

impl Given {
    /// Reads what `options` name for the clip `video` that came from `input`; `focal_px` of the
    /// frames where it is known otherwise. Fails with the name of a file that is missing, damaged,
    /// or does not fit the clip.
    pub(super) fn read(input: &Path, video: &Video, settings: &Settings) -> Result<Self, Error> {
        let options = &settings.geometry;
        if !options.any_given() {
            return Ok(Self::default());
        }
        let clip = ClipFiles::of(input, video, settings.video.folder_fps)?;
        let lens = options.intrinsics.as_deref();
        let lens = lens
            .map(|text| cameras::lens(text, clip.size))
            .transpose()?;
        let cameras = options
            .poses
            .as_ref()
            .map(|path| cameras::poses(path, &clip, lens.map(|lens| lens.intrinsics)))
            .transpose()?;
        let masks = options
            .masks
            .as_ref()
            .map(|folder| each(&clip, "masks", folder, mask))
            .transpose()?;
        let depth =
            |path: &Path| -> Result<DepthMap, Error> { Ok(read_depth(path, DEPTH_UNIT)?.to_map()) };
        let depth = options
            .depth
            .as_ref()
            .map(|folder| each(&clip, "depth maps", folder, depth))
            .transpose()?;
        if let (Some(depth), Some(path)) = (&depth, &options.depth)
            && !depth.iter().flat_map(|d| d.data()).any(|&z| z > 0.0)
        {
            let message = format!(
                "the depth maps in {} are 0 (unknown) everywhere",
                path.display()
            );
            return Err(Refusal::bad_input(message).into());
        }
        Ok(Self {
            lens,
            cameras,
            masks,
            depth: depth.map(ClipDepth::given),
        })
    }

    /// Names of what was given, for the record.
    pub(super) fn names(&self) -> Vec<String> {
        let inputs = [
            ("intrinsics", self.lens.is_some()),
            ("poses", self.cameras.is_some()),
            ("masks", self.masks.is_some()),
            ("depth", self.depth.is_some()),
        ];
        inputs
            .iter()
            .filter(|(_, is)| *is)
            .map(|(name, _)| (*name).to_owned())
            .collect()
    }
}

/// Reads the file of every frame.
fn each<T: Send>(
    clip: &ClipFiles,
    what: &'static str,
    folder: &Path,
    read: impl Fn(&Path) -> Result<Plane<T>, Error> + Sync,
) -> Result<Vec<Plane<T>>, Error> {
    let files = clip.files(what, folder)?;
    let one = |path: &PathBuf| {
        let value = read(path)?;
        if !same_shape(value.size(), clip.size) {
            return Err(other_shape(path, value.size(), clip.size).into());
        }
        Ok(value)
    };
    // The first in order that fails is the one that is named, whatever the number of threads.
    let all: Vec<Result<Plane<T>, Error>> = files.par_iter().map(one).collect();
    all.into_iter().collect()
}

/// The refusal of an image of another shape than the frames.
fn other_shape(path: &Path, size: (usize, usize), frame: (usize, usize)) -> Refusal {
    Refusal::bad_input(format!(
        "{} is {} x {} pixels and the frames are {} x {}: the aspect ratios differ",
        path.display(),
        size.0,
        size.1,
        frame.0,
        frame.1
    ))
}

/// True where both are the same image at some size.
fn same_shape(a: (usize, usize), b: (usize, usize)) -> bool {
    let ratio = |(w, h): (usize, usize)| w as f64 / h.max(1) as f64;
    a.0 > 0 && a.1 > 0 && (ratio(a) / ratio(b) - 1.0).abs() < 0.01
}

/// A mask: whatever is not black; in a JPEG file, which has no pure black, whatever is light.
fn mask(path: &Path) -> Result<Mask, Error> {
    let jpeg = path
        .extension()
        .is_some_and(|e| !e.eq_ignore_ascii_case("png"));
    if jpeg {
        return Ok(read_mask(path)?.to_mask());
    }
    Ok(read_rgb(path)?.map(|rgb| if rgb.iter().any(|&v| v > 0) { 255 } else { 0 }))
}

/// A clip as far as files are to be found for its frames.
pub struct ClipFiles {
    /// Number of frames.
    pub frames: usize,
    /// Their width and height.
    pub size: (usize, usize),
    /// Of a folder: all its images, and which of them the frames are.
    source: Option<(Vec<PathBuf>, Vec<usize>)>,
}

impl ClipFiles {
    /// Of `video`, which was read from `input`.
    pub fn of(input: &Path, video: &Video, folder_fps: f64) -> Result<Self, Error> {
        let source = if input.is_dir() {
            let index = |time_s: f64| (time_s * folder_fps).round() as usize;
            let chosen = video.frames.iter().map(|f| index(f.time_s)).collect();
            Some((image_files(input)?, chosen))
        } else {
            None
        };
        Ok(Self {
            frames: video.frames.len(),
            size: video.frames.first().map_or((0, 0), |f| f.rgb.size()),
            source,
        })
    }

    /// The file in `folder` for every frame: by the names of the frames where they have names, else
    /// by order.
    pub fn files(&self, what: &'static str, folder: &Path) -> Result<Vec<PathBuf>, Error> {
        if !folder.is_dir() {
            let source =
                std::io::Error::new(std::io::ErrorKind::NotADirectory, "a folder was expected");
            let path = folder.to_path_buf();
            return Err(Error::Read { path, source });
        }
        let files = image_files(folder)?;
        if let Some((all, chosen)) = &self.source {
            let by_name: HashMap<&OsStr, &PathBuf> = files
                .iter()
                .filter_map(|p| Some((p.file_stem()?, p)))
                .collect();
            let named = |&i: &usize| Some((*by_name.get(all.get(i)?.file_stem()?)?).clone());
            if let Some(named) = chosen.iter().map(named).collect::<Option<Vec<_>>>() {
                return Ok(named);
            }
        }
        self.in_order(what, folder, files)
    }

    /// One of `items` per frame, in order: as many as the frames, or as the images that the frames
    /// were chosen from.
    pub fn in_order<T: Clone>(
        &self,
        what: &'static str,
        path: &Path,
        items: Vec<T>,
    ) -> Result<Vec<T>, Error> {
        if items.len() == self.frames {
            return Ok(items);
        }
        if let Some((all, chosen)) = &self.source
            && items.len() == all.len()
            && let Some(chosen) = chosen.iter().map(|&i| items.get(i).cloned()).collect()
        {
            return Ok(chosen);
        }
        Err(Refusal::bad_input(format!(
            "{} has {} {what} for {} frames; give one per frame, in the order or with the names of the frames",
            path.display(),
            items.len(),
            self.frames
        ))
        .into())
    }
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
