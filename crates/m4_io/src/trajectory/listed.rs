//! `transforms.json` as a list of cameras, one per image.

use super::file::BadPath;
use super::keyed::side;
use crate::capture::Pose;
use crate::dataset::Distortion;
use crate::dataset::nerfstudio::{Frame, LensKeys, Transforms, lens};
use m4_core::{Camera, Intrinsics};

/// The cameras with the moment of each: `time` (0..1) of the file times `last_frame`.
pub fn listed(file: Transforms, last_frame: f64) -> Result<Vec<(Camera, f64)>, BadPath> {
    let mut frames = Vec::with_capacity(file.frames.len());
    for (i, value) in file.frames.into_iter().enumerate() {
        let frame: Frame = serde_json::from_value(value).map_err(|e| (i, e.to_string()))?;
        frames.push(frame);
    }
    let timed = frames.iter().filter(|f| f.time.is_some()).count();
    let all = frames
        .iter()
        .enumerate()
        .map(|(i, frame)| -> Result<(Camera, f64), BadPath> {
            let bad = |what: String| (i, what);
            let time = match frame.time {
                Some(time) => time,
                None if timed == 0 => i as f64 / (frames.len().max(2) - 1) as f64,
                None => return Err(bad(format!("time is missing, but {timed} other cameras have one")).into()),
            };
            if !(0.0..=1.0).contains(&time) {
                return Err(bad(format!("time = {time}; 0 to 1 was expected")).into());
            }
            let rows = frame.transform_matrix.as_ref();
            let rows = rows.ok_or_else(|| bad("transform_matrix is missing".into()))?;
            let Pose(pose) = Pose::from_rows(rows).map_err(|e| bad(format!("transform_matrix {e}")))?;
            let camera = Camera {
                intrinsics: intrinsics(frame, &file.lens).map_err(bad)?,
                c2w: file.axes.unwrap_or_default().to_opencv(&pose),
            };
            Ok((camera, time * last_frame))
        });
    all.collect()
}

fn intrinsics(frame: &Frame, all: &LensKeys) -> Result<Intrinsics, String> {
    let keys = frame.lens.or(all);
    let pixels = |key: &str, value: Option<f64>| {
        let value = value.ok_or_else(|| format!("{key}, the size of the image in pixels, is missing"))?;
        side(key, value)
    };
    let size = (pixels("w", keys.w)?, pixels("h", keys.h)?);
    let lens = lens::of(&keys, size).map_err(|e| e.to_string())?;
    if lens.distortion != Distortion::None {
        return Err("the lens has distortion; only cameras without distortion are rendered".into());
    }
    Ok(lens.intrinsics)
}
