//! Depth maps, one per file.
//!
//! OpenEXR: the first part with a channel of depth, at full resolution; half and whole numbers
//! become floats. PNG is of [`crate::image`], npy of [`crate::npy`].

use crate::dataset::FrameSource;
use crate::files::{self, first_bytes, within_memory};
use crate::npy::Numbers;
use crate::range::DEPTH;
use crate::{Fault, image};
use exr::meta::MetaData;
use exr::meta::header::Header;
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, read};
use m4_core::{CompactDepth, DepthMap, Plane};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Extensions of maps that are read of a folder.
pub(crate) const EXTENSIONS: &[&str] = &["png", "exr", "npy"];
/// Default scene units per step of 16-bit depth maps: millimetres if the unit is a metre.
pub(crate) const DEFAULT_UNIT: f64 = 1e-3;
/// Largest file of one map.
const MAX_FILE_BYTES: u64 = 1 << 30;
/// Largest map in memory: 134 million pixels of 8 bytes.
const MAX_MAP_BYTES: u64 = 1 << 30;

/// One map of z-depth by its first bytes: EXR, npy, or PNG of 16 bits. `unit` is that of a step of
/// whole numbers; floats are taken as they are. NaN and all other values that are not in [`DEPTH`]
/// are unknown. Errors: it cannot be read, is damaged, or holds no depth.
pub fn read_depth(path: &Path, unit: f64) -> Result<CompactDepth, Fault> {
    read_in(path, unit, 1.0)
}

/// The map of a file when its turn comes, with `unit` for whole numbers and `float_unit` for
/// floats; faults name the file.
pub(crate) fn source(file: PathBuf, unit: f64, float_unit: f64) -> FrameSource<CompactDepth> {
    FrameSource::new(move || read_in(&file, unit, float_unit).map_err(|e| e.of_file(&file)))
}

fn read_in(path: &Path, unit: f64, float_unit: f64) -> Result<CompactDepth, Fault> {
    let start = first_bytes::<6>(path);
    if start.starts_with(b"\x89PNG") {
        return Ok(image::read_depth(path, unit)?);
    }
    if start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return Ok(in_unit(
            decode_exr(&files::read(path, MAX_FILE_BYTES)?)?,
            float_unit,
        ));
    }
    if start.starts_with(b"\x93NUMPY") {
        let array = Numbers::read(path, MAX_MAP_BYTES)?;
        let (h, w) = array.map_size()?;
        let unit = if array.whole { unit } else { float_unit };
        return Ok(Plane::from_fn(w, h, |x, y| {
            depth_in_range((array.values[y * w + x] * unit) as f32)
        })
        .into());
    }
    if start.is_empty() {
        // says what the system says, or that there is nothing in it
        files::open(path)?;
        return Err(Fault::bad("the file is empty", "export it again"));
    }
    Err(Fault::unsupported(
        "its format is not supported for depth maps",
        "give PNG of 16 bits, EXR or npy",
    ))
}

/// A map of floats times `unit`.
fn in_unit(map: DepthMap, unit: f64) -> CompactDepth {
    if unit == 1.0 {
        return map.into();
    }
    map.map(|&z| depth_in_range((f64::from(z) * unit) as f32))
        .into()
}

/// A depth; 0, for none, if it is out of range.
pub(crate) fn depth_in_range(z: f32) -> f32 {
    if DEPTH.contains(&f64::from(z)) {
        z
    } else {
        0.0
    }
}

/// Channels that hold depth, the likeliest first; by their last part, so that `ViewLayer.Depth.Z`
/// of Blender is one.
const CHANNELS: &[&str] = &["Z", "depth", "Y", "R"];
/// Channels that a message names.
const MAX_NAMED: usize = 12;
/// Lines of the largest block (DWAB).
const BLOCK_LINES: u64 = 256;

/// A map of depth; 0 where it is not in [`DEPTH`]. Fails for more pixels than the file can hold.
pub fn decode_exr(bytes: &[u8]) -> Result<DepthMap, Fault> {
    let damaged = |e: exr::error::Error| {
        Fault::bad(
            format!("the EXR file cannot be read ({e})"),
            "export it again",
        )
    };
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
    // the map twice, and a block of lines of all channels
    let needed: u64 = meta
        .headers
        .iter()
        .map(|h| {
            let (w, h_px) = (h.layer_size.width() as u64, h.layer_size.height() as u64);
            let lines = w
                .saturating_mul(h.channels.bytes_per_pixel as u64)
                .saturating_mul(BLOCK_LINES.min(h_px));
            w.saturating_mul(h_px)
                .saturating_mul(8)
                .saturating_add(2 * lines)
        })
        .fold(0, u64::saturating_add);
    within_memory("the pixels", needed, bytes.len() as u64)?;
    let (wanted, header) = depth_channel(&meta)?;
    let (data_size, whole) = (
        header.layer_size,
        header.shared_attributes.display_window.size,
    );
    if data_size != whole {
        let what = format!(
            "it holds {} x {} pixels of an image of {} x {}",
            data_size.0, data_size.1, whole.0, whole.1
        );
        return Err(Fault::unsupported(what, "export the whole image"));
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required(wanted.as_str())
        .collect_pixels(
            |size, _| Plane::filled(size.width(), size.height(), 0.0f32),
            |plane: &mut DepthMap, at, (z,): (f32,)| plane[(at.x(), at.y())] = depth_in_range(z),
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
        let of = |h: &Header| {
            h.channels
                .list
                .iter()
                .map(|c| c.name.to_string())
                .collect::<Vec<_>>()
        };
        meta.headers
            .iter()
            .flat_map(move |h| of(h).into_iter().map(move |name| (name, h)))
    };
    let last = |name: &str| {
        name.rsplit('.')
            .next()
            .unwrap_or_default()
            .to_ascii_lowercase()
    };
    let named = |want: &&str| channels().find(|(name, _)| last(name) == want.to_ascii_lowercase());
    if let Some(channel) = CHANNELS.iter().find_map(named) {
        return Ok(channel);
    }
    let all: Vec<(String, &Header)> = channels().take(MAX_NAMED).collect();
    if let [(name, header)] = all.as_slice() {
        return Ok((name.clone(), header));
    }
    let names: Vec<String> = all
        .into_iter()
        .map(|(name, _)| name.chars().take(32).collect())
        .collect();
    Err(Fault::bad(
        format!("none of the channels {} is depth", names.join(", ")),
        "name the channel Z",
    ))
}
