//! From frames to a capture.

use super::confidence::{Confidence, Grade};
use super::frontend::Resolved;
use super::given::Given;
use super::scale::{depth_ratio, rescale, typical_depth};
use crate::record::Found;
use crate::{Error, Observer, Settings};
use m4_io::capture::Split;
use m4_scene::{Capture, CaptureFrame, DepthMap, RgbImage, Tracks, Video};
use m4_slam::dense::{self, Dense, densify};
use m4_slam::reconstruction::{CameraMotion, SparseReconstruction};
use m4_slam::sparse::{self, Known, SparseConfig};
use std::path::Path;

/// Given poses and given depth whose units differ by more than this factor do not fit.
const UNITS: f64 = 1.25;

/// Reads the clip, finds geometry and writes the capture into `folder`.
pub(super) fn compute(
    input: &Path,
    folder: &Path,
    settings: &Settings,
    frontend: &Resolved,
    observer: &dyn Observer,
) -> Result<Found, Error> {
    let flow = frontend.load(&settings.dense.flow)?;
    let video = m4_io::video::read(input, &settings.video, observer)?;
    for warning in &video.warnings {
        observer.warn(warning);
    }
    let mut config = settings.sparse.clone();
    if config.fov_deg.is_none() && config.focal_px.is_none() {
        config.focal_px = video.focal_px;
    }
    let width = video.frames.first().map_or(0, |f| f.rgb.width());
    let given = Given::read(
        &settings.geometry,
        input,
        &video,
        settings.video.folder_fps,
        focal_px(&config, width),
    )?;
    if let Some(lens) = given.lens {
        config.intrinsics = Some([lens.fx, lens.fy, lens.cx, lens.cy]);
    }
    let pictures: Vec<&RgbImage> = video.frames.iter().map(|f| &f.rgb).collect();
    let known = Known {
        masks: given.masks.as_deref(),
    };
    let recovered = match &given.cameras {
        Some(cameras) => sparse::with_cameras(&pictures, cameras, &known, &config, observer)?,
        None => sparse::recover(&pictures, &known, &config, observer)?,
    };
    let mut sparse = recovered.sparse;
    for warning in &sparse.warnings {
        observer.warn(warning);
    }
    if let Some(depth) = &given.depth {
        to_metres(&mut sparse, depth, given.cameras.is_some(), observer)?;
    }
    let dense = dense_in_its_unit(&pictures, &sparse, flow.as_ref(), &given, settings, observer)?;
    let known_depth = given.depth.as_deref().map(known_share);
    let confidence = Confidence::of(
        &sparse,
        recovered.focal,
        &dense.frames,
        given.masks.is_some(),
        known_depth,
    );
    if let (true, Some(advice)) = (confidence.grade != Grade::Good, &confidence.advice) {
        observer.warn(&format!("geometry is {}: {advice}", confidence.grade.name()));
    }
    let found = summary(&sparse, &dense, frontend.name(), &given, confidence);
    drop(pictures);
    let metric = given.depth.is_some();
    let capture = assemble(video, &sparse, dense, metric);
    m4_io::capture::write(folder, &capture, Split::Train, observer)?;
    Ok(found)
}

/// The focal length in pixels of frames of `width` columns that settings or the file state.
fn focal_px(config: &SparseConfig, width: usize) -> Option<f64> {
    let from_fov = |fov: f64| 0.5 * width as f64 / (0.5 * fov.to_radians()).tan();
    config.focal_px.or(config.fov_deg.map(from_fov))
}

/// Brings a reconstruction of any unit to that of the given depth. Given poses stay: they are to have that unit.
fn to_metres(
    sparse: &mut SparseReconstruction,
    depth: &[DepthMap],
    posed: bool,
    observer: &dyn Observer,
) -> Result<(), Error> {
    if sparse.camera_motion != CameraMotion::Parallax {
        return Ok(());
    }
    let ratio = depth_ratio(sparse, depth)?;
    if !posed {
        *sparse = rescale(sparse, ratio);
    } else if !(1.0 / UNITS..=UNITS).contains(&ratio) {
        observer.warn(&format!(
            "given depth and given poses have different units: points are {ratio:.3} times as far away by the depth maps \
             (millimetres in the files) as by the poses; give poses in metres"
        ));
    }
    Ok(())
}

