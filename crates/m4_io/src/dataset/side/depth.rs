//! Depth maps: one per file, or a stack in an npz archive.
//!
//! OpenEXR: the first part with a channel of depth, at full resolution; half and whole numbers become floats. Portable float maps:
//! `Pf`, width, height, scale as text, then 32-bit floats, rows from the bottom; a scale below 0 says that the bytes are least
//! significant first. PNG is of [`crate::image`], npy of [`crate::npy`].

use crate::dataset::files::image_size;
use crate::dataset::{FrameSource, ImportOptions, step};
use crate::files::{bytes, first_bytes};
use crate::npy::{Npz, Numbers};
use crate::{Fault, image};
use exr::meta::MetaData;
use exr::meta::header::Header;
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, read};
use m4_core::{CompactDepth, DepthMap, Plane, Progress};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Extensions of maps that are read of a folder.
pub(crate) const EXTENSIONS: &[&str] = &["png", "exr", "pfm", "npy"];
/// Default scene units per step of 16-bit depth maps: millimetres if the unit is a metre.
pub(crate) const DEFAULT_UNIT: f64 = 1e-3;
/// Largest unit of depth.
const MAX_UNIT: f64 = 1e6;
/// Largest file of one map.
const MAX_FILE_BYTES: u64 = 1 << 30;
/// Largest map in memory: 134 million pixels of 8 bytes.
const MAX_MAP_BYTES: u64 = 1 << 30;
/// Names under which archives hold depth.
const KEYS: &[&str] = &["depths", "depth", "depth_map", "arr_0"];

/// Scene units per step of 16-bit depth: what the options say, else `default`.
pub(crate) fn unit(options: &ImportOptions, default: f64) -> Result<f64, Fault> {
    let unit = options.depth_unit.unwrap_or(default);
    if unit > 0.0 && unit <= MAX_UNIT {
        return Ok(unit);
    }
    let what = format!("the option depth_unit is {unit}; scene units per step, above 0, were expected");
    Err(Fault::bad(what, "give another"))
}

/// One map of z-depth by its first bytes: EXR, PFM, npy, npz (`depth`, `depths`, `depth_map` or `arr_0`), or PNG of 16 bits. `unit` is
/// that of a step of whole numbers; floats are taken as they are. NaN, infinite and other values not above 0 are unknown.
/// Errors: it cannot be read, is damaged, or holds no depth.
pub fn read_depth(path: &Path, unit: f64) -> Result<CompactDepth, Fault> {
    read_in(path, unit, 1.0)
}

/// The map of a file when its turn comes, with `unit` for whole numbers and `float_unit` for floats; faults name the file.
pub(crate) fn source(file: PathBuf, unit: f64, float_unit: f64) -> FrameSource<CompactDepth> {
    FrameSource::new(move || read_in(&file, unit, float_unit).map_err(|e| e.of_file(&file)))
}

fn read_in(path: &Path, unit: f64, float_unit: f64) -> Result<CompactDepth, Fault> {
    let start = first_bytes::<6>(path);
    if start.starts_with(b"\x89PNG") {
        image_size(path)?;
        return Ok(image::read_depth(path, unit)?);
    }
    let of_array = |array: Numbers| {
        let (h, w) = array.map_size()?;
        map(w, h, array.values, if array.whole { unit } else { float_unit })
    };
    if start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return Ok(in_unit(decode_exr(&bytes(path, MAX_FILE_BYTES)?)?, float_unit));
    }
    if start.starts_with(b"Pf") || start.starts_with(b"PF") {
        return Ok(in_unit(decode_pfm(&bytes(path, MAX_FILE_BYTES)?)?, float_unit));
    }
    if start.starts_with(b"\x93NUMPY") {
        return of_array(Numbers::read(path, MAX_MAP_BYTES)?);
    }
    if start.starts_with(b"PK") {
        let mut npz = Npz::open(path)?;
        let key = npz.first_of(KEYS).ok_or_else(|| {
            Fault::missing(format!("an array of depth ({})", KEYS.join(", ")), format!("it has {}", npz.names()))
        })?;
        return of_array(npz.need(key, MAX_MAP_BYTES / 8)?.numbers()?);
    }
    if start.is_empty() {
        // says what the system says, or that there is nothing in it
        std::fs::File::open(path)?;
        return Err(Fault::bad("the file is empty", "export it again"));
    }
    Err(Fault::unsupported("its format is not supported for depth maps", "give PNG of 16 bits, EXR, PFM, npy or npz"))
}

