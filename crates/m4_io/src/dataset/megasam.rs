//! Files of MegaSaM; see [`crate::megasam`] for their layout and what is converted.

use crate::dataset::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceFault};
use crate::megasam::{self, MegasamFault, MegasamOptions};
use crate::npy::Npz;
use m4_core::{Capture, Progress};
use std::path::Path;

/// Whether it is a folder of reconstructions, or an archive with `cam_c2w`.
pub(super) fn detect(path: &Path) -> bool {
    let known = megasam::detect(path).is_some();
    known && (path.is_dir() || matches!(Npz::open(path), Ok(Ok(npz)) if npz.has("cam_c2w")))
}

pub(super) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    let megasam_options = MegasamOptions {
        fps: options.fps,
        tau_motion: options.tau_motion,
        motion: None,
        max_memory_bytes: options.max_memory_bytes,
    };
    let capture = megasam::read(path, &megasam_options, progress).map_err(|e| {
        let file = e.path.clone();
        match e.fault {
            MegasamFault::Io(source) => SourceFault::Io(source).at(&file),
            MegasamFault::Cancelled => SourceFault::Cancelled.at(&file),
            MegasamFault::TooLarge {
                what,
                needed_bytes,
                limit_bytes,
            } => SourceFault::TooLarge {
                what,
                needed_bytes,
                limit_bytes,
            }
            .at(&file),
            other => SourceFault::bad(other.to_string(), "give the files that MegaSaM wrote, whole").at(&file),
        }
    })?;
    Ok(listing(capture))
}

/// A capture that is read already, as a listing.
fn listing(capture: Capture) -> Listing {
    let frames = capture.frames.into_iter().map(|frame| ListedFrame {
        name: frame.name,
        lens: Lens::pinhole(frame.camera.intrinsics),
        c2w: frame.camera.c2w,
        t: frame.t,
        rgb: FrameSource::held(frame.rgb),
        depth: frame.depth.map(FrameSource::held),
        mask: frame.mask.map(FrameSource::held),
        motion: frame.motion.map(FrameSource::held),
        instances: frame.instances.map(FrameSource::held),
        camera_index: frame.camera_index,
    });
    Listing {
        train: frames.collect(),
        test: Vec::new(),
        time_frames: capture.time_frames,
        duration_s: capture.duration_s,
        metric: capture.metric,
        tracks: capture.tracks,
    }
}
