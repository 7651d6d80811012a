//! Stray Scanner: a video, LiDAR depth and the poses of ARKit.
//!
//! ```text
//! rgb.mp4              the video (HEVC: read by ffmpeg), as the sensor stands
//! odometry.csv         a line a frame: timestamp, frame, x, y, z, qx, qy, qz, qw [, fx, fy, cx, cy]; the first line names the columns
//! camera_matrix.csv    3 x 3, of the video's pixels; used where odometry.csv has no lens of its own
//! depth/NNNNNN.png     z-depth, 16 bits, millimetres, 256 x 192 (early versions: .npy)
//! confidence/NNNNNN.png 0, 1 or 2; depth where it is 0 is dropped
//! ```
//!
//! Poses are camera to world, metres; the app has turned ARKit's camera axes to OpenCV's already (`OdometryEncoder.swift` of
//! strayrobots/scanner multiplies by half a turn about x), so nothing is turned here. The lens is of the video as it is stored.
//! [`ImportOptions::pictures`] names another video or a folder of its frames; [`ImportOptions::factor`] shrinks them.

mod odometry;

use crate::core::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceFault};
use crate::files::pictures::of_video;
use crate::files::{Inside, clock, lens, pose};
use crate::side::depth;
use m4_io::video::{VideoOptions, read};
use m4_scene::{Intrinsics, Progress, RgbImage};
use odometry::Row;
use std::path::Path;

/// Metres a step of depth.
const DEPTH_UNIT: f64 = 1e-3;
/// Frames that the end of a recording may lack in the video or in the list of poses.
const MAX_LOST: usize = 3;
/// Sides that videos can be shrunk to, pixels.
const MIN_SIDE: usize = 16;
const MAX_SIDE: usize = 16_384;
/// How far the principal point may be from the middle, as a share of the side.
const OFF_CENTRE: f64 = 0.15;

/// Whether a folder is of it.
pub(crate) fn detect(path: &Path) -> bool {
    path.join("odometry.csv").is_file() && path.join("camera_matrix.csv").is_file()
}

pub(crate) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    let file = path.join("odometry.csv");
    let mut rows = odometry::read(&file)?;
    let matrix = odometry::matrix(&path.join("camera_matrix.csv"))?;
    let inside = Inside::of(path, options);
    let Decoded { mut pictures, stored } = video((path, &inside), options, progress)?;
    let (poses, frames) = (rows.len(), pictures.len());
    if poses.abs_diff(frames) > MAX_LOST {
        let what = format!("{poses} poses for {frames} frames of video");
        return Err(SourceFault::bad(what, "give all frames of the recording, in the option pictures").at(&file));
    }
    if poses != frames {
        let n = poses.min(frames);
        progress.warn(&format!(
            "{} has {poses} poses for {frames} frames of video; the first {n} are taken",
            path.display()
        ));
        rows.truncate(n);
        pictures.truncate(n);
    }
    if rows.is_empty() {
        return Err(SourceFault::missing("every frame", "record the scene again").at(&file));
    }
    let times_s: Vec<f64> = rows.iter().map(|row| row.time_s).collect();
    let (t, span_s) = clock::in_frames(&times_s);
    let unit = depth::unit(options, DEPTH_UNIT).map_err(|fault| fault.at(path))?;
    let listed = rows.iter().zip(pictures).zip(t).map(|((row, picture), t)| {
        let listed = intrinsics(row.lens.unwrap_or(matrix), stored)
            .and_then(|lens| frame((path, &inside), row, &lens, picture, t, unit));
        listed.map_err(|e| e.within(&file, format!("frame {}", row.frame)))
    });
    let train = listed.collect::<Result<_, _>>()?;
    Ok(Listing {
        metric: true,
        ..Listing::of_video(train, rows.len(), Some(span_s))
    })
}

/// A video that was decoded, and the size that it is stored in.
struct Decoded {
    pictures: Vec<RgbImage>,
    stored: (usize, usize),
}

/// All frames of the video, shrunk by the factor.
fn video(
    (path, inside): (&Path, &Inside),
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Decoded, ReadSourceError> {
    let named = options.pictures.clone().unwrap_or_else(|| path.join("rgb.mp4"));
    if !named.exists() {
        let remedy = "give the video, or a folder of its frames, in the option pictures";
        return Err(SourceFault::missing(named.display().to_string(), remedy).at(path));
    }
    let named = inside.file(named)?;
    let whole = VideoOptions {
        size: None,
        // a frame that is left out would shift all poses after it
        strict: true,
        max_memory_bytes: options.max_memory_bytes,
        ..VideoOptions::default()
    };
    let get = |settings: &VideoOptions| read(&named, settings, progress).map_err(|e| of_video(&named, e));
    let factor = options.factor.unwrap_or(1).max(1) as usize;
    let (video, stored) = if factor == 1 {
        (get(&whole)?, None)
    } else {
        let one = get(&VideoOptions {
            max_frames: Some(1),
            ..whole.clone()
        })?;
        let (w, h) = one.frames.first().map(|f| f.rgb.size()).unwrap_or_default();
        let shrunk = VideoOptions {
            size: Some((w.max(h) / factor).clamp(MIN_SIDE, MAX_SIDE)),
            ..whole
        };
        (get(&shrunk)?, Some((w, h)))
    };
    for warning in &video.warnings {
        progress.warn(warning);
    }
    let pictures: Vec<RgbImage> = video.frames.into_iter().map(|f| f.rgb).collect();
    let stored = stored.or(pictures.first().map(RgbImage::size)).unwrap_or_default();
    Ok(Decoded { pictures, stored })
}

/// The lens of a frame, of pictures of `stored` pixels: of the four numbers `fx fy cx cy` the principal point must be near the middle.
fn intrinsics([fx, fy, cx, cy]: [f64; 4], stored: (usize, usize)) -> Result<Intrinsics, SourceFault> {
    let (w, h) = (stored.0 as f64, stored.1 as f64);
    let central = |c: f64, side: f64| (c / side - 0.5).abs() < OFF_CENTRE;
    if !(central(cx, w) && central(cy, h)) {
        let what = format!("the principal point {cx}, {cy} of pictures of {w} x {h} pixels");
        let remedy = "give the video as it was recorded, neither turned nor resized";
        return Err(SourceFault::bad(what, remedy));
    }
    let k = lens::pinhole([fx, fy, cx, cy], stored);
    let checked = Lens::pinhole(k).check();
    checked.map_err(|what| SourceFault::bad(what, "record the scene again"))?;
    Ok(k)
}

fn frame(
    (path, inside): (&Path, &Inside),
    row: &Row,
    lens: &Intrinsics,
    picture: RgbImage,
    t: f64,
    unit: f64,
) -> Result<ListedFrame, SourceFault> {
    let k = lens::resized(lens, picture.size())?;
    let [x, y, z, w] = row.quaternion_xyzw;
    let c2w = pose::of_quaternion(row.place, [w, x, y, z])?;
    let name = format!("{:06}", row.frame);
    let at = |extension: &str| path.join(format!("depth/{name}.{extension}"));
    let sensed = [at("png"), at("npy")].into_iter().find(|p| p.is_file());
    let sensed = sensed.map(|sensed| inside.check(sensed)).transpose()?;
    let confidence = inside.check(path.join(format!("confidence/{name}.png")))?;
    Ok(ListedFrame {
        depth: sensed.map(|sensed| FrameSource::new(move || depth::read_sensed(&sensed, &confidence, unit))),
        ..ListedFrame::new(name, Lens::pinhole(k), c2w, t, FrameSource::held(picture))
    })
}
