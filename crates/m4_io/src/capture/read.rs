//! Reads a folder of posed frames as a [`Capture`].

use super::json::{self, Frame, Lens, Transforms};
use super::{CaptureOptions, Pose, ReadCaptureError, Split};
use crate::image::{self, ReadImageError};
use crate::reach::Bounds;
use crate::tracks::{self, ReadTracksError, TracksFault};
use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Progress, Se3, Tracks};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Scene units a step of a depth map when the file does not say: millimetres where the unit is a metre.
const DEFAULT_DEPTH_UNIT: f64 = 1e-3;
/// What eight pixels take, bytes: colour, depth and mask, 3 + 2 + 1/8 a pixel.
const BYTES_PER_8_PIXELS: u64 = 41;

/// Reads a split of a capture: `path` is its folder or one of its JSON files. The layout is that of
/// [the module](super); frames come sorted by time, poses in OpenCV axes.
///
/// What was assumed (missing times) is reported to `progress`.
///
/// # Errors
///
/// [`ReadCaptureError`], which names the file and the frame at fault.
pub fn read(
    path: &Path,
    split: Split,
    options: &CaptureOptions,
    progress: &dyn Progress,
) -> Result<Capture, ReadCaptureError> {
    let path = list_of_frames(path, split);
    let file = json::load(&path)?;
    let reader = Reader::new(path, file, options)?;
    let time_frames = reader.time_frames(split)?;
    let entries = reader.entries(time_frames, split, progress)?;
    reader.check_memory(&entries, options)?;

    let done = AtomicUsize::new(0);
    let total = entries.len();
    let frames: Vec<Result<CaptureFrame, ReadCaptureError>> = entries
        .par_iter()
        .map(|entry| {
            if progress.cancelled() {
                return Err(ReadCaptureError::Cancelled {
                    path: reader.path.clone(),
                });
            }
            let frame = reader.load(entry);
            progress.update("read frames", done.fetch_add(1, Ordering::Relaxed) + 1, total, "");
            frame
        })
        .collect();
    let frames = frames.into_iter().collect::<Result<Vec<_>, _>>()?;
    let tracks = reader.tracks(&entries, options)?;
    Ok(Capture {
        frames,
        time_frames,
        duration_s: reader.file.duration_s,
        metric: reader.file.metric,
        tracks,
    })
}

/// The JSON file that `path` stands for.
fn list_of_frames(path: &Path, split: Split) -> PathBuf {
    if !path.is_dir() {
        return path.to_path_buf();
    }
    let named = path.join(split.file_name());
    let lone = path.join("transforms.json");
    if split == Split::Train && !named.exists() && lone.exists() {
        lone
    } else {
        named
    }
}

/// A frame whose keys were checked but whose images are still on disk.
struct Entry {
    index: usize,
    name: String,
    picture: PathBuf,
    depth: Option<PathBuf>,
    mask: Option<PathBuf>,
    motion: Option<PathBuf>,
    instances: Option<PathBuf>,
    lens: Lens,
    c2w: Se3<f64>,
    /// 0..1.
    time: f64,
    t: f64,
    camera_index: Option<u32>,
}

struct Reader {
    path: PathBuf,
    folder: PathBuf,
    file: Transforms,
    depth_unit: f64,
    bounds: Bounds,
}

impl Reader {
    fn new(path: PathBuf, file: Transforms, options: &CaptureOptions) -> Result<Self, ReadCaptureError> {
        let bad = |key, value: String, expected| ReadCaptureError::BadKey {
            path: path.clone(),
            key,
            value,
            expected,
        };
        if file.frames.is_empty() {
            return Err(ReadCaptureError::NoFrames { path });
        }
        let depth_unit = file.depth_unit_scale_factor.unwrap_or(DEFAULT_DEPTH_UNIT);
        if !(depth_unit.is_finite() && depth_unit > 0.0) {
            let expected = "scene units a step of the depth maps, above 0, were expected";
            return Err(bad("depth_unit_scale_factor", depth_unit.to_string(), expected));
        }
        if let Some(s) = file.duration_s.filter(|s| !s.is_finite() || *s < 0.0) {
            let expected = "seconds from the first to the last frame, not below 0, were expected";
            return Err(bad("duration_s", s.to_string(), expected));
        }
        if let Some(model) = &file.camera_model
            && !["OPENCV", "PINHOLE", "SIMPLE_PINHOLE"].contains(&model.as_str())
        {
            let expected = "only pinhole cameras (OPENCV or PINHOLE without distortion) are read; undistort the images";
            return Err(bad("camera_model", format!("{model:?}"), expected));
        }
        let folder = path.parent().map(Path::to_path_buf).unwrap_or_default();
        Ok(Self {
            bounds: Bounds::new(options.reach, &folder, []),
            folder,
            path,
            file,
            depth_unit,
        })
    }

