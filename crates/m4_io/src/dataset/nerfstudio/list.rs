//! Converts the entries of the file to frames.

use super::json::{Frame, Transforms};
use super::{axes, lens};
use crate::capture::Axes;
use crate::dataset::files::{Inside, clock, json, pictures, pose};
use crate::dataset::side::depth;
use crate::dataset::{FrameSource, ImportOptions, ListedFrame, Listing, ReadSourceError, SourceFault};
use crate::image;
use crate::tracks::{self, TracksFault};
use crate::video::natural;
use m4_core::{CompactMask, Progress, Se3};
use std::path::{Path, PathBuf};

/// Whether it is `transforms*.json`, or a folder with one.
pub fn detect(path: &Path) -> bool {
    files(path).is_some()
}

/// The lists of training frames and of held-out views.
fn files(path: &Path) -> Option<(PathBuf, Option<PathBuf>)> {
    if path.is_file() {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        let fits = name.starts_with("transforms") && name.ends_with(".json");
        let test = path.with_file_name("transforms_test.json");
        let test = (name == "transforms_train.json" && test.is_file()).then_some(test);
        return fits.then(|| (path.to_path_buf(), test));
    }
    let file = |name: &str| Some(path.join(name)).filter(|file| file.is_file());
    match file("transforms_train.json") {
        Some(train) => Some((
            train,
            file("transforms_test.json").or_else(|| file("transforms_val.json")),
        )),
        None => Some((file("transforms.json")?, file("transforms_test.json"))),
    }
}

pub fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    clock::fps(options).map_err(|fault| fault.at(path))?;
    let (train_file, test_file) = files(path).ok_or_else(|| {
        let remedy = "give it or the folder that it is in";
        SourceFault::missing("transforms.json or transforms_train.json", remedy).at(path)
    })?;
    let mut train = Split::read(&train_file, options, progress)?;
    let mut test = Vec::new();
    if let Some(names) = train.held_out() {
        test = train.take(&names);
    }
    let time_frames = train.entries.len();
    if time_frames == 0 {
        return Err(SourceFault::missing("every frame", "give a file with frames").at(&train_file));
    }
    let frames = train.frames(time_frames, false, options)?;
    let mut test = train.of_entries(&test, time_frames, true, options)?;
    if let Some(file) = test_file {
        let split = Split::read(&file, options, progress)?;
        if !split.timed {
            progress.warn("the held-out views have no time; they were spread evenly over the clip, which is correct only for a static scene");
        }
        test.extend(split.frames(time_frames, true, options)?);
    }
    let tracks = match &train.file.tracks_path {
        Some(name) => Some(train.tracks(name, frames.len(), options)?),
        None => None,
    };
    let duration_s = match train.file.duration_s {
        Some(s) if options.fps.is_none() && s.is_finite() && s >= 0.0 => Some(s),
        Some(s) if options.fps.is_none() => {
            let what = format!("it is {s}");
            return Err(SourceFault::bad(what, "write seconds, not below 0").within(&train_file, "duration_s"));
        }
        _ => clock::duration_s(time_frames, options, progress),
    };
    Ok(Listing {
        train: frames,
        test,
        time_frames,
        duration_s,
        metric: train.file.metric == Some(true),
        tracks,
    })
}

/// A file and its frames in order of time.
struct Split {
    path: PathBuf,
    folder: PathBuf,
    file: Transforms,
    entries: Vec<Frame>,
    inside: Inside,
    axes: Axes,
    depth_unit: f64,
    /// Masks are 0 where things move.
    moving_is_zero: bool,
    /// From the world of the file to that of the tool: what was applied, undone.
    undo: Option<Se3<f64>>,
    undo_scale: f64,
    /// The frames say when they were taken.
    timed: bool,
}

