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

mod between;
mod cached_flow;
mod classical;
mod clip;
mod compute;
mod confidence;
mod depth;
mod error;
mod frontend;
mod given;
mod iterate;
#[cfg(feature = "nets")]
mod megasam;
mod methods;
mod options;
mod scale;
mod segmenter;

pub use confidence::{Confidence, Focal, Grade};
pub use error::ReconstructionError;
pub use frontend::{Frontend, Part as FrontendPart, UnknownFrontend, UsedNetwork};
pub use given::GivenError;
pub use options::GeometryOptions;
pub use segmenter::Segmenter;
pub(crate) use segmenter::resolve as resolve_segmenter;

use crate::capture_folder::CaptureFolder;
use crate::enhance::{EnhanceConfig, Tracker};
use crate::record::{GeometryRecord, Input, plain_json};
use crate::settings::part_to_toml;
use crate::{Error, Job, hash};
use compute::compute;
use frontend::Cameras;
use given::Sources;
use methods::{Context, Methods};
use serde::Serialize;
use std::path::Path;

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
        return Err(Error::Missing {
            what: "video or folder of images",
            path: input.to_path_buf(),
        });
    }
    let mut settings = job.settings.clone();
    // flow tracks are computed with the depth, unless another method tracks points afterwards
    settings.dense.tracks &= !matches!(settings.geometry.tracker, Tracker::None | Tracker::Tapip3d);
    let methods = Methods::resolve(&settings.geometry, job.device.choice)?;
    let Methods {
        frontend,
        segmenter,
        enhance,
        device,
    } = &methods;
    let name = frontend.frontend.to_string();
    let part = Part {
        video: &settings.video,
        sparse: &settings.sparse,
        dense: &settings.dense,
        seed: settings.sparse.seed,
        geometry: &settings.geometry,
        frontend: &name,
        weights: frontend.hashes(),
        megasam: (frontend.cameras == Cameras::Megasam).then_some(&settings.megasam),
        device: device.name(),
        segmenter: segmenter.name(),
        segmenter_weights: segmenter.weights_hash(),
        enhance: (!enhance.nothing()).then_some((&settings.enhance, enhance.used.as_slice())),
        given: Sources::of(&settings.geometry)?,
    };
    let source = Input {
        path: input.display().to_string(),
        blake3: hash::of_path(input)?,
    };
    let key = hash::of_parts(&[STAGE, env!("CARGO_PKG_VERSION"), &source.blake3, &part_to_toml(&part)?]);
    let record = GeometryRecord::begin(source, key, plain_json(&part)?);
    let mut folder = CaptureFolder::open(capture, job.existing, record, job.observer)?;
    if let Some(earlier) = folder.reused(STAGE) {
        return Ok(earlier);
    }
    folder.stage(STAGE, |folder, steps| {
        for note in &frontend.notes {
            steps.observer().warn(note);
        }
        let context = Context {
            settings: &settings,
            methods: &methods,
            steps,
        };
        folder.record.found = Some(compute(input, &folder.path, &context)?);
        Ok(())
    })?;
    Ok(folder.record)
}
