//! The file `metadata`.

use crate::capture::Axes;
use crate::dataset::files::{Members, clock, lens, parse_json, pose};
use crate::dataset::{Lens, ReadSourceError, SourceErrorCause};
use m4_core::{Intrinsics, Se3};
use serde::Deserialize;
use std::path::Path;

/// Largest metadata: a frame takes some 300 bytes.
const MAX_BYTES: u64 = 64 << 20;
/// Depth of the rear sensor where the file, of an early version, does not say: long and short side.
const SENSOR: (usize, usize) = (256, 192);
/// Longest side of depth maps, pixels; sensors have 640 at most.
const MAX_SENSOR_SIDE: usize = 4096;
const HINT: &str = "export the recording again as .r3d";

#[derive(Deserialize)]
pub(super) struct Metadata {
    w: usize,
    h: usize,
    dw: Option<usize>,
    dh: Option<usize>,
    pub fps: Option<f64>,
    #[serde(rename = "K")]
    k: [f64; 9],
    pub poses: Vec<[f64; 7]>,
    #[serde(rename = "perFrameIntrinsicCoeffs")]
    coefficients: Option<Vec<[f64; 4]>>,
    #[serde(rename = "frameTimestamps")]
    timestamps: Option<Vec<f64>>,
}

/// When frames were taken.
pub(super) struct Clock {
    /// Frames, 0 to the number of frames - 1.
    pub t: Vec<f64>,
    pub duration_s: Option<f64>,
}

impl Metadata {
    pub(super) fn read(members: &Members, path: &Path) -> Result<Self, ReadSourceError> {
        let bytes = members.read("metadata", MAX_BYTES).map_err(|e| e.at(path))?;
        let bytes = bytes.ok_or_else(|| SourceErrorCause::missing("metadata", HINT).at(path))?;
        let bad = |what: String| SourceErrorCause::bad(what, HINT).within(path, "metadata");
        let text = std::str::from_utf8(&bytes).map_err(|e| bad(format!("it is not text ({e})")))?;
        let metadata: Self = parse_json(text, &path.join("metadata"))?;
        let n = metadata.poses.len();
        for (key, count) in [
            ("perFrameIntrinsicCoeffs", metadata.coefficients.as_ref().map(Vec::len)),
            ("frameTimestamps", metadata.timestamps.as_ref().map(Vec::len)),
        ] {
            // an empty list stands for none
            if let Some(count) = count.filter(|&c| c != n && c != 0) {
                return Err(bad(format!("{key} has {count} entries for {n} poses")));
            }
        }
        let k = &metadata.k;
        if [k[1], k[2], k[3], k[5]] != [0.0; 4] || k[8] != 1.0 {
            return Err(bad(format!("K is {k:?}; fx 0 0, 0 fy 0, cx cy 1 was expected")));
        }
        let side = |v: usize| (1..=1 << 16).contains(&v);
        let (dw, dh) = metadata.depth_size();
        let sensed = |v: usize| (1..=MAX_SENSOR_SIDE).contains(&v);
        if !(side(metadata.w) && side(metadata.h) && sensed(dw) && sensed(dh)) {
            return Err(bad(format!(
                "images of {} x {} and depth of {dw} x {dh} pixels",
                metadata.w, metadata.h
            )));
        }
        if (dw > dh) != (metadata.w > metadata.h) {
            return Err(bad(format!(
                "images of {} x {} but depth of {dw} x {dh} pixels: one of them was rotated",
                metadata.w, metadata.h
            )));
        }
        Ok(metadata)
    }

    /// Width and height of depth maps.
    pub(super) fn depth_size(&self) -> (usize, usize) {
        let (long, short) = SENSOR;
        let (w, h) = if self.w > self.h { (long, short) } else { (short, long) };
        (self.dw.unwrap_or(w), self.dh.unwrap_or(h))
    }

    /// Of images of `w x h`.
    pub(super) fn intrinsics(&self, n: usize) -> Result<Intrinsics, SourceErrorCause> {
        let own = self.coefficients.as_ref().and_then(|c| c.get(n));
        let numbers = own.copied().unwrap_or([self.k[0], self.k[4], self.k[6], self.k[7]]);
        let k = lens::pinhole(numbers, (self.w, self.h));
        Lens::pinhole(k)
            .check()
            .map_err(|what| SourceErrorCause::bad(what, HINT))?;
        Ok(k)
    }

    /// The pose of frame `n`, which there is.
    pub(super) fn c2w(&self, n: usize) -> Result<Se3<f64>, SourceErrorCause> {
        let Some(&[qx, qy, qz, qw, x, y, z]) = self.poses.get(n) else {
            return Err(SourceErrorCause::missing("the pose", HINT));
        };
        let arkit = pose::of_quaternion([x, y, z], [qw, qx, qy, qz])?;
        Ok(Axes::OpenGl.to_opencv(&arkit))
    }

    /// When `frames` were taken: by their time stamps, else evenly.
    pub(super) fn clock(&self, frames: &[usize], fps: Option<f64>, path: &Path) -> Result<Clock, ReadSourceError> {
        let bad = |what: String| Err(SourceErrorCause::bad(what, HINT).within(path, "metadata"));
        let steps = (frames.len() - 1) as f64;
        if let Some(fps) = fps.filter(|v| !(v.is_finite() && *v > 0.0)) {
            return bad(format!("fps is {fps}; frames per second, above 0, were expected"));
        }
        let stamps = self.timestamps.as_ref().filter(|s| !s.is_empty());
        let Some(stamps) = stamps else {
            return Ok(Clock {
                t: (0..frames.len()).map(|i| i as f64).collect(),
                duration_s: fps.map(|fps| steps / fps),
            });
        };
        let times: Vec<f64> = frames.iter().filter_map(|&n| stamps.get(n)).copied().collect();
        let apart = times.windows(2).all(|p| p[1] > p[0]) && times.iter().all(|t| t.is_finite());
        if times.len() != frames.len() || !apart {
            return bad("frameTimestamps do not grow from frame to frame".into());
        }
        let (t, span_s) = clock::in_frames(&times);
        Ok(Clock {
            t,
            duration_s: Some(span_s),
        })
    }
}
