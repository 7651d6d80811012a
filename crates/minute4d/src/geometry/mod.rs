//! The first stage: turns a video into a capture (poses, focal length, depth, motion masks).
//!
//! ```text
//! make      methods (frontend, segmenter, enhance) -> key -> CaptureFolder::stage
//! compute   video and what the user provides (given) -> clip -> reconstruction -> enhance -> capture on disk
//! classical     frames --sparse--> cameras, tracks, points --dense--> depth, masks --> capture
//!                            ^                                          |    '-> confidence
//!                            '---- once more without masked tracks -----'   (iterate)
//! megasam       frames --tracking network--> cameras --optical flow--> consistent depth --> capture
//! ```
//!
//! An interrupted stage resumes after the last of these steps (`steps`): optical flow of each pair of frames, depth from networks of each
//! frame, the reconstruction of cameras, and dense depth; the last two again for a second pass.

mod classical;
mod clip;
mod confidence;
mod depth;
mod frontend;
mod given;
mod iterate;
#[cfg(feature = "nets")]
mod megasam;
mod segmenter;

pub use confidence::{Confidence, Focal, Grade};
pub use frontend::{Frontend, Part as FrontendPart, UnknownFrontend, UsedNetwork};
#[cfg(feature = "nets")]
pub(crate) use frontend::{network, unusable};
pub use segmenter::Segmenter;
#[cfg(feature = "nets")]
pub(crate) use segmenter::resolve as resolve_segmenter;

use crate::device::{DeviceChoice, NetworkDevice};
use crate::enhance::{self, Before, EnhanceConfig, Tracker};
use crate::folder::CaptureFolder;
use crate::record::{GeometryRecord, GeometrySummary, Input, plain_json};
use crate::settings::part_to_toml;
use crate::steps::Steps;
use crate::{Category, Error, Job, Observer, Settings, hash};
use clip::{Between, Clip};
use given::Sources;
use m4_geometry::classical::dense::DenseError;
use m4_geometry::classical::sparse::SparseError;
use m4_geometry::megasam::MegasamError;
use m4_geometry::tracks::TrackError;
use segmenter::Resolved;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Name of the stage.
pub const STAGE: &str = "geometry";

/// The settings that this stage depends on.
#[derive(Serialize)]
struct Part<'a> {
    video: &'a m4_io::video::VideoOptions,
    sparse: &'a m4_geometry::classical::sparse::SparseConfig,
    dense: &'a m4_geometry::classical::dense::DenseConfig,
    /// Of random samples.
    seed: u64,
    /// The requested value.
    geometry: &'a GeometryOptions,
    /// What that came to: the front end's name, and the hashes of its weights.
    frontend: &'a str,
    weights: Vec<&'a str>,
    /// Where it has a way of its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    megasam: Option<&'a m4_geometry::megasam::MegasamSettings>,
    /// Where networks run: another device gives other last bits.
    device: &'a str,
    /// The same of what outlines the dynamic part.
    segmenter: &'a str,
    segmenter_weights: Option<&'a str>,
    /// What is done to its result, and by which networks.
    #[serde(skip_serializing_if = "Option::is_none")]
    enhance: Option<(&'a EnhanceConfig, &'a [UsedNetwork])>,
    /// Hashes of what the user gave.
    given: Sources,
}

/// Makes a capture of a video or a folder of images, or finds that it was made before.
///
/// # Errors
///
/// [`Error`]: the input cannot be read, the folder cannot be used, or nothing can be reconstructed.
pub fn make(input: &Path, capture: &Path, job: &Job<'_>) -> Result<GeometryRecord, Error> {
    if !input.exists() {
        return Err(Error::Missing { what: "video or folder of images", path: input.to_path_buf() });
    }
    let blake3 = hash::of_input(input, Some(capture), job.observer)?;
    of_source(input, Input { path: input.display().to_string(), blake3 }, capture, job)
}

/// The same of an `input` whose hash is in `source`.
pub(crate) fn of_source(input: &Path, source: Input, capture: &Path, job: &Job<'_>) -> Result<GeometryRecord, Error> {
    let mut settings = job.settings.clone();
    // flow tracks are computed with the depth, unless another method tracks points afterwards
    settings.dense.tracks &= !matches!(settings.geometry.tracker, Tracker::None | Tracker::Tapip3d);
    let methods = Methods::resolve(&settings.geometry, job.device.choice)?;
    let Methods { frontend, segmenter, enhance, device } = &methods;
    let name = frontend.frontend.to_string();
    let part = Part {
        video: &settings.video,
        sparse: &settings.sparse,
        dense: &settings.dense,
        seed: settings.sparse.seed,
        geometry: &settings.geometry,
        frontend: &name,
        weights: frontend.hashes(),
        megasam: (frontend.is_megasam()).then_some(&settings.megasam),
        device: device.name(),
        segmenter: segmenter.name(),
        segmenter_weights: segmenter.weights_hash(),
        enhance: (!enhance.nothing()).then_some((&settings.enhance, enhance.used.as_slice())),
        given: Sources::of(&settings.geometry)?,
    };
    let key = hash::of_parts(&[STAGE, env!("CARGO_PKG_VERSION"), &source.blake3, &part_to_toml(&part)?]);
    let record = GeometryRecord::begin(source, key, plain_json(&part)?);
    let inputs: Vec<&Path> = [input].into_iter().chain(job.settings.geometry.files()).collect();
    let mut folder = CaptureFolder::open(capture, job.existing, record, &inputs, job.observer)?;
    if let Some(earlier) = folder.reused(STAGE) {
        return Ok(earlier);
    }
    folder.stage(STAGE, |folder, steps| {
        for note in &frontend.notes {
            steps.observer().warn(note);
        }
        let context = Context { settings: &settings, methods: &methods, steps };
        folder.record.found = Some(compute(input, &folder.next(), &context)?);
        Ok(())
    })?;
    Ok(folder.record)
}

