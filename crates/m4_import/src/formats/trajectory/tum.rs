//! Trajectories of the TUM benchmark.

use super::associate::{Stamped, nearest};
use super::lens;
use crate::core::{ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceFault};
use crate::files::pictures::{self, Picture};
use crate::files::table::{self, Row};
use crate::files::{Inside, clock, pose};
use crate::side::depth;
use m4_scene::Progress;
use std::path::{Path, PathBuf};

/// Metres a step of the data set's depth maps.
const DEPTH_UNIT: f64 = 1.0 / 5000.0;
/// Names of a trajectory in a folder.
const NAMES: [&str; 3] = ["groundtruth.txt", "trajectory.txt", "traj.txt"];

/// Whether it is a text file with 8 numbers a line, or the folder of a sequence of the benchmark.
pub fn detect(path: &Path) -> bool {
    trajectory(path).is_some_and(|file| table::starts_with_numbers(&file, 8))
}

fn trajectory(path: &Path) -> Option<PathBuf> {
    if path.is_file() {
        let is_text = path.extension().is_some_and(|e| e == "txt" || e == "tum");
        return is_text.then(|| path.to_path_buf());
    }
    NAMES.iter().map(|name| path.join(name)).find(|file| file.is_file())
}

pub fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    clock::fps(options).map_err(|fault| fault.at(path))?;
    let file = trajectory(path).ok_or_else(|| {
        SourceFault::missing("a trajectory", "give its text file, or a folder with groundtruth.txt").at(path)
    })?;
    let folder = file.parent().unwrap_or(Path::new("")).to_path_buf();
    let mut rows = table::read(&file, |n| n == 8, "timestamp tx ty tz qx qy qz qw")?;
    rows.sort_by(|a, b| a.values[0].total_cmp(&b.values[0]));
    let inside = Inside::of(&folder, options);
    let clip = match (&options.pictures, folder.join("rgb.txt")) {
        (None, stamps) if stamps.is_file() => Clip::of_stamps(&rows, &Stamped::read(&stamps, &inside)?, &stamps)?,
        (None, _) => {
            let remedy =
                "give the folder or video of the pictures (pictures), or put rgb.txt of the data set beside it";
            return Err(SourceFault::missing("every picture", remedy).at(&file));
        }
        (Some(pictures), _) => {
            let read = pictures::read(pictures, &inside, options, progress)?;
            Clip::of_pictures(&rows, &file, read)?
        }
    };
    let stamps = folder.join("depth.txt");
    let depths = stamps.is_file().then(|| Stamped::read(&stamps, &inside)).transpose()?;
    let unit = depth::unit(options, DEPTH_UNIT).map_err(|fault| fault.at(path))?;
    let mut train = Vec::with_capacity(clip.frames.len());
    let mut given: Option<((usize, usize), Lens)> = None;
    for ((row, picture), t) in clip.frames.into_iter().zip(&clip.t) {
        let v = &row.values;
        let c2w = pose::of_quaternion([v[1], v[2], v[3]], [v[7], v[4], v[5], v[6]]);
        let c2w = c2w.map_err(|fault| fault.within(&file, row.place()))?;
        let lens = match given {
            Some((size, lens)) if size == picture.size => lens,
            _ => lens::given(&folder, picture.size, options)?.ok_or_else(|| lens::missing(&file, ""))?,
        };
        given = Some((picture.size, lens));
        let map = depths.as_ref().and_then(|all| all.at(v[0])).map(Path::to_path_buf);
        train.push(ListedFrame {
            depth: map.map(|map| depth::source(map, unit, 1.0)),
            ..ListedFrame::new(picture.name, lens, c2w, *t, picture.rgb)
        });
    }
    let duration_s = clock::duration_of(clip.duration_s, clip.time_frames, options, progress);
    Ok(Listing {
        metric: depths.is_some(),
        ..Listing::of_video(train, clip.time_frames, duration_s)
    })
}

/// Poses with their pictures and places in time.
struct Clip {
    frames: Vec<(Row, Picture)>,
    t: Vec<f64>,
    time_frames: usize,
    duration_s: Option<f64>,
}

impl Clip {
    /// Pictures of the data set, each with the pose that is nearest.
    fn of_stamps(rows: &[Row], stamps: &Stamped, list: &Path) -> Result<Self, ReadSourceError> {
        let mut frames: Vec<(Row, Picture)> = Vec::new();
        for (time, picture) in stamps.all() {
            // poses come faster than pictures
            let Some(k) = nearest(rows, |row| row.values[0], *time) else {
                continue;
            };
            let of_file = pictures::of_file(picture).map_err(|fault| fault.at(picture))?;
            frames.push((rows[k].clone(), of_file));
        }
        if frames.is_empty() {
            let what = "no picture was taken within 20 ms of a pose";
            return Err(SourceFault::bad(what, "give the list and the trajectory of one sequence").at(list));
        }
        let seconds: Vec<f64> = frames.iter().map(|(row, _)| row.values[0]).collect();
        let (t, span_s) = clock::in_frames(&seconds);
        Ok(Self {
            time_frames: frames.len(),
            frames,
            t,
            duration_s: Some(span_s),
        })
    }

    /// A picture a pose, or poses that say the number of their picture.
    fn of_pictures(rows: &[Row], file: &Path, pictures: pictures::Pictures) -> Result<Self, ReadSourceError> {
        let n = pictures.all.len();
        let number = |row: &Row| Some(row.values[0]).filter(|t| t.fract() == 0.0 && *t >= 0.0 && *t < n as f64);
        let numbers: Option<Vec<usize>> = rows.iter().map(|row| number(row).map(|t| t as usize)).collect();
        let numbers = numbers.filter(|all| all.windows(2).all(|pair| pair[0] < pair[1]));
        if let Some(numbers) = numbers {
            let mut all: Vec<Option<Picture>> = pictures.all.into_iter().map(Some).collect();
            let frames = rows
                .iter()
                .zip(&numbers)
                .filter_map(|(row, &i)| Some((row.clone(), all[i].take()?)));
            return Ok(Self {
                frames: frames.collect(),
                t: numbers.iter().map(|&i| i as f64).collect(),
                time_frames: n,
                duration_s: pictures.times_s.and_then(|times| times.last().copied()),
            });
        }
        if rows.len() != n {
            let what = format!("it has {} poses, but there are {n} pictures", rows.len());
            let remedy = "give a picture a pose, or numbers of pictures (0, 1, 2, ...) in place of timestamps";
            return Err(SourceFault::bad(what, remedy).at(file));
        }
        let seconds: Vec<f64> = rows.iter().map(|row| row.values[0]).collect();
        let (t, span_s) = clock::in_frames(&seconds);
        Ok(Self {
            frames: rows.iter().cloned().zip(pictures.all).collect(),
            t,
            time_frames: n,
            duration_s: Some(span_s),
        })
    }
}
