//! Computes a capture from frames.

use super::between;
use super::confidence::{Confidence, Grade};
#[cfg(feature = "nets")]
use super::frontend::Cameras;
use super::frontend::{MonoClip, Plan};
use super::given::Given;
use super::iterate::{self, Change};
use super::kept::KeptFlow;
use super::scale::{depth_ratio, rescale, typical_depth};
use super::segmenter;
use crate::device::NetworkDevice;
use crate::record::GeometrySummary;
use crate::steps::Steps;
use crate::{Error, Observer, Settings, enhance};
use m4_core::{Capture, CaptureFrame, CompactMask, DepthMap, Progress, RgbImage, Tracks, Video};
use m4_geometry::dense::{self, Dense, DenseFrame, MonoDepth, NoDepth, SensorDepth, Sources, estimate_depth};
use m4_geometry::reconstruction::{CameraMotion, SparseReconstruction};
use m4_geometry::sparse::{self, FeatureTracks, Priors, Recovered, SparseConfig, SparseError, Work};
use m4_io::capture::Split;
use std::path::Path;

/// Given poses and given depth whose units differ by more than this factor do not fit.
const UNITS: f64 = 1.25;

/// A clip and what the user knows of it.
pub(super) struct Clip {
    pub video: Video,
    pub given: Given,
    /// The focal length in pixels of the frames that settings or the file state.
    pub focal_px: Option<f64>,
}

/// Reads the clip, finds geometry and writes the capture into `folder`.
pub(super) fn compute(
    input: &Path,
    folder: &Path,
    settings: &Settings,
    plan: &Plan,
    segmenter: &segmenter::Resolved,
    enhance: &enhance::Plan,
    device: &NetworkDevice,
    steps: &Steps<'_>,
    observer: &dyn Observer,
) -> Result<GeometrySummary, Error> {
    let between = between::Between::of(settings, plan);
    let video = m4_io::video::read(input, &between.to_read(&settings.video), observer)?;
    for warning in &video.warnings {
        observer.warn(warning);
    }
    let mut config = settings.sparse.clone();
    if config.fov_deg.is_none() && config.focal_px.is_none() {
        config.focal_px = video.focal_px;
    }
    let width = video.frames.first().map_or(0, |f| f.rgb.width());
    let focal_px = focal_px(&config, width);
    let given = Given::read(&settings.geometry, input, &video, settings.video.folder_fps, focal_px)?;
    if let Some(lens) = given.lens {
        config.intrinsics = Some([lens.fx, lens.fy, lens.cx, lens.cy]);
    }
    let clip = Clip { video, given, focal_px };
    #[cfg(feature = "nets")]
    if plan.cameras == Cameras::Megasam {
        let (capture, found) = super::megasam::compute(clip, settings, plan, device, steps, observer)?;
        return finish(capture, found, folder, settings, enhance, device, steps, observer);
    }
    let (capture, mut found) = classical(clip, settings, config, plan, segmenter, device, steps, observer)?;
    let capture = between.keep(capture, observer)?;
    found.frames = capture.frames.len();
    finish(capture, found, folder, settings, enhance, device, steps, observer)
}

/// Refines masks and follows points as planned, and writes the capture.
fn finish(
    capture: Capture,
    mut found: GeometrySummary,
    folder: &Path,
    settings: &Settings,
    plan: &enhance::Plan,
    device: &NetworkDevice,
    steps: &Steps<'_>,
    observer: &dyn Observer,
) -> Result<GeometrySummary, Error> {
    if plan.nothing() {
        m4_io::capture::write(folder, &capture, Split::Train, observer)?;
        return Ok(found);
    }
    let (capture, report) = enhance::apply(capture, plan, settings, device, steps)?;
    found.networks.extend(plan.used.iter().cloned());
    match &report {
        Some(report) => {
            found.segmenter = plan.segmenter().to_owned();
            let masks = capture.frames.iter().filter_map(|frame| frame.mask.as_ref());
            let pixels: usize = masks.clone().map(|mask| mask.size().0 * mask.size().1).sum();
            found.moving_share = masks.map(CompactMask::count).sum::<usize>() as f64 / pixels.max(1) as f64;
            enhance::save(folder, &capture, report, observer)?;
        }
        None => m4_io::capture::write(folder, &capture, Split::Train, observer)?,
    }
    if let Some(tracks) = &capture.tracks {
        found.moving_tracks = tracks.count();
    }
    Ok(found)
}

