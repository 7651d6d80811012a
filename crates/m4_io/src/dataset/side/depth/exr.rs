//! OpenEXR: the first part with a channel of depth, at full resolution; half and whole numbers become floats.

use super::known;
use crate::dataset::SourceErrorCause;
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
/// [`SourceErrorCause`]: damaged, more pixels than the file can hold, or no channel of depth.
pub fn decode_exr(bytes: &[u8]) -> Result<DepthMap, SourceErrorCause> {
    let damaged =
        |e: exr::error::Error| SourceErrorCause::bad(format!("the EXR file cannot be read ({e})"), "export it again");
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
    let needed: u64 = meta
        .headers
        .iter()
        .map(|h| {
            let pixels = (h.layer_size.width() as u64).saturating_mul(h.layer_size.height() as u64);
            pixels.saturating_mul(h.channels.bytes_per_pixel as u64)
        })
        .fold(0, u64::saturating_add);
    if needed
        > (bytes.len() as u64)
            .saturating_mul(MAX_RATIO)
            .saturating_add(FREE_BYTES)
    {
        let what = format!("{needed} bytes of pixels are claimed by a file of {}", bytes.len());
        return Err(SourceErrorCause::bad(what, "the file is damaged; export it again"));
    }
    let (wanted, header) = depth_channel(&meta)?;
    let (seen, whole) = (header.layer_size, header.shared_attributes.display_window.size);
    if seen != whole {
        let what = format!(
            "it holds {} x {} pixels of an image of {} x {}",
            seen.0, seen.1, whole.0, whole.1
        );
        return Err(SourceErrorCause::unsupported(what, "export the whole image"));
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
fn depth_channel(meta: &MetaData) -> Result<(String, &Header), SourceErrorCause> {
    let channels = || {
        let of = |h: &Header| h.channels.list.iter().map(|c| c.name.to_string()).collect::<Vec<_>>();
        meta.headers
            .iter()
            .flat_map(move |h| of(h).into_iter().map(move |name| (name, h)))
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
    let names: Vec<String> = all
        .into_iter()
        .map(|(name, _)| name.chars().take(32).collect())
        .collect();
    let what = format!("none of the channels {} is depth", names.join(", "));
    Err(SourceErrorCause::bad(what, "name the channel Z"))
}
