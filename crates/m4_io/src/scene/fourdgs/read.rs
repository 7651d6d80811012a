//! Reads a `.4dgs` file as a scene.

use super::cameras;
use super::cameras::{MAX_FRAMES, Notes};
use super::convert::{ClipTime, from_set};
use crate::error::AtPath;
use crate::files;
use crate::scene::valid::fault;
use crate::scene::{DEFAULT_FPS, Imported, Loss};
use crate::{Fault, ReadError};
use ::fourdgs::error::RefusalKind;
use ::fourdgs::opcode;
use ::fourdgs::records::parse_chunk;
use ::fourdgs::serialization::{MAGIC, Records, STREAM_HEADER_SIZE};
use ::fourdgs::stream_reader::{ReadOptions, read_from};
use m4_core::Scene;
use std::path::Path;

/// Near plane where the file does not say, world units.
const NEAR: f32 = 0.01;

/// Reads a file of any writer. Fails if the file is missing, damaged, or of a kind that is not
/// known here.
pub fn read(path: &Path) -> Result<Imported, ReadError> {
    parse(path, &files::read(path, u64::MAX).at(path)?)
}

/// The scene in the bytes of a file; allocates at most 48 MiB and 96 bytes per byte. `path` is for
/// messages alone.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Imported, ReadError> {
    scene_of(bytes).at(path)
}

fn unsupported(reason: impl Into<String>) -> Fault {
    Fault::unsupported(
        reason,
        "write it again as .4dgs version 1 with the model gaussian-birth and deflate streams",
    )
}

fn scene_of(bytes: &[u8]) -> Result<Imported, Fault> {
    budget(bytes)?;
    let options = ReadOptions {
        recover_truncated: false,
        ..ReadOptions::default()
    };
    let file = read_from(bytes, &options).map_err(|e| refused(&e))?;
    if !file.objects.tracks.is_empty() {
        return Err(unsupported("its splats are moved by the tracks of objects"));
    }
    let facts = Notes::read(&file.metadata);
    let clip = clip(file.header.duration_sec, &facts).ok_or_else(|| {
        Fault::damaged(format!(
            "it says that it lasts {} s",
            file.header.duration_sec
        ))
    })?;
    let mut losses = Vec::new();
    if !file.audio_sources.is_empty() {
        losses.push(Loss::Dropped("the sound".to_owned()));
    }
    let source = cameras::source(&file.provenance, &clip, &mut losses);
    let up = cameras::up(
        &file.provenance,
        file.header
            .attributes
            .get("coordinate_system")
            .map(String::as_str),
    );
    let (splats, changed) =
        from_set(&file.gaussians, &clip, file.header.cutoff).map_err(Fault::damaged)?;
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
    let scene = Scene {
        splats,
        background: facts.background.unwrap_or([0.0; 3]),
        time_frames: clip.frames,
        duration_s,
        mip: facts.mip.unwrap_or(false),
        near: facts.near.unwrap_or(NEAR),
        source,
    };
    match fault(&scene) {
        Some(reason) => Err(Fault::damaged(reason)),
        None => Ok(Imported { scene, up, losses }),
    }
}

/// Frames and their length: those of our own writer, else 30 per second.
fn clip(duration_s: f64, facts: &Notes) -> Option<ClipTime> {
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
        return Some(ClipTime { step_s, frames });
    }
    let frames = (duration_s * DEFAULT_FPS).round();
    (frames <= MAX_FRAMES as f64).then(|| ClipTime {
        step_s: assumed,
        frames: (frames as usize).max(1),
    })
}

fn refused(error: &::fourdgs::Error) -> Fault {
    use ::fourdgs::Error as E;
    use RefusalKind::{UnsupportedCodec, UnsupportedModel, UnsupportedVersion};
    let reason = error.to_string();
    match error {
        E::UnsupportedVersion(_)
        | E::UnsupportedCodec(_)
        | E::UnsupportedModel(_)
        | E::UnsupportedOperation(_) => unsupported(reason),
        E::Refused {
            kind: UnsupportedVersion | UnsupportedModel | UnsupportedCodec,
            ..
        } => unsupported(reason),
        _ => Fault::damaged(reason),
    }
}

/// Memory that any file may ask for, bytes.
const FREE: u64 = 48 << 20;
/// Memory that a byte of the file may ask for: splats take 8 to 15 bytes there and about 600 while
/// they are decoded.
const PER_BYTE: u64 = 96;
/// A splat of a scene, of its chunk before, and of the columns after.
const PER_SPLAT: u64 = 2 * 76 + 100;
/// A symbol of a stream: eight bytes decoded, up to four raw.
const PER_SYMBOL: u64 = 12;

/// Refuses a file whose records claim more than it may ask for. The decoder of the `fourdgs` crate
/// stops at half a gigabyte, whatever the size of the file; streams with one constant row let a
/// kilobyte ask for that much. Whatever does not parse is left to the decoder, which refuses it at
/// that place without having allocated for what follows.
fn budget(bytes: &[u8]) -> Result<(), Fault> {
    let allowed = FREE + PER_BYTE * bytes.len() as u64;
    let (mut bytes_kept, mut largest) = (0u64, 0u64);
    let body = bytes.get(MAGIC.len()..).unwrap_or_default();
    for record in Records::new(body, 0) {
        let Ok(record) = record else { break };
        match record.opcode {
            opcode::CHUNK => {
                let Ok((head, streams)) = parse_chunk(record.content) else {
                    break;
                };
                bytes_kept = bytes_kept.saturating_add(u64::from(head.count) * PER_SPLAT);
                // A chunk that is compressed as a whole hides its streams; each symbol in it is a
                // byte at least.
                let symbols = if head.compression.is_empty() {
                    stream_symbols(streams, u64::from(head.count))
                } else {
                    head.uncompressed_size
                        .saturating_add(u64::from(head.count).saturating_mul(26))
                };
                largest = largest.max(symbols.saturating_mul(PER_SYMBOL));
            }
            // Bands are kept, decoded, until the last chunk.
            opcode::SH_BAND_STREAM => {
                let symbols = stream_symbols(record.content.get(1..).unwrap_or_default(), u64::MAX);
                bytes_kept = bytes_kept.saturating_add(symbols.saturating_mul(PER_SYMBOL));
            }
            _ => {}
        }
        let needed = bytes_kept.saturating_add(largest);
        if needed > allowed {
            let len = bytes.len();
            let what = format!(
                "it declares splats that need {needed} bytes of memory, and a file of {len} bytes may use {allowed}"
            );
            return Err(Fault::bad(what, "it is damaged or malicious"));
        }
    }
    Ok(())
}

/// Symbols of the streams that follow one another in `bytes`. A stream with another count than
/// `expected` is refused by the decoder before it allocates.
fn stream_symbols(mut bytes: &[u8], expected: u64) -> u64 {
    const CONSTANT: u8 = 2;
    let mut symbols = 0u64;
    while let Some((head, rest)) = bytes.split_at_checked(STREAM_HEADER_SIZE) {
        let (mode, channels) = (head[2], u64::from(head[4]));
        let count = u64::from(u32::from_le_bytes([head[5], head[6], head[7], head[8]]));
        let payload = u64::from_le_bytes([
            head[9], head[10], head[11], head[12], head[13], head[14], head[15], head[16],
        ]);
        let rows = if mode == CONSTANT {
            1
        } else {
            count.min(expected)
        };
        symbols = symbols.saturating_add(rows * channels);
        let Some(next) = usize::try_from(payload).ok().and_then(|n| rest.get(n..)) else {
            break;
        };
        bytes = next;
    }
    symbols
}
