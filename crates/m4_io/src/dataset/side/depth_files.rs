//! Files of depth.
//!
//! OpenEXR: the first part with a channel of depth, at full resolution; half and whole numbers become floats.
//!
//! Portable float maps: `Pf`, width, height, scale as text, then 32-bit floats, rows from the bottom; a scale below 0 says that
//! the bytes are least significant first.

use super::depth::known;
use crate::Fault;
use exr::meta::MetaData;
use exr::meta::header::Header;
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, read};
use m4_core::{DepthMap, Plane};
use std::io::Cursor;

/// Channels that hold depth, the likeliest first; by their last part, so that `ViewLayer.Depth.Z` of Blender is one.
const CHANNELS: &[&str] = &["Z", "depth", "Y", "R"];
/// Channels that a message names.
const MAX_NAMED: usize = 12;
/// What a byte of a packed image becomes at most, and what is always read. The methods other than zip can go beyond the first
/// for maps of one value; those are no depth.
const MAX_RATIO: u64 = 1032;
const FREE_BYTES: u64 = 8 << 20;

/// A map of depth; 0 where it is NaN, infinite or not above 0.
///
/// # Errors
///
/// [`Fault`]: damaged, more pixels than the file can hold, or no channel of depth.
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
    let what = format!("none of the channels {} is depth", names.join(", "));
    Err(Fault::bad(what, "name the channel Z"))
}

/// Longest token of the head.
const MAX_TOKEN: usize = 32;

/// A map of one channel, rows from the top.
///
/// # Errors
///
/// [`Fault`]: three channels, a scale other than 1 or -1, or not as many numbers as the head says.
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