/// Cameras from tracked corners.
fn classical(
    clip: Clip,
    settings: &Settings,
    mut config: SparseConfig,
    plan: &Plan,
    segmenter: &segmenter::Resolved,
    device: &NetworkDevice,
    steps: &Steps<'_>,
    observer: &dyn Observer,
) -> Result<(Capture, GeometrySummary), Error> {
    let Clip { video, given, focal_px } = clip;
    let flow = plan.flow(settings.megasam.flow_iterations, device)?;
    let outlines = segmenter.load()?;
    let images: Vec<&RgbImage> = video.frames.iter().map(|f| &f.rgb).collect();
    let mono = match &given.depth {
        Some(_) => None,
        None => plan.depth(&images, focal_px, device, steps, observer)?,
    };
    if let Some(fov_rad) = mono.as_ref().and_then(|mono| mono.fov_rad) {
        config.default_fov_deg = fov_rad.to_degrees();
    }
    let flow = KeptFlow {
        source: flow.as_ref(),
        cache: steps,
    };
    let first = steps.part("first");
    let sources = Sources {
        segmenter: outlines.as_deref(),
        cache: &first,
        ..Sources::flow(&flow)
    };
    let depth = Depth::of(&given, mono);
    let known = Priors {
        masks: given.masks.as_deref(),
    };
    let (mut recovered, followed) = match &given.cameras {
        Some(cameras) => (
            steps.keep("cameras", |observer| {
                let work = Work {
                    progress: observer,
                    cache: &steps.part("cameras"),
                };
                sparse::with_cameras(&images, cameras, &known, &config, &work)
            })?,
            None,
        ),
        None => {
            let followed = steps.keep("corners", |observer| sparse::track_features(&images, &config, observer))?;
            let recovered = steps.keep("cameras", |observer| {
                let work = Work {
                    progress: observer,
                    cache: &steps.part("cameras"),
                };
                followed.recover(&known, &config, &work)
            })?;
            (recovered, Some(followed))
        }
    };
    let posed = given.cameras.is_some();
    let mut metric = finish_sparse(&mut recovered.sparse, &depth, posed, observer)?;
    let mut dense = dense_in_its_unit(&images, &recovered.sparse, &sources, &given, &depth, settings, observer)?;
    let mut rounds = 1;
    if let (Some(followed), None) = (followed, &given.masks)
        && let Some(better) = refine_with_masks(
            &followed,
            &recovered.sparse,
            &mut dense.frames,
            &config,
            steps,
            observer,
        )?
    {
        let second = steps.part("second");
        let sources = Sources {
            cache: &second,
            ..sources
        };
        drop(dense);
        recovered = better;
        metric = finish_sparse(&mut recovered.sparse, &depth, posed, observer)?;
        dense = dense_in_its_unit(&images, &recovered.sparse, &sources, &given, &depth, settings, observer)?;
        rounds = 2;
    }
    let sparse = recovered.sparse;
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
    let found = summary(&sparse, &dense, plan, segmenter.name(), &given, rounds, confidence);
    drop(images);
    Ok((assemble(video, &sparse, dense, metric), found))
}

/// Says what is doubtful, and takes the unit of depth that is known; true if lengths are metres then.
fn finish_sparse(
    sparse: &mut SparseReconstruction,
    depth: &Depth<'_>,
    posed: bool,
    observer: &dyn Observer,
) -> Result<bool, Error> {
    for warning in &sparse.warnings {
        observer.warn(warning);
    }
    match depth {
        Depth::Given(maps) => to_metres(sparse, maps, posed, observer).map(|()| true),
        Depth::Network(mono) => Ok(mono
            .metric_m()
            .is_some_and(|maps| !posed && to_metres_by_networks(sparse, maps, observer))),
        Depth::Unknown => Ok(false),
    }
}