/// A stack of maps.
pub(crate) fn read_stack(
    path: &Path,
    frames: usize,
    unit: f64,
    limit_bytes: u64,
    progress: &dyn Progress,
) -> Result<Vec<CompactDepth>, Fault> {
    Stack::open(path, KEYS, frames, limit_bytes, progress, |stack, values| {
        let unit = if stack.whole { unit } else { 1.0 };
        map(stack.width, stack.height, values, unit)
    })
}

/// The map of numbers times `unit`, rows from the top; NaN, infinite and other values not above 0 are unknown.
fn map(width: usize, height: usize, values: Vec<f64>, unit: f64) -> Result<CompactDepth, Fault> {
    let values = values.into_iter().map(|v| known((v * unit) as f32)).collect();
    let map: DepthMap =
        Plane::from_vec(width, height, values).map_err(|e| Fault::bad(e.to_string(), "export it again"))?;
    if map.data().is_empty() {
        return Err(Fault::bad(format!("a map of {width} x {height} pixels"), "export it again"));
    }
    Ok(map.into())
}

/// A map of floats times `unit`.
fn in_unit(map: DepthMap, unit: f64) -> CompactDepth {
    if unit == 1.0 {
        return map.into();
    }
    map.map(|&z| known((f64::from(z) * unit) as f32)).into()
}

/// Depth, 0 where it is not known.
pub(crate) fn known(z: f32) -> f32 {
    if z.is_finite() && z > 0.0 { z } else { 0.0 }
}

/// Depth where `confidence` of the same size is above 0, unknown elsewhere.
pub(crate) fn kept_where(depth: &CompactDepth, confidence: &Plane<u8>) -> Result<CompactDepth, Fault> {
    if depth.size() != confidence.size() {
        let (d, c) = (depth.size(), confidence.size());
        let what = format!("a confidence map of {} x {} pixels for depth of {} x {}", c.0, c.1, d.0, d.1);
        return Err(Fault::bad(what, "export both again"));
    }
    let (w, h) = depth.size();
    let kept = Plane::from_fn(w, h, |x, y| if confidence[(x, y)] > 0 { depth.at(x, y) } else { 0.0 });
    Ok(CompactDepth::from(kept))
}

/// What is known of a stack while its maps are read.
pub(crate) struct Stack {
    pub width: usize,
    pub height: usize,
    /// Whether its numbers are integers or booleans.
    pub whole: bool,
}

impl Stack {
    /// Reads the array that has one of the names `keys`, `[frames][h][w]` or `[frames][h][w][1]`, map by map.
    pub(crate) fn open<T>(
        path: &Path,
        keys: &[&str],
        frames: usize,
        limit_bytes: u64,
        progress: &dyn Progress,
        one: impl Fn(&Self, Vec<f64>) -> Result<T, Fault>,
    ) -> Result<Vec<T>, Fault> {
        let mut npz = Npz::open(path)?;
        let Some(key) = npz.first_of(keys) else {
            let what = format!("an array named {} (there are: {})", keys.join(" or "), npz.names());
            return Err(Fault::missing(what, "save the maps under such a name"));
        };
        // both a map and its copy in the capture
        let mut array = npz.need(key, limit_bytes / 4)?;
        let (n, height, width) = match array.shape[..] {
            [n, h, w] | [n, h, w, 1] => (n, h, w),
            _ => {
                let what = format!("{key} has shape {:?}; [frames, height, width] was expected", array.shape);
                return Err(Fault::bad(what, "save one map per frame"));
            }
        };
        if n != frames {
            let what = format!("{key} has {n} maps for {frames} training frames");
            return Err(Fault::bad(what, "give one map for each training frame"));
        }
        if width == 0 || height == 0 {
            return Err(Fault::bad(format!("{key} has maps of {width} x {height} pixels"), "save them again"));
        }
        let stack = Self { width, height, whole: !array.number.is_float() };
        let mut maps = Vec::new();
        for i in 0..n {
            step("read maps", i, n, progress)?;
            let values = array.next_f64(width * height)?;
            maps.push(one(&stack, values)?);
        }
        array.end()?;
        Ok(maps)
    }
}

/// Channels that hold depth, the likeliest first; by their last part, so that `ViewLayer.Depth.Z` of Blender is one.
const CHANNELS: &[&str] = &["Z", "depth", "Y", "R"];
/// Channels that a message names.
const MAX_NAMED: usize = 12;
/// What a byte of a packed image becomes at most, and what is always read.
const MAX_RATIO: u64 = 1032;
const FREE_BYTES: u64 = 8 << 20;

