//! Reads a `.4dgs` file as a scene.

use super::convert::{BadField, Clip, from_set};
use super::notes::{self, MAX_FRAMES};
use super::{ReadFourdgsError, budget, cameras};
use crate::scene::{DEFAULT_FPS, Imported, Loss};
use ::fourdgs::error::RefusalKind;
use ::fourdgs::stream_reader::{ReadOptions, read_from};
use m4_core::Scene;
use std::path::Path;

/// Near plane where the file does not say, world units.
const NEAR: f32 = 0.01;

/// Reads a file of any writer.
///
/// # Errors
///
/// [`ReadFourdgsError`] if the file is missing, damaged, or of a kind that is not known here.
pub fn read(path: &Path) -> Result<Imported, ReadFourdgsError> {
    let bytes = crate::scene::file::load(path).map_err(|source| ReadFourdgsError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    parse(path, &bytes)
}

/// The scene in the bytes of a file; `path` is for messages alone.
///
/// # Errors
///
/// As [`read`]. Decoding allocates no more than 48 MiB and 96 bytes per byte of the file.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Imported, ReadFourdgsError> {
    budget::check(bytes).map_err(|over| ReadFourdgsError::TooLarge {
        path: path.to_path_buf(),
        needed: over.needed,
        allowed: over.allowed,
        len: bytes.len() as u64,
    })?;
    let options = ReadOptions {
        recover_truncated: false,
        ..ReadOptions::default()
    };
    let file = read_from(bytes, &options).map_err(|e| refused(path, e))?;
    let unsupported = |reason: String| ReadFourdgsError::Unsupported {
        path: path.to_path_buf(),
        reason,
    };
    if !file.objects.tracks.is_empty() {
        return Err(unsupported("its splats are moved by the tracks of objects".to_owned()));
    }
    let damaged = |reason: String| ReadFourdgsError::Damaged {
        path: path.to_path_buf(),
        reason,
    };
    let facts = notes::read(&file.metadata);
    let clip = clip(file.header.duration_sec, &facts)
        .ok_or_else(|| damaged(format!("it says that it lasts {} s", file.header.duration_sec)))?;
    let mut losses = Vec::new();
    if !file.audio_sources.is_empty() {
        losses.push(Loss::Dropped("the sound".to_owned()));
    }
    let source = cameras::source(&file.provenance, &clip, &mut losses);
    let up = cameras::up(
        &file.provenance,
        file.header.attributes.get("coordinate_system").map(String::as_str),
    );
    let (splats, changed) = from_set(&file.gaussians, &clip, file.header.cutoff).map_err(|bad| {
        let BadField { splat, field, value } = bad;
        ReadFourdgsError::BadValue {
            path: path.to_path_buf(),
            splat,
            field,
            value,
        }
    })?;
    losses.extend(changed);
    if file
        .header
        .attributes
        .get("color_space")
        .is_some_and(|s| s.starts_with("linear"))
    {
        losses.push(Loss::Dropped(
            "that its colours are linear light: they are shown as sRGB values".to_owned(),
        ));
    }
    let steps = clip.frames.saturating_sub(1) as f64;
    let duration_s = match facts.time_frames {
        Some(_) => facts.duration_s,
        None => Some(steps * clip.step_s),
    };
    Ok(Imported {
        scene: Scene {
            splats,
            background: facts.background.unwrap_or([0.0; 3]),
            time_frames: clip.frames,
            duration_s,
            mip: facts.mip.unwrap_or(false),
            near: facts.near.unwrap_or(NEAR),
            source,
        },
        up,
        losses,
    })
}

/// Frames and their length: those of our own writer, else 30 per second.
fn clip(duration_s: f64, facts: &notes::Notes) -> Option<Clip> {
    if !(duration_s.is_finite() && duration_s >= 0.0) {
        return None;
    }
    let assumed = 1.0 / DEFAULT_FPS;
    if let Some(frames) = facts.time_frames {
        let steps = frames.saturating_sub(1) as f64;
        let step_s = match facts.duration_s {
            Some(s) if s > 0.0 && steps > 0.0 => s / steps,
            _ => assumed,
        };
        return Some(Clip { step_s, frames });
    }
    let frames = (duration_s * DEFAULT_FPS).round();
    (frames <= MAX_FRAMES as f64).then(|| Clip {
        step_s: assumed,
        frames: (frames as usize).max(1),
    })
}

fn refused(path: &Path, error: ::fourdgs::Error) -> ReadFourdgsError {
    use ::fourdgs::Error as E;
    let path = path.to_path_buf();
    let reason = error.to_string();
    match error {
        E::UnsupportedVersion(_) | E::UnsupportedCodec(_) | E::UnsupportedModel(_) | E::UnsupportedOperation(_) => {
            ReadFourdgsError::Unsupported { path, reason }
        }
        E::Refused {
            kind: RefusalKind::UnsupportedVersion | RefusalKind::UnsupportedModel | RefusalKind::UnsupportedCodec,
            ..
        } => ReadFourdgsError::Unsupported { path, reason },
        _ => ReadFourdgsError::Damaged { path, reason },
    }
}