/// The methods that the options come to: which weights are installed, and the device of networks.
struct Methods {
    frontend: frontend::Plan,
    /// Sharpens the masks of the classical front end.
    segmenter: Resolved,
    /// What is done to the capture afterwards.
    enhance: enhance::Plan,
    device: NetworkDevice,
}

impl Methods {
    /// Resolves `options`; fails if weights are missing, the build has no networks, or the GPU does not start.
    fn resolve(options: &GeometryOptions, device: DeviceChoice) -> Result<Self, Error> {
        let frontend = frontend::plan(&options.frontend, device)?;
        // Masks are made of MegaSaM's map of motion afterwards.
        let (asked, before) = match frontend.is_megasam() {
            true => (Segmenter::None, Before::Motion),
            false => (options.segmenter, Before::Classical),
        };
        let segmenter = segmenter::resolve(asked)?;
        // Masks that the user gave stay.
        let refined = if options.masks.is_some() { Segmenter::None } else { options.segmenter };
        let enhance = enhance::Plan::of(refined, options.tracker, before)?;
        let device = if frontend.used.is_empty() && !enhance.has_network() {
            // A GPU that is not needed is not started, and does not count as a difference between results.
            NetworkDevice::processor()
        } else {
            device.for_networks()?
        };
        Ok(Self { frontend, segmenter, enhance, device })
    }
}

/// What all parts of the stage use.
#[derive(Clone, Copy)]
struct Context<'a> {
    settings: &'a Settings,
    methods: &'a Methods,
    steps: &'a Steps<'a>,
}

impl<'a> Context<'a> {
    /// Receives progress and warnings, and says when to stop.
    fn observer(&self) -> &'a dyn Observer {
        self.steps.observer()
    }
}

/// Reads the clip, finds its geometry (Minute4D Eq. 3), refines masks and tracks points as planned, and writes the capture into `folder`.
fn compute(input: &Path, folder: &Path, context: &Context<'_>) -> Result<GeometrySummary, Error> {
    let observer = context.observer();
    let between = Between::of(context.settings, &context.methods.frontend);
    let clip = Clip::read(input, between, context)?;
    let (capture, mut found) = match context.methods.frontend.is_megasam() {
        #[cfg(feature = "nets")]
        true => megasam::compute(clip, context)?,
        _ => classical::compute(clip, context)?,
    };
    let capture = between.keep(capture, observer)?;
    found.frames = capture.frames.len();
    let plan = &context.methods.enhance;
    let (capture, report) = enhance::apply(capture, plan, context.settings, &context.methods.device, context.steps)?;
    enhance::write(folder, &capture, report.as_ref(), observer)?;
    found.networks.extend(plan.used.iter().cloned());
    if report.is_some() {
        plan.segmenter().clone_into(&mut found.segmenter);
        found.moving_share = enhance::moving_share(&capture).unwrap_or(0.0);
    }
    if let Some(tracks) = &capture.tracks {
        found.moving_tracks = tracks.count();
    }
    Ok(found)
}

/// Methods of the geometry stage, and what the user knows already. Files are hashed with the input: another content is another
/// result.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryOptions {
    /// Front end.
    pub frontend: Frontend,
    /// Segmentation method.
    pub segmenter: Segmenter,
    /// Tracking method.
    pub tracker: Tracker,
    /// The lens: `fx,fy,cx,cy` in pixels of the frames (principal point from the image's corner), or a JSON file with
    /// `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`.
    pub intrinsics: Option<String>,
    /// Poses of the frames: a `transforms.json`.
    pub poses: Option<PathBuf>,
    /// A folder of masks, one a frame, not black where something moves.
    pub masks: Option<PathBuf>,
    /// A folder of depth maps, one a frame: greyscale PNG of 16 bits, millimetres of z-depth, 0 where unknown.
    pub depth: Option<PathBuf>,
}

impl GeometryOptions {
    /// The files and folders of the user among them.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        let intrinsics = self.intrinsics.as_deref().map(Path::new);
        let given = [self.poses.as_deref(), self.masks.as_deref(), self.depth.as_deref()];
        given.into_iter().flatten().chain(intrinsics.filter(|path| path.is_file()))
    }

    /// True when the user gave anything that replaces what would be computed.
    pub fn any_given(&self) -> bool {
        self.intrinsics.is_some() || self.poses.is_some() || self.masks.is_some() || self.depth.is_some()
    }
}

/// Why nothing could be reconstructed from a video.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReconstructionError {
    /// Cameras and tracks from a video.
    #[error(transparent)]
    Sparse(#[from] SparseError),
    /// Depth and masks from a video.
    #[error(transparent)]
    Dense(#[from] DenseError),
    /// MegaSaM's reconstruction failed.
    #[error(transparent)]
    Megasam(#[from] MegasamError),
}

impl ReconstructionError {
    /// Returns the category of the failure.
    pub fn category(&self) -> Category {
        match self {
            Self::Sparse(SparseError::Setting { .. }) | Self::Dense(DenseError::Setting { .. }) => {
                Category::BadSettings
            }
            Self::Sparse(SparseError::Cancelled)
            | Self::Dense(DenseError::Cancelled { .. } | DenseError::Tracks(TrackError::Cancelled { .. })) => {
                Category::Stopped
            }
            Self::Megasam(e) if e.is_stop() => Category::Stopped,
            Self::Sparse(_) | Self::Dense(_) | Self::Megasam(_) => Category::BadInput,
        }
    }
}