/// A map of depth; 0 where it is NaN, infinite or not above 0. Fails for more pixels than the file can hold.
pub fn decode_exr(bytes: &[u8]) -> Result<DepthMap, Fault> {
    let damaged = |e: exr::error::Error| Fault::bad(format!("the EXR file cannot be read ({e})"), "export it again");
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
    let needed: u64 = meta
        .headers
        .iter()
        .map(|h| {
            let pixels = (h.layer_size.width() as u64).saturating_mul(h.layer_size.height() as u64);
            pixels.saturating_mul(h.channels.bytes_per_pixel as u64)
        })
        .fold(0, u64::saturating_add);
    if needed > (bytes.len() as u64).saturating_mul(MAX_RATIO).saturating_add(FREE_BYTES) {
        let what = format!("{needed} bytes of pixels are claimed by a file of {}", bytes.len());
        return Err(Fault::bad(what, "the file is damaged; export it again"));
    }
    let (wanted, header) = depth_channel(&meta)?;
    let (seen, whole) = (header.layer_size, header.shared_attributes.display_window.size);
    if seen != whole {
        let what = format!("it holds {} x {} pixels of an image of {} x {}", seen.0, seen.1, whole.0, whole.1);
        return Err(Fault::unsupported(what, "export the whole image"));
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required(wanted.as_str())
        .collect_pixels(
            |size, _| Plane::filled(size.width(), size.height(), 0.0f32),
            |plane: &mut DepthMap, at, (z,): (f32,)| plane[(at.x(), at.y())] = known(z),
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(damaged)?;
    Ok(image.layer_data.channel_data.pixels)
}

/// The channel of depth and the part of the file that has it.
fn depth_channel(meta: &MetaData) -> Result<(String, &Header), Fault> {
    let channels = || {
        let of = |h: &Header| h.channels.list.iter().map(|c| c.name.to_string()).collect::<Vec<_>>();
        meta.headers.iter().flat_map(move |h| of(h).into_iter().map(move |name| (name, h)))
    };
    let last = |name: &str| name.rsplit('.').next().unwrap_or_default().to_ascii_lowercase();
    let named = |want: &&str| channels().find(|(name, _)| last(name) == want.to_ascii_lowercase());
    if let Some(found) = CHANNELS.iter().find_map(named) {
        return Ok(found);
    }
    let all: Vec<(String, &Header)> = channels().take(MAX_NAMED).collect();
    if let [(name, header)] = all.as_slice() {
        return Ok((name.clone(), header));
    }
    let names: Vec<String> = all.into_iter().map(|(name, _)| name.chars().take(32).collect()).collect();
    Err(Fault::bad(format!("none of the channels {} is depth", names.join(", ")), "name the channel Z"))
}

/// Longest token of the head.
const MAX_TOKEN: usize = 32;

/// A map of one channel, rows from the top; the scale must be 1 or -1.
pub fn decode_pfm(bytes: &[u8]) -> Result<DepthMap, Fault> {
    let bad = |what: String| Fault::bad(what, "export the map again, as one channel with scale -1");
    let mut rest = bytes;
    let mut token = || -> Option<&str> {
        let start = rest.iter().position(|b| !b.is_ascii_whitespace())?;
        rest = &rest[start..];
        let end = rest.iter().take(MAX_TOKEN).position(u8::is_ascii_whitespace)?;
        let (word, after) = rest.split_at(end);
        // one white space ends it: after the last token the numbers begin
        rest = &after[1..];
        std::str::from_utf8(word).ok()
    };
    let kind = token().unwrap_or_default().to_owned();
    if kind != "Pf" {
        return Err(bad(format!("a PFM file of kind {kind:?}; Pf was expected")));
    }
    let sides = [token().and_then(|t| t.parse::<usize>().ok()), token().and_then(|t| t.parse().ok())];
    let scale = token().and_then(|t| t.parse::<f64>().ok());
    let ([Some(width), Some(height)], Some(scale)) = (sides, scale) else {
        return Err(bad("its head is not understood".into()));
    };
    if scale.abs() != 1.0 {
        return Err(bad(format!("its scale is {scale}; 1 or -1 was expected")));
    }
    let needed = width.checked_mul(height).and_then(|n| n.checked_mul(4));
    if needed != Some(rest.len()) || rest.is_empty() {
        return Err(bad(format!(
            "{width} x {height} pixels of 4 bytes were expected and {} bytes are there",
            rest.len()
        )));
    }
    let value = |b: &[u8; 4]| {
        if scale < 0.0 { f32::from_le_bytes(*b) } else { f32::from_be_bytes(*b) }
    };
    let values = rest.as_chunks::<4>().0;
    Ok(Plane::from_fn(width, height, |x, y| known(value(&values[(height - 1 - y) * width + x]))))
}