/// Brings a reconstruction to the metres of a network's depth; false where too few of its points have any.
fn to_metres_by_networks(sparse: &mut SparseReconstruction, maps: &[DepthMap], observer: &dyn Observer) -> bool {
    if sparse.camera_motion != CameraMotion::Parallax {
        return false;
    }
    match depth_ratio(sparse, maps) {
        Ok(ratio) => {
            *sparse = rescale(sparse, ratio);
            true
        }
        Err(error) => {
            observer.warn(&format!("lengths stay without unit: {error}"));
            false
        }
    }
}

/// Cameras found without what the masks cover, if they differ enough for depth and masks to be computed again.
fn refine_with_masks(
    followed: &FeatureTracks,
    first: &SparseReconstruction,
    frames: &mut [DenseFrame],
    config: &SparseConfig,
    steps: &Steps<'_>,
    observer: &dyn Observer,
) -> Result<Option<Recovered>, Error> {
    const PHASE: &str = "cameras from static points";
    let masks = iterate::take_masks(frames);
    let mut found = None;
    if iterate::worth(first, &masks) {
        observer.update(PHASE, 0, 1, "");
        let known = Priors { masks: Some(&masks) };
        // The warnings of the second pass repeat those of the first, or are given when its result is used.
        let second = steps.keep("second-cameras", |observer| {
            let work = Work {
                progress: &NoWarnings(observer),
                cache: &steps.part("second-cameras"),
            };
            match followed.recover(&known, config, &work) {
                Err(stop @ SparseError::Cancelled) => Err(stop),
                other => Ok(other.ok().filter(|r| r.sparse.camera_motion == CameraMotion::Parallax)),
            }
        })?;
        let change = second
            .as_ref()
            .map(|second| Change::between(first, &second.sparse, |track| iterate::within(&masks, track)));
        observer.update(
            PHASE,
            1,
            1,
            &change.map_or_else(String::new, |change| change.description()),
        );
        found = second.filter(|_| change.is_some_and(|change| change.matters()));
    }
    iterate::put_back(frames, masks);
    Ok(found)
}

/// Passes on all but warnings.
struct NoWarnings<'a>(&'a dyn Observer);

impl Progress for NoWarnings<'_> {
    fn update(&self, phase: &str, done: usize, total: usize, note: &str) {
        self.0.update(phase, done, total, note);
    }

    fn warn(&self, _: &str) {}

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
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
    images: &[&RgbImage],
    sparse: &SparseReconstruction,
    sources: &Sources<'_>,
    given: &Given,
    depth: &Depth<'_>,
    settings: &Settings,
    observer: &dyn Observer,
) -> Result<Dense, Error> {
    let maps = depth.metric_m();
    let unit = if given.cameras.is_some() || maps.is_some() {
        typical_depth(sparse, maps)
    } else {
        1.0
    };
    let scaled = (unit != 1.0).then(|| rescale(sparse, 1.0 / unit));
    let sensor;
    let mono: &dyn MonoDepth = match depth {
        Depth::Given(maps) => {
            let maps = maps.iter().map(|map| map.map(|z| z / unit as f32)).collect();
            sensor = SensorDepth { maps };
            &sensor
        }
        // Known up to a factor a frame, or more: in any unit.
        Depth::Network(mono) => mono,
        Depth::Unknown => &NoDepth,
    };
    let known = dense::UserMasks {
        masks: given.masks.as_deref(),
    };
    let sparse = scaled.as_ref().unwrap_or(sparse);
    let sources = Sources { mono, ..*sources };
    let mut dense = estimate_depth(images, sparse, &sources, &known, &settings.dense, observer)?;
    if unit != 1.0 {
        for z in dense.frames.iter_mut().flat_map(|f| f.depth.data_mut()) {
            *z *= unit as f32;
        }
        dense.tracks = dense.tracks.map(|tracks| tracks.scaled(unit as f32));
    }
    Ok(dense)
}

