//! Checks whether a capture can be written.

use super::WriteCaptureAsError;
use crate::scene::cameras_check::usable;
use m4_core::{Capture, Exposure, SourceFrame};
use std::path::Path;

/// Refuses captures without frames, and cameras that are none.
pub(super) fn check(out: &Path, capture: &Capture) -> Result<(), WriteCaptureAsError> {
    let bad = |what: String| WriteCaptureAsError::BadCapture {
        path: out.to_path_buf(),
        what,
    };
    if capture.frames.is_empty() {
        return Err(bad("the capture has no frames".to_owned()));
    }
    let last = capture.time_frames.max(2) as f64 - 1.0;
    for (i, frame) in capture.frames.iter().enumerate() {
        if !(0.0..=last).contains(&frame.t) {
            return Err(bad(format!(
                "frame {i} ({}) was taken at t = {}; 0 to {last} frames were expected",
                frame.name, frame.t
            )));
        }
        let maps = [
            frame.depth.as_ref().map(|d| d.size()),
            frame.mask.as_ref().map(|m| m.size()),
        ];
        if maps.into_iter().flatten().any(|(w, h)| w == 0 || h == 0) {
            return Err(bad(format!(
                "a depth map or mask of frame {i} ({}) has no pixels",
                frame.name
            )));
        }
        let camera = frame.camera;
        let seen = SourceFrame {
            camera,
            t: frame.t,
            exposure: Exposure::IDENTITY,
        };
        if !usable(&seen) {
            return Err(bad(format!(
                "the camera of frame {i} ({}) is none: {camera:?}",
                frame.name
            )));
        }
        let k = &camera.intrinsics;
        if frame.rgb.size() != (k.width, k.height) {
            let (w, h) = frame.rgb.size();
            return Err(bad(format!(
                "the image of frame {i} ({}) is {w} x {h} pixels and its camera {} x {}",
                frame.name, k.width, k.height
            )));
        }
    }
    Ok(())
}