    /// How many frames `time` = 0..1 spans.
    fn time_frames(&self, split: Split) -> Result<usize, ReadCaptureError> {
        if split == Split::Train {
            return Ok(self.file.frames.len());
        }
        for name in [Split::Train.file_name(), "transforms.json"] {
            let training = self.folder.join(name);
            if training != self.path && training.is_file() {
                return Ok(json::load(&training)?.frames.len());
            }
        }
        self.file
            .time_frames
            .filter(|&n| n > 0)
            .ok_or_else(|| ReadCaptureError::NoTrainingSplit {
                path: self.path.clone(),
            })
    }

    /// The frames in order of time, all keys checked.
    fn entries(
        &self,
        time_frames: usize,
        split: Split,
        progress: &dyn Progress,
    ) -> Result<Vec<Entry>, ReadCaptureError> {
        let n = self.file.frames.len();
        let mut without_time = 0;
        let mut entries = Vec::with_capacity(n);
        for (index, value) in self.file.frames.iter().enumerate() {
            let raw_name = value.get("file_path").and_then(|v| v.as_str()).unwrap_or_default();
            let frame: Frame =
                serde_json::from_value(value.clone()).map_err(|e| self.bad(index, raw_name, e.to_string()))?;
            let name = frame.file_path.clone().unwrap_or_default();
            let fault = |what: String| self.bad(index, &name, what);
            if name.is_empty() {
                return Err(fault("file_path is missing".into()));
            }
            let rows = frame
                .transform_matrix
                .as_deref()
                .ok_or_else(|| fault("transform_matrix is missing".into()))?;
            let Pose(pose) =
                Pose::from_rows(rows).map_err(|e| ReadCaptureError::pose(self.path.clone(), index, &name, &e))?;
            let time = match frame.time {
                Some(time) => time,
                None if split == Split::Test => {
                    return Err(fault("time is missing; a test view needs its moment, 0 to 1".into()));
                }
                None => {
                    without_time += 1;
                    index as f64 / (n.max(2) - 1) as f64
                }
            };
            if !(0.0..=1.0).contains(&time) {
                let what = format!("time = {time}; 0 (first training frame) to 1 (last) was expected");
                return Err(fault(what));
            }
            let lens = frame.lens.or(&self.file.lens);
            if let Some((key, value)) = lens.distortion() {
                return Err(ReadCaptureError::Distorted {
                    path: self.path.clone(),
                    key,
                    value,
                });
            }
            let place = |key: &str| format!("frame {index} ({name:?}), {key}");
            let inside = |file: PathBuf, key| self.inside(file, || place(key));
            let beside = |file: Option<String>, key| file.map(|p| inside(self.folder.join(p), key)).transpose();
            entries.push(Entry {
                index,
                picture: inside(self.picture(&name), "file_path")?,
                depth: beside(frame.depth_file_path, "depth_file_path")?,
                mask: beside(frame.mask_path, "mask_path")?,
                motion: beside(frame.motion_path, "motion_path")?,
                instances: beside(frame.instance_path, "instance_path")?,
                name,
                lens,
                c2w: self.file.axes.to_opencv(&pose),
                time,
                t: time * (time_frames.max(1) - 1) as f64,
                camera_index: frame.camera,
            });
        }
        if without_time > 0 {
            progress.warn(&format!(
                "{without_time} of {n} frames of {} have no time; frames are taken as evenly spaced in the order of the file",
                self.path.display()
            ));
        }
        entries.sort_by(|a, b| a.time.total_cmp(&b.time));
        Ok(entries)
    }