impl Split {
    fn read(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Self, ReadSourceError> {
        let mut file: Transforms = json(path)?;
        let bad = |key: &str, what: String, remedy: &str| SourceFault::bad(what, remedy).within(path, key.to_owned());
        let values = file.frames.take().unwrap_or_default();
        let mut entries = Vec::with_capacity(values.len());
        for (i, value) in values.into_iter().enumerate() {
            let name = value
                .get("file_path")
                .and_then(|v| v.as_str())
                .unwrap_or("?")
                .to_owned();
            let entry: Frame = serde_json::from_value(value)
                .map_err(|e| bad(&format!("frame {i} ({name})"), e.to_string(), "write the file again"))?;
            entries.push(entry);
        }
        let depth_unit = options
            .depth_unit
            .or(file.depth_unit_scale_factor)
            .unwrap_or(depth::DEFAULT_UNIT);
        if !(depth_unit.is_finite() && depth_unit > 0.0) {
            let what = format!("it is {depth_unit}");
            return Err(bad("depth_unit_scale_factor", what, "give scene units a step, above 0"));
        }
        let scale = file.applied_scale.unwrap_or(1.0);
        if !(scale.is_finite() && scale > 0.0) {
            return Err(bad(
                "applied_scale",
                format!("it is {scale}"),
                "a factor above 0 was expected",
            ));
        }
        let undo = match &file.applied_transform {
            Some(rows) => {
                let applied = pose::of_rows("the matrix", rows);
                Some(
                    applied
                        .map_err(|fault| fault.within(path, "applied_transform"))?
                        .inverse(),
                )
            }
            None => None,
        };
        let axes = axes::tell(&file, &entries, options, progress);
        let timed = entries.iter().filter(|entry| entry.time.is_some()).count();
        if timed == 0 {
            entries.sort_by(|a, b| natural(&a.file_path, &b.file_path));
            let last = entries.len().max(2) as f64 - 1.0;
            (0u32..)
                .zip(&mut entries)
                .for_each(|(i, entry)| entry.time = Some(f64::from(i) / last));
        } else if timed == entries.len() {
            entries.sort_by(|a, b| a.time.unwrap_or(0.0).total_cmp(&b.time.unwrap_or(0.0)));
        } else {
            let what = format!("{timed} of {} frames have a time", entries.len());
            return Err(bad("frames", what, "give all of them one, or none"));
        }
        let folder = path.parent().map(Path::to_path_buf).unwrap_or_default();
        Ok(Self {
            path: path.to_path_buf(),
            inside: Inside::of(&folder, options),
            folder,
            axes,
            moving_is_zero: file.axes.is_none() != options.invert_masks,
            undo,
            undo_scale: 1.0 / scale,
            depth_unit,
            timed: timed > 0,
            entries,
            file,
        })
    }

    /// The names of held-out views, where the file lists its splits.
    fn held_out(&self) -> Option<Vec<String>> {
        self.file.train_filenames.as_ref()?;
        let lists = [&self.file.test_filenames, &self.file.val_filenames];
        let some = lists.into_iter().flatten().find(|names| !names.is_empty());
        Some(some.cloned().unwrap_or_default())
    }

    /// Takes the entries of these names out, and those that are in no list.
    fn take(&mut self, names: &[String]) -> Vec<Frame> {
        let train = self.file.train_filenames.clone().unwrap_or_default();
        let all = std::mem::take(&mut self.entries);
        let (keep, rest): (Vec<_>, Vec<_>) = all.into_iter().partition(|e| train.contains(&e.file_path));
        self.entries = keep;
        rest.into_iter().filter(|e| names.contains(&e.file_path)).collect()
    }

    fn frames(
        &self,
        time_frames: usize,
        held_out: bool,
        options: &ImportOptions,
    ) -> Result<Vec<ListedFrame>, ReadSourceError> {
        self.of_entries(&self.entries, time_frames, held_out, options)
    }

    fn of_entries(
        &self,
        entries: &[Frame],
        time_frames: usize,
        held_out: bool,
        options: &ImportOptions,
    ) -> Result<Vec<ListedFrame>, ReadSourceError> {
        let all = entries.iter().enumerate().map(|(i, entry)| {
            let frame = self.frame(entry, time_frames, held_out, options);
            frame.map_err(|fault| fault.within(&self.path, format!("frame {i} ({})", entry.file_path)))
        });
        all.collect()
    }

    fn frame(
        &self,
        entry: &Frame,
        time_frames: usize,
        held_out: bool,
        options: &ImportOptions,
    ) -> Result<ListedFrame, SourceFault> {
        // frames without a time got one by their order
        let time = entry.time.unwrap_or(0.0);
        if !(0.0..=1.0).contains(&time) {
            let what = format!("time = {time}; 0 to 1, first to last frame of the training video, was expected");
            return Err(SourceFault::bad(what, "divide the times by the last"));
        }
        let rows = entry.transform_matrix.as_ref();
        let rows = rows.ok_or_else(|| SourceFault::missing("transform_matrix", "write the file again"))?;
        let mut c2w = self.axes.to_opencv(&pose::of_rows("transform_matrix", rows)?);
        c2w.translation *= self.undo_scale;
        if let Some(undo) = &self.undo {
            c2w = undo.compose(&c2w);
        }
        let picture = pictures::of_file(&self.picture(&entry.file_path, options)?)?;
        let beside = |name: &Option<String>| {
            let file = name.as_ref().map(|name| self.folder.join(name));
            file.map(|file| self.inside.check(file)).transpose()
        };
        let lens = lens::of(&entry.lens.or(&self.file.lens), picture.size)?;
        let t = time * (time_frames - 1) as f64;
        let (depth_unit, zero_moves) = (self.depth_unit, self.moving_is_zero);
        Ok(ListedFrame {
            // as nerfstudio does, numbers of floats are multiplied too
            depth: beside(&entry.depth_file_path)?.map(|file| depth::source(file, depth_unit, depth_unit)),
            mask: beside(&entry.mask_path)?.map(|file| {
                FrameSource::new(move || {
                    let grey = image::read_grey(&file)?;
                    let (w, h) = grey.size();
                    // nerfstudio takes everything but 0 for training
                    Ok(CompactMask::from_fn(w, h, |x, y| match zero_moves {
                        true => grey[(x, y)] == 0,
                        false => grey[(x, y)] >= 128,
                    }))
                })
            }),
            motion: beside(&entry.motion_path)?.map(|file| FrameSource::new(move || Ok(image::read_grey(&file)?))),
            instances: beside(&entry.instance_path)?.map(|file| FrameSource::new(move || Ok(image::read_ids(&file)?))),
            camera_index: held_out.then_some(entry.camera).flatten(),
            ..ListedFrame::new(entry.file_path.clone(), lens, c2w, t, picture.rgb)
        })
    }

    /// The file of an image: Blender's scenes leave its extension out.
    fn picture(&self, name: &str, options: &ImportOptions) -> Result<PathBuf, SourceFault> {
        if name.is_empty() {
            return Err(SourceFault::missing("file_path", "write the file again"));
        }
        let folder = options.pictures.as_deref().unwrap_or(&self.folder);
        let exact = folder.join(name);
        if exact.is_file() {
            return self.inside.check(exact);
        }
        let with = |e: &str| PathBuf::from(format!("{}.{e}", exact.display()));
        let named = ["png", "jpg", "jpeg", "PNG", "JPG"].map(with);
        let found = named.into_iter().find(|file| file.is_file()).ok_or_else(|| {
            let remedy = "put it there, or give the folder that file_path starts from (images)";
            SourceFault::missing(format!("the image {}", exact.display()), remedy)
        });
        self.inside.check(found?)
    }

    fn tracks(&self, name: &str, frames: usize, options: &ImportOptions) -> Result<m4_core::Tracks, ReadSourceError> {
        let path = self.inside.check(self.folder.join(name));
        let path = path.map_err(|fault| fault.within(&self.path, "tracks_path"))?;
        tracks::read(&path, frames, options.max_memory_bytes).map_err(|e| match e.fault {
            TracksFault::Io(source) => SourceFault::Io(source).at(&path),
            other => SourceFault::bad(other.to_string(), "write the tracks of this clip").at(&path),
        })
    }
}