/// Who knows depth without parallax.
enum Depth<'a> {
    /// The user, metres.
    Given(&'a [DepthMap]),
    /// Networks.
    Network(MonoClip),
    /// None.
    Unknown,
}

impl<'a> Depth<'a> {
    fn of(given: &'a Given, mono: Option<MonoClip>) -> Self {
        match (given.depth.as_deref(), mono) {
            (Some(maps), _) => Self::Given(maps),
            (None, Some(mono)) => Self::Network(mono),
            (None, None) => Self::Unknown,
        }
    }

    fn metric_m(&self) -> Option<&[DepthMap]> {
        match self {
            Self::Given(maps) => Some(maps),
            Self::Network(mono) => mono.metric_m(),
            Self::Unknown => None,
        }
    }
}

/// Share of the pixels whose depth was given.
fn known_share(depth: &[DepthMap]) -> f64 {
    let pixels = depth.iter().map(|d| d.data().len()).sum::<usize>().max(1);
    let known = depth.iter().flat_map(|d| d.data()).filter(|&&z| z > 0.0).count();
    known as f64 / pixels as f64
}

/// When each frame was taken, seconds.
pub(super) fn instants(video: &Video) -> Vec<f64> {
    video.frames.iter().map(|f| f.time_s).collect()
}

/// The same in frames of the video, 0 to the number of frames less one, and how long it lasts, seconds.
pub(super) fn moments(video: &Video) -> (Vec<f64>, Option<f64>) {
    let times_s = instants(video);
    let (first_s, last_s) = (times_s.first().copied(), times_s.last().copied());
    let duration_s = last_s.unwrap_or(0.0) - first_s.unwrap_or(0.0);
    let last = times_s.len().saturating_sub(1) as f64;
    let moment = |(i, time_s): (usize, &f64)| {
        if duration_s > 0.0 {
            ((time_s - first_s.unwrap_or(0.0)) / duration_s * last).clamp(0.0, last)
        } else {
            i as f64
        }
    };
    let moments = times_s.iter().enumerate().map(moment).collect();
    (moments, (duration_s > 0.0).then_some(duration_s))
}

fn assemble(video: Video, sparse: &SparseReconstruction, dense: Dense, metric: bool) -> Capture {
    let n = video.frames.len();
    let (moments, duration_s) = moments(&video);
    let frames = video
        .frames
        .into_iter()
        .zip(dense.frames)
        .zip(&sparse.cameras)
        .enumerate();
    let frames = frames.map(|(i, ((frame, dense), camera))| CaptureFrame {
        name: format!("{i:05}"),
        camera: *camera,
        t: moments[i],
        rgb: frame.rgb,
        depth: Some(dense.depth.into()),
        mask: Some(dense.mask.into()),
        motion: None,
        instances: None,
        camera_index: None,
    });
    Capture {
        frames: frames.collect(),
        time_frames: n,
        duration_s,
        metric,
        tracks: dense.tracks,
    }
}

fn summary(
    sparse: &SparseReconstruction,
    dense: &Dense,
    plan: &Plan,
    segmenter: &str,
    given: &Given,
    rounds: usize,
    confidence: Confidence,
) -> GeometrySummary {
    let lens = sparse.cameras.first().map(|c| c.intrinsics);
    let pixels: usize = dense.frames.iter().map(|d| d.mask.data().len()).sum();
    let moving = dense
        .frames
        .iter()
        .flat_map(|d| d.mask.data())
        .filter(|&&m| m != 0)
        .count();
    GeometrySummary {
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
        frontend: plan.frontend.to_string(),
        networks: plan.used.clone(),
        keyframes: None,
        megasam_units_a_metre: None,
        segmenter: segmenter.to_owned(),
        given: given.names(),
        rounds,
        confidence: Some(confidence),
    }
}