    /// The tracks, their frames in the order of `entries`.
    fn tracks(&self, entries: &[Entry], options: &CaptureOptions) -> Result<Option<Tracks>, ReadCaptureError> {
        let Some(name) = &self.file.tracks_path else {
            return Ok(None);
        };
        let failed = |source| ReadCaptureError::Tracks {
            list: self.path.clone(),
            source,
        };
        let path = self.inside(self.folder.join(name), || "tracks_path".to_owned())?;
        let tracks = tracks::read(&path, entries.len(), options.max_memory_bytes).map_err(failed)?;
        let order: Vec<usize> = entries.iter().map(|e| e.index).collect();
        if order.is_sorted() {
            return Ok(Some(tracks));
        }
        let sorted = tracks.in_order(&order).map_err(|e| {
            let fault = TracksFault::Archive(e.to_string());
            failed(ReadTracksError { path, fault })
        });
        sorted.map(Some)
    }

    /// The file, if it may be read; `place` is who names it.
    fn inside(&self, file: PathBuf, place: impl FnOnce() -> String) -> Result<PathBuf, ReadCaptureError> {
        match self.bounds.check(&file) {
            Ok(()) => Ok(file),
            Err(source) => Err(ReadCaptureError::Outside {
                path: self.path.clone(),
                place: place(),
                source,
            }),
        }
    }

    /// The image's file; the synthetic NeRF scenes leave the extension away.
    fn picture(&self, name: &str) -> PathBuf {
        let path = self.folder.join(name);
        if path.extension().is_none() {
            let found = ["png", "jpg", "jpeg"]
                .iter()
                .map(|e| path.with_extension(e))
                .find(|p| p.is_file());
            return found.unwrap_or(path);
        }
        path
    }

    /// Refuses before the first image is decoded.
    fn check_memory(&self, entries: &[Entry], options: &CaptureOptions) -> Result<(), ReadCaptureError> {
        let Some(first) = entries.first() else { return Ok(()) };
        let size = image::size(&first.picture).map_err(|e| self.image(first, e))?;
        let needed_bytes = (size.0 as u64 * size.1 as u64)
            .saturating_mul(BYTES_PER_8_PIXELS)
            .saturating_mul(entries.len() as u64)
            .div_ceil(8);
        if needed_bytes > options.max_memory_bytes {
            return Err(ReadCaptureError::TooLarge {
                path: self.path.clone(),
                frames: entries.len(),
                size,
                needed_bytes,
                limit_bytes: options.max_memory_bytes,
            });
        }
        Ok(())
    }

    fn load(&self, entry: &Entry) -> Result<CaptureFrame, ReadCaptureError> {
        let size = image::size(&entry.picture).map_err(|e| self.image(entry, e))?;
        let intrinsics = self.intrinsics(entry, size)?;
        let read = |e| self.image(entry, e);
        Ok(CaptureFrame {
            name: entry.name.clone(),
            camera: Camera {
                intrinsics,
                c2w: entry.c2w,
            },
            t: entry.t,
            rgb: image::read_rgb(&entry.picture).map_err(read)?,
            depth: match &entry.depth {
                Some(path) => Some(image::read_depth(path, self.depth_unit).map_err(read)?),
                None => None,
            },
            mask: match &entry.mask {
                Some(path) => Some(image::read_mask(path).map_err(read)?),
                None => None,
            },
            motion: match &entry.motion {
                Some(path) => Some(image::read_grey(path).map_err(read)?),
                None => None,
            },
            instances: match &entry.instances {
                Some(path) => Some(image::read_ids(path).map_err(read)?),
                None => None,
            },
            camera_index: entry.camera_index,
        })
    }

    fn intrinsics(&self, entry: &Entry, found: (usize, usize)) -> Result<Intrinsics, ReadCaptureError> {
        let lens = &entry.lens;
        let fault = |what: String| self.bad(entry.index, &entry.name, what);
        let expected = (lens.w.unwrap_or(found.0 as f64), lens.h.unwrap_or(found.1 as f64));
        if expected != (found.0 as f64, found.1 as f64) {
            return Err(ReadCaptureError::ImageSize {
                path: self.path.clone(),
                frame: entry.index,
                image: entry.picture.clone(),
                expected: (expected.0 as usize, expected.1 as usize),
                found,
            });
        }
        lens.intrinsics(found).map_err(fault)
    }

    fn bad(&self, frame: usize, name: &str, what: String) -> ReadCaptureError {
        ReadCaptureError::BadFrame {
            path: self.path.clone(),
            frame,
            name: name.to_owned(),
            what,
        }
    }

    fn image(&self, entry: &Entry, source: ReadImageError) -> ReadCaptureError {
        ReadCaptureError::Image {
            path: self.path.clone(),
            frame: entry.index,
            source,
        }
    }
}
