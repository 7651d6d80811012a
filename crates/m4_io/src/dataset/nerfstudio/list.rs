//! Converts the entries of the file to frames.

use super::axes::axes_of;
use super::{Frame, TRAINING_LIST, Transforms, lens_of};
use crate::dataset::depth;
use crate::dataset::files::{Inside, duration_s, given_fps, stored_image};
use crate::dataset::{FrameSource, ImportOptions, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::{json, natural};
use crate::pose::{self, Axes};
use crate::{Fault, ReadError, image, range, tracks};
use m4_core::{CompactMask, Progress, Se3, Tracks};
use std::io;
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
        let test = (name == TRAINING_LIST && test.is_file()).then_some(test);
        return fits.then(|| (path.to_path_buf(), test));
    }
    let file = |name: &str| Some(path.join(name)).filter(|file| file.is_file());
    match file(TRAINING_LIST) {
        Some(train) => Some((
            train,
            file("transforms_test.json").or_else(|| file("transforms_val.json")),
        )),
        None => Some((file("transforms.json")?, file("transforms_test.json"))),
    }
}

pub fn list(
    path: &Path,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Listing, ReadError> {
    given_fps(options).at(path)?;
    let (train_file, test_file) = files(path).ok_or_else(|| {
        let hint = "give it or the folder that it is in";
        Fault::missing("transforms.json or transforms_train.json", hint).at(path)
    })?;
    let mut train = List::read(&train_file, Kind::DataSet, options, progress)?;
    let mut test = Vec::new();
    if let Some(names) = train.held_out() {
        test = train.take(&names);
    }
    let time_frames = train.entries.len();
    if time_frames == 0 {
        return Err(no_frames(&train_file));
    }
    warn_of_one_moment(&train, progress);
    let frames = train.frames(&train.entries, time_frames, false, options)?;
    let mut test = train.frames(&test, time_frames, true, options)?;
    if let Some(file) = test_file {
        let list = List::read(&file, Kind::DataSet, options, progress)?;
        if !list.timed {
            progress.warn("the held-out views have no time; they were spread evenly over the clip, which is correct only for a static scene");
        }
        test.extend(list.frames(&list.entries, time_frames, true, options)?);
    }
    let duration_s = match train.duration_s()? {
        Some(s) if options.fps.is_none() => Some(s),
        _ => duration_s(time_frames, options, progress),
    };
    Ok(Listing {
        train: frames,
        test,
        time_frames,
        duration_s,
        metric: train.file.metric == Some(true),
        tracks: train.tracks(options)?,
    })
}

/// Lists one split of a capture of ours, the training video or `held_out` views: OpenGL axes unless
/// the file names others, masks of 255 in dynamic regions, no assumed frame rate. Held-out views
/// are timed by the training split beside them, or by `time_frames`.
pub fn list_capture(
    file: &Path,
    held_out: bool,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Listing, ReadError> {
    let list = List::read(file, Kind::Capture, options, progress)?;
    if list.entries.is_empty() {
        return Err(no_frames(file));
    }
    if held_out && !list.timed {
        return Err(
            Fault::missing("time of the held-out views", "add their times, 0 to 1")
                .within(file, "frames"),
        );
    }
    let time_frames = if held_out {
        list.time_frames()?
    } else {
        list.entries.len()
    };
    if !held_out {
        warn_of_one_moment(&list, progress);
    }
    if !list.timed {
        progress.warn(&format!(
            "the {time_frames} frames of {} have no time; they are taken as evenly spaced in the order of their names",
            file.display()
        ));
    }
    Ok(Listing {
        train: list.frames(&list.entries, time_frames, true, options)?,
        test: Vec::new(),
        time_frames,
        duration_s: list.duration_s()?,
        metric: list.file.metric == Some(true),
        tracks: list.tracks(options)?,
    })
}

fn no_frames(file: &Path) -> ReadError {
    Fault::bad("it lists no frames", "give a file with frames").at(file)
}

/// Says so where all times are one: as of a clip whose times were lost.
fn warn_of_one_moment(list: &List, progress: &dyn Progress) {
    let mut times = list.entries.iter().filter_map(|(_, entry)| entry.time);
    let first = times.next();
    if list.entries.len() > 1 && list.timed && times.all(|time| Some(time) == first) {
        progress.warn(&format!(
            "all {} frames of {} have the time {}: they are taken as one moment, in which nothing moves; if they are a clip, correct the \
             times, or leave them out",
            list.entries.len(),
            list.path.display(),
            first.unwrap_or_default()
        ));
    }
}

/// Whose conventions a file has where it does not say.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    DataSet,
    Capture,
}

/// A file and its frames in order of time.
struct List {
    path: PathBuf,
    folder: PathBuf,
    file: Transforms,
    /// Each with its index in the file.
    entries: Vec<(usize, Frame)>,
    inside: Inside,
    axes: Axes,
    depth_unit: f64,
    /// Masks are 0 in dynamic regions.
    dynamic_is_zero: bool,
    /// From the world of the file to that of the tool: what was applied, undone.
    undo: Option<Se3<f64>>,
    undo_scale: f64,
    /// The frames have times.
    timed: bool,
}

impl List {
    fn read(
        path: &Path,
        kind: Kind,
        options: &ImportOptions,
        progress: &dyn Progress,
    ) -> Result<Self, ReadError> {
        let mut file: Transforms = json(path)?;
        let bad = |key: &str, what: String, hint: &str| {
            Fault::bad(what, hint).within(path, key.to_owned())
        };
        let values = std::mem::take(&mut file.frames);
        let mut entries = Vec::with_capacity(values.len());
        for (i, value) in values.into_iter().enumerate() {
            let name = value
                .get("file_path")
                .and_then(|v| v.as_str())
                .unwrap_or("?")
                .to_owned();
            let entry: Frame = serde_json::from_value(value).map_err(|e| {
                bad(
                    &format!("frame {i} ({name})"),
                    e.to_string(),
                    "write the file again",
                )
            })?;
            entries.push((i, entry));
        }
        let depth_unit = file.depth_unit_scale_factor.unwrap_or(depth::DEFAULT_UNIT);
        let scale = file.applied_scale.unwrap_or(1.0);
        for (key, value, range) in [
            ("depth_unit_scale_factor", depth_unit, range::DEPTH_UNIT),
            ("applied_scale", scale, range::SCALE),
        ] {
            range::check("it", value, &range, "", "correct it").map_err(|e| e.within(path, key))?;
        }
        let undo = match &file.applied_transform {
            Some(rows) => {
                let applied = pose::of_rows("the matrix", rows);
                Some(
                    applied
                        .map_err(|e| e.within(path, "applied_transform"))?
                        .inverse(),
                )
            }
            None => None,
        };
        let axes = match kind {
            Kind::DataSet => axes_of(&file, &entries, progress),
            Kind::Capture => file.axes.unwrap_or_default(),
        };
        let timed = entries
            .iter()
            .filter(|(_, entry)| entry.time.is_some())
            .count();
        if timed == 0 {
            entries.sort_by(|(_, a), (_, b)| natural(&a.file_path, &b.file_path));
            let last = entries.len().max(2) as f64 - 1.0;
            (0u32..)
                .zip(&mut entries)
                .for_each(|(i, (_, entry))| entry.time = Some(f64::from(i) / last));
        } else if timed == entries.len() {
            entries
                .sort_by(|(_, a), (_, b)| a.time.unwrap_or(0.0).total_cmp(&b.time.unwrap_or(0.0)));
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
            dynamic_is_zero: kind == Kind::DataSet && file.axes.is_none(),
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
    fn take(&mut self, names: &[String]) -> Vec<(usize, Frame)> {
        let train = self.file.train_filenames.clone().unwrap_or_default();
        let all = std::mem::take(&mut self.entries);
        let (keep, rest): (Vec<_>, Vec<_>) = all
            .into_iter()
            .partition(|(_, e)| train.contains(&e.file_path));
        self.entries = keep;
        rest.into_iter()
            .filter(|(_, e)| names.contains(&e.file_path))
            .collect()
    }

    /// How many frames `time` = 0..1 spans, of held-out views.
    fn time_frames(&self) -> Result<usize, ReadError> {
        for name in [TRAINING_LIST, "transforms.json"] {
            let training = self.folder.join(name);
            if training != self.path && training.is_file() {
                return Ok(json::<Transforms>(&training)?.frames.len());
            }
        }
        if let Some(n) = self.file.time_frames.filter(|n| !range::FRAMES.contains(n)) {
            let what = format!("it is {n}; 1 to {} was expected", range::FRAMES.end());
            return Err(Fault::bad(what, "write the number of training frames")
                .within(&self.path, "time_frames"));
        }
        self.file.time_frames.filter(|&n| n > 0).ok_or_else(|| {
            let hint = "put transforms_train.json beside the file, or add time_frames";
            Fault::missing(
                "the number of training frames, which the times 0 to 1 span,",
                hint,
            )
            .at(&self.path)
        })
    }

    fn duration_s(&self) -> Result<Option<f64>, ReadError> {
        if let Some(s) = self.file.duration_s {
            let range = 0.0..=*range::SECONDS.end();
            range::check("it", s, &range, "seconds", "correct it")
                .map_err(|e| e.within(&self.path, "duration_s"))?;
        }
        Ok(self.file.duration_s)
    }

    fn frames(
        &self,
        entries: &[(usize, Frame)],
        time_frames: usize,
        held_out: bool,
        options: &ImportOptions,
    ) -> Result<Vec<ListedFrame>, ReadError> {
        let all = entries.iter().map(|(i, entry)| {
            let frame = self.frame(entry, time_frames, held_out, options);
            frame.map_err(|e| e.within(&self.path, format!("frame {i} ({})", entry.file_path)))
        });
        all.collect()
    }

    fn frame(
        &self,
        entry: &Frame,
        time_frames: usize,
        held_out: bool,
        options: &ImportOptions,
    ) -> Result<ListedFrame, Fault> {
        // frames without a time got one by their order
        let time = entry.time.unwrap_or(0.0);
        if !(0.0..=1.0).contains(&time) {
            let what = format!("time = {time}; 0 (first training frame) to 1 (last) was expected");
            return Err(Fault::bad(what, "divide the times by the last"));
        }
        if let Some(sigma) = entry.distance_sigma {
            let hint = "correct it, or leave it out";
            range::check(
                "distance_sigma",
                sigma.into(),
                &range::DISTANCE_SIGMA,
                "",
                hint,
            )?;
        }
        let rows = entry.transform_matrix.as_ref();
        let rows =
            rows.ok_or_else(|| Fault::missing("transform_matrix", "write the file again"))?;
        let mut c2w = self
            .axes
            .to_opencv(&pose::of_rows("transform_matrix", rows)?);
        c2w.translation *= self.undo_scale;
        if let Some(undo) = &self.undo {
            c2w = undo.compose(&c2w);
        }
        let image = stored_image(&self.image(&entry.file_path, options)?)?;
        let beside = |name: &Option<String>| {
            let file = name.as_ref().map(|name| self.folder.join(name));
            file.map(|file| self.inside.check(file)).transpose()
        };
        let lens = lens_of(&entry.lens.or(&self.file.lens), image.size)?;
        let t = time * (time_frames.max(1) - 1) as f64;
        let (depth_unit, dynamic_is_zero) = (self.depth_unit, self.dynamic_is_zero);
        Ok(ListedFrame {
            // as nerfstudio does, numbers of floats are multiplied too
            depth: beside(&entry.depth_file_path)?
                .map(|file| depth::source(file, depth_unit, depth_unit)),
            mask: beside(&entry.mask_path)?.map(|file| {
                FrameSource::new(move || {
                    let grey = image::read_grey(&file)?;
                    if !dynamic_is_zero {
                        return Ok(grey.into());
                    }
                    // nerfstudio takes everything but 0 for training
                    let (w, h) = grey.size();
                    Ok(CompactMask::from_fn(w, h, |x, y| grey[(x, y)] == 0))
                })
            }),
            motion: beside(&entry.motion_path)?
                .map(|file| FrameSource::new(move || Ok(image::read_grey(&file)?))),
            instances: beside(&entry.instance_path)?
                .map(|file| FrameSource::new(move || Ok(image::read_ids(&file)?))),
            camera_index: held_out.then_some(entry.camera).flatten(),
            distance_sigma: entry.distance_sigma,
            ..ListedFrame::new(entry.file_path.clone(), lens, c2w, t, image.rgb)
        })
    }

    /// The file of an image: Blender's scenes leave its extension out.
    fn image(&self, name: &str, options: &ImportOptions) -> Result<PathBuf, Fault> {
        if name.is_empty() {
            return Err(Fault::missing("file_path", "write the file again"));
        }
        let folder = options.images.as_deref().unwrap_or(&self.folder);
        let exact = folder.join(name);
        if exact.is_file() {
            return self.inside.check(exact);
        }
        let with = |e: &str| PathBuf::from(format!("{}.{e}", exact.display()));
        let named = ["png", "jpg", "jpeg", "PNG", "JPG"].map(with);
        let file = named.into_iter().find(|file| file.is_file()).ok_or_else(|| {
            let is_link = exact.symlink_metadata().is_ok_and(|facts| facts.is_symlink());
            let what = format!(
                "the image {} is {}; put it there, or give the folder that file_path starts from (images)",
                exact.display(),
                if is_link { "a link that leads nowhere, or in a circle" } else { "missing" }
            );
            Fault::Io(io::Error::new(io::ErrorKind::NotFound, what))
        });
        self.inside.check(file?)
    }

    /// The tracks that the file names, their frames in the order of the entries.
    fn tracks(&self, options: &ImportOptions) -> Result<Option<Tracks>, ReadError> {
        let Some(name) = &self.file.tracks_path else {
            return Ok(None);
        };
        let path = self.inside.check(self.folder.join(name));
        let path = path.map_err(|e| e.within(&self.path, "tracks_path"))?;
        let tracks = tracks::read(&path, self.entries.len(), options.max_memory_bytes)?;
        let mut sorted: Vec<usize> = self.entries.iter().map(|(i, _)| *i).collect();
        if sorted.is_sorted() {
            return Ok(Some(tracks));
        }
        sorted.sort_unstable();
        let place = |(i, _): &(usize, Frame)| sorted.partition_point(|k| k < i);
        let order: Vec<usize> = self.entries.iter().map(place).collect();
        let bad = |e: m4_core::ShapeError| {
            Fault::bad(e.to_string(), "write the tracks of this clip").at(&path)
        };
        Ok(Some(tracks.in_order(&order).map_err(bad)?))
    }
}
