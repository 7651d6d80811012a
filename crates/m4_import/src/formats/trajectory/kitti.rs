//! Trajectories of KITTI's odometry benchmark.

use super::lens;
use crate::core::{ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceFault};
use crate::files::{Inside, clock, pictures, pose, table};
use m4_math::Se3;
use m4_math::nalgebra::Matrix3;
use m4_scene::Progress;
use std::path::{Path, PathBuf};

/// Whether it is a text file with 12 numbers a line, or a folder with `poses.txt`.
pub fn detect(path: &Path) -> bool {
    trajectory(path).is_some_and(|file| table::starts_with_numbers(&file, 12))
}

fn trajectory(path: &Path) -> Option<PathBuf> {
    if path.is_file() {
        let is_text = path.extension().is_some_and(|e| e == "txt" || e == "kitti");
        return is_text.then(|| path.to_path_buf());
    }
    Some(path.join("poses.txt")).filter(|file| file.is_file())
}

/// The folder of pictures beside the trajectory: colour before grey, left before right.
fn beside(folder: &Path) -> Option<PathBuf> {
    ["image_2", "image_3", "image_0", "image_1"]
        .iter()
        .map(|name| folder.join(name))
        .find(|folder| folder.is_dir())
}

pub fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    clock::fps(options).map_err(|fault| fault.at(path))?;
    let file = trajectory(path).ok_or_else(|| {
        SourceFault::missing("a trajectory", "give its text file, or a folder with poses.txt").at(path)
    })?;
    let folder = file.parent().unwrap_or(Path::new("")).to_path_buf();
    let rows = table::read(&file, |n| n == 12, "12 numbers of a 3x4 matrix")?;
    let pictures_in = options.pictures.clone().or_else(|| beside(&folder)).ok_or_else(|| {
        let remedy = "give the folder or video of the pictures (pictures), or put image_2 of the data set beside it";
        SourceFault::missing("every picture", remedy).at(&file)
    })?;
    // image_2 was taken by camera 2
    let name = pictures_in
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let camera = name
        .strip_prefix("image_")
        .and_then(|n| n.trim_start_matches('0').parse().ok());
    let camera: usize = camera.filter(|n| *n < 4).unwrap_or(0);
    let pictures = pictures::read(&pictures_in, &Inside::of(&folder, options), options, progress)?;
    if pictures.all.len() != rows.len() {
        let what = format!(
            "it has {} poses, but there are {} pictures",
            rows.len(),
            pictures.all.len()
        );
        return Err(SourceFault::bad(what, "give a picture a pose").at(&file));
    }
    let times = folder.join("times.txt");
    let times_s = match times.is_file() {
        true => {
            let all: Vec<f64> = table::read(&times, |n| n == 1, "one time in seconds")?
                .iter()
                .map(|row| row.values[0])
                .collect();
            if all.len() < rows.len() || !all.is_sorted() {
                let what = format!("it has {} times for {} poses, or they go back", all.len(), rows.len());
                return Err(SourceFault::bad(what, "give the times of this sequence").at(&times));
            }
            Some(all[..rows.len()].to_vec())
        }
        false => pictures.times_s,
    };
    let time_frames = rows.len();
    let (t, duration_s) = match times_s {
        Some(seconds) if options.fps.is_none() => {
            let (t, span_s) = clock::in_frames(&seconds);
            (t, Some(span_s))
        }
        _ => {
            let t = (0..time_frames).map(|i| i as f64).collect();
            (t, clock::duration_s(time_frames, options, progress))
        }
    };
    let mut metric = false;
    let mut given = None;
    let mut train = Vec::with_capacity(time_frames);
    for ((row, picture), t) in rows.iter().zip(pictures.all).zip(t) {
        let mut c2w = pose::of_matrix("the matrix", &row.values).map_err(|fault| fault.within(&file, row.place()))?;
        let (lens, to_zero) = match given {
            Some((size, lens)) if size == picture.size => lens,
            _ => camera_of(&file, camera, picture.size, options)?,
        };
        given = Some((picture.size, (lens, to_zero)));
        metric |= to_zero.is_some();
        if let Some(to_zero) = to_zero {
            c2w = c2w.compose(&to_zero);
        }
        train.push(ListedFrame::new(picture.name, lens, c2w, t, picture.rgb));
    }
    Ok(Listing {
        metric,
        ..Listing::of_video(train, time_frames, duration_s)
    })
}

/// The lens of a camera, and with `calib.txt` of the data set the way from camera 0 to it, metres.
fn camera_of(
    trajectory: &Path,
    camera: usize,
    size: (usize, usize),
    options: &ImportOptions,
) -> Result<(Lens, Option<Se3<f64>>), ReadSourceError> {
    let folder = trajectory.parent().unwrap_or(Path::new(""));
    if let Some(lens) = lens::given(folder, size, options)? {
        return Ok((lens, None));
    }
    let calib = folder.join("calib.txt");
    if !calib.is_file() {
        return Err(lens::missing(trajectory, ", or calib.txt of the data set"));
    }
    let projection = lens::kitti(&calib, camera, size)?;
    let to_zero = Se3 {
        rotation: Matrix3::identity(),
        translation: -projection.offset_m,
    };
    Ok((Lens::pinhole(projection.intrinsics), Some(to_zero)))
}
