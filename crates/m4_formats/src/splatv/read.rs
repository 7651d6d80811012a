//! A `.splatv` file to a scene.

use super::header::{Part, source};
use super::{MAGIC, ReadSplatvError, SPLAT_BYTES, STATIC_LIFE, TEXEL_BYTES};
use crate::row::{FOREVER_CLIPS, Life, Row, collect, logit, unit};
use crate::{C0, Imported, Loss, plural};
use half::f16;
use m4_scene::Scene;
use std::f64::consts::SQRT_2;
use std::path::Path;

/// Frames of a clip where the file does not say: two seconds.
const DEFAULT_FRAMES: usize = 61;
/// Near plane where the file does not say, world units.
const NEAR: f32 = 0.01;
/// Longest JSON that is read, bytes.
const MAX_JSON: usize = 64 << 20;

/// Reads a file of any writer.
///
/// # Errors
///
/// [`ReadSplatvError`] if the file is missing, damaged, or of another kind.
pub fn read(path: &Path) -> Result<Imported, ReadSplatvError> {
    let bytes = crate::file::load(path).map_err(|source| ReadSplatvError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    parse(path, &bytes)
}

/// The scene in the bytes of a file; `path` is for messages alone.
///
/// # Errors
///
/// As [`read`].
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Imported, ReadSplatvError> {
    let not_splatv = |reason: String| ReadSplatvError::NotSplatv {
        path: path.to_path_buf(),
        reason,
    };
    let damaged = |reason: String| ReadSplatvError::Damaged {
        path: path.to_path_buf(),
        reason,
    };
    let ([magic, length], rest) = match bytes.as_chunks::<4>() {
        ([a, b, ..], _) => ([*a, *b].map(u32::from_le_bytes), &bytes[8..]),
        _ => return Err(not_splatv(format!("it is {} bytes long", bytes.len()))),
    };
    if magic != MAGIC {
        return Err(not_splatv(format!(
            "it starts with {magic:#x} where {MAGIC:#x} was expected"
        )));
    }
    let length = length as usize;
    let (json, texture) = match rest.split_at_checked(length) {
        Some(parts) if length <= MAX_JSON => parts,
        _ => {
            return Err(damaged(format!(
                "its header says {length} bytes and the file has {}",
                rest.len()
            )));
        }
    };
    let parts: Vec<Part> = serde_json::from_slice(json).map_err(|e| damaged(format!("its header: {e}")))?;
    let part = match parts.first() {
        Some(part) if part.kind == "splat" => part,
        Some(part) => {
            return Err(damaged(format!(
                "its first part is {:?} where splats were expected",
                part.kind
            )));
        }
        None => return Err(damaged("its header lists no splats".to_owned())),
    };
    let texels = part.texwidth.checked_mul(part.texheight);
    let texture = match usize::try_from(part.size).ok().and_then(|n| texture.get(..n)) {
        Some(texture) if texels.and_then(|n| n.checked_mul(TEXEL_BYTES as u64)) == Some(part.size) => texture,
        _ => {
            return Err(damaged(format!(
                "its header says {} bytes in {} x {} texels and the file has {} for them",
                part.size,
                part.texwidth,
                part.texheight,
                texture.len()
            )));
        }
    };
    let mut losses = Vec::new();
    if parts.len() > 1 {
        losses.push(Loss::Dropped(format!("all but the first of {} parts", parts.len())));
    }
    let facts = part.minute4d.and_then(super::header::Facts::checked);
    let frames = facts.map_or_else(|| timed_frames(part), |f| f.time_frames);
    let last = frames.saturating_sub(1).max(1) as f64;
    let (rows, colours) = rows(path, texture, last, &mut losses)?;
    let splats = collect(0, &rows, |i, out| out.copy_from_slice(&colours[i]));
    let source = source(&part.cameras, last).unwrap_or_else(|| {
        losses.push(Loss::Dropped("the cameras: one of them makes no picture".to_owned()));
        Vec::new()
    });
    Ok(Imported {
        scene: Scene {
            splats,
            background: facts.map_or([0.0; 3], |f| f.background),
            time_frames: frames,
            duration_s: facts.and_then(|f| f.duration_s),
            mip: facts.is_some_and(|f| f.mip),
            near: facts.map_or(NEAR, |f| f.near),
            source,
        },
        up: None,
        losses,
    })
}

/// As many frames as there are cameras with a time; [`DEFAULT_FRAMES`] where there is none.
fn timed_frames(part: &Part) -> usize {
    match part.cameras.iter().filter(|c| c.time.is_some()).count() {
        n if n >= 2 => n,
        _ => DEFAULT_FRAMES,
    }
}

type Rows = Vec<(Row, Option<Life>)>;

/// Splats and their constant colour coefficients.
fn rows(
    path: &Path,
    texture: &[u8],
    last: f64,
    losses: &mut Vec<Loss>,
) -> Result<(Rows, Vec<[f32; 3]>), ReadSplatvError> {
    let (mut rows, mut colours) = (Vec::new(), Vec::new());
    let (mut curved, mut turning) = (0usize, 0usize);
    for (i, bytes) in texture.as_chunks::<SPLAT_BYTES>().0.iter().enumerate() {
        let words: [u32; 16] = {
            let chunks = bytes.as_chunks::<4>().0;
            std::array::from_fn(|k| u32::from_le_bytes(chunks[k]))
        };
        let halves = |k: usize| [words[k] as u16, (words[k] >> 16) as u16].map(|bits| f16::from_bits(bits).to_f32());
        let [centre, length] = halves(15);
        // The tail of the texture, and splats that are never there.
        if words == [0; 16] || length == 0.0 {
            continue;
        }
        let finite = |field: &'static str, values: &[f32]| match values.iter().find(|v| !v.is_finite()) {
            Some(&value) => Err(ReadSplatvError::BadValue {
                path: path.to_path_buf(),
                splat: i,
                field,
                value,
            }),
            None => Ok(()),
        };
        let mean = [words[0], words[1], words[2]].map(f32::from_bits);
        finite("the position", &mean)?;
        let ([w, x], [y, z]) = (halves(3), halves(4));
        finite("the rotation", &[w, x, y, z])?;
        let ([sx, sy], [sz, _]) = (halves(5), halves(6));
        finite("the scale", &[sx, sy, sz])?;
        finite("the middle of the life", &[centre])?;
        let motion: [[f32; 2]; 5] = std::array::from_fn(|k| halves(8 + k));
        let motion = motion.as_flattened();
        let [vx, vy, vz] = [motion[0], motion[1], motion[2]];
        finite("the motion", &[vx, vy, vz])?;
        curved += usize::from(motion[3..9].iter().any(|&v| v != 0.0));
        turning += usize::from(words[13] & 0x7fff_7fff != 0 || words[14] & 0x7fff_7fff != 0);
        // A not-a-number is neither.
        let life = f64::from(length).abs();
        if life.is_nan() {
            finite("the length of the life", &[length])?;
        }
        let still = [vx, vy, vz] == [0.0; 3];
        let velocity = [vx, vy, vz].map(|v| (f64::from(v) / last) as f32);
        let life = (!(still && life >= STATIC_LIFE)).then(|| Life {
            time_mean: (f64::from(centre) * last) as f32,
            log_time_sd: (life.min(FOREVER_CLIPS) / SQRT_2 * last).ln() as f32,
            velocity,
        });
        let [r, g, b, a] = words[7].to_le_bytes().map(|v| f64::from(v) / 255.0);
        let row = Row {
            mean,
            log_scale: [sx, sy, sz].map(|s| s.abs().max(f32::MIN_POSITIVE).ln()),
            quat: unit([w, x, y, z]),
            opacity: logit(a),
        };
        rows.push((row, life));
        colours.push([r, g, b].map(|v| ((v - 0.5) / C0) as f32));
    }
    if curved > 0 {
        losses.push(Loss::Dropped(format!(
            "the bends in the paths of {}: they go on as in the middle of their life",
            plural(curved, "splat")
        )));
    }
    if turning > 0 {
        losses.push(Loss::Dropped(format!(
            "the turning of {}: they stay as in the middle of their life",
            plural(turning, "splat")
        )));
    }
    Ok((rows, colours))
}