/// Depth, masks and tracks, computed in a unit in which the scene is about 1 away, as its settings expect.
fn dense_in_its_unit(
    pictures: &[&RgbImage],
    sparse: &SparseReconstruction,
    flow: &dyn dense::FlowSource,
    given: &Given,
    settings: &Settings,
    observer: &dyn Observer,
) -> Result<Dense, Error> {
    let unit = if given.cameras.is_some() || given.depth.is_some() {
        typical_depth(sparse, given.depth.as_deref())
    } else {
        1.0
    };
    let scaled = (unit != 1.0).then(|| rescale(sparse, 1.0 / unit));
    let depth: Option<Vec<DepthMap>> = given.depth.as_deref().map(|maps| {
        let to_unit = |map: &DepthMap| map.map(|z| z / unit as f32);
        maps.iter().map(to_unit).collect()
    });
    let known = dense::Given {
        masks: given.masks.as_deref(),
        depth: depth.as_deref(),
    };
    let sparse = scaled.as_ref().unwrap_or(sparse);
    let mut dense = densify(pictures, sparse, flow, &known, &settings.dense, observer)?;
    if unit != 1.0 {
        for z in dense.frames.iter_mut().flat_map(|f| f.depth.data_mut()) {
            *z *= unit as f32;
        }
        dense.tracks = dense.tracks.map(|tracks| tracks.scaled(unit as f32));
    }
    Ok(dense)
}

/// Share of the pixels whose depth was given.
fn known_share(depth: &[DepthMap]) -> f64 {
    let pixels = depth.iter().map(|d| d.data().len()).sum::<usize>().max(1);
    let known = depth.iter().flat_map(|d| d.data()).filter(|&&z| z > 0.0).count();
    known as f64 / pixels as f64
}

fn assemble(video: Video, sparse: &SparseReconstruction, dense: Dense, metric: bool) -> Capture {
    let n = video.frames.len();
    let first_s = video.frames.first().map_or(0.0, |f| f.time_s);
    let duration_s = video.frames.last().map_or(0.0, |f| f.time_s) - first_s;
    let last = n.saturating_sub(1) as f64;
    let moment = |i: usize, time_s: f64| {
        if duration_s > 0.0 {
            ((time_s - first_s) / duration_s * last).clamp(0.0, last)
        } else {
            i as f64
        }
    };
    let frames = video
        .frames
        .into_iter()
        .zip(dense.frames)
        .zip(&sparse.cameras)
        .enumerate();
    let frames = frames.map(|(i, ((frame, dense), camera))| CaptureFrame {
        name: format!("{i:05}"),
        camera: *camera,
        t: moment(i, frame.time_s),
        rgb: frame.rgb,
        depth: Some(dense.depth.into()),
        mask: Some(dense.mask.into()),
        camera_index: None,
    });
    Capture {
        frames: frames.collect(),
        time_frames: n,
        duration_s: (duration_s > 0.0).then_some(duration_s),
        metric,
        tracks: dense.tracks,
    }
}

fn summary(
    sparse: &SparseReconstruction,
    dense: &Dense,
    frontend: &str,
    given: &Given,
    confidence: Confidence,
) -> Found {
    let lens = sparse.cameras.first().map(|c| c.intrinsics);
    let pixels: usize = dense.frames.iter().map(|d| d.mask.data().len()).sum();
    let moving = dense
        .frames
        .iter()
        .flat_map(|d| d.mask.data())
        .filter(|&&m| m != 0)
        .count();
    Found {
        frames: sparse.cameras.len(),
        size: lens.map_or([0, 0], |k| [k.width, k.height]),
        focal_px: lens.map_or(0.0, |k| k.fx),
        fov_deg: lens.map_or(0.0, |k| k.horizontal_fov_rad().to_degrees()),
        camera_motion: match sparse.camera_motion {
            CameraMotion::Parallax => "parallax",
            CameraMotion::RotationOnly => "rotation_only",
            CameraMotion::Static => "static",
        }
        .to_owned(),
        residual_px: sparse.residual_px,
        tracks: sparse.tracks.len(),
        points: sparse.tracks.iter().filter(|t| t.point.is_some()).count(),
        moving_tracks: dense.tracks.as_ref().map_or(0, Tracks::count),
        moving_share: moving as f64 / pixels.max(1) as f64,
        frontend: frontend.to_owned(),
        given: given.names(),
        confidence: Some(confidence),
    }
}
