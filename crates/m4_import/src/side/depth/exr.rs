//! OpenEXR: the first layer, at full resolution; half and whole numbers become floats.

use super::known;
use crate::core::SourceFault;
use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, read};
use m4_scene::{DepthMap, Plane};
use std::io::Cursor;

/// Channels that hold depth, the likeliest first; by their last part, so that `ViewLayer.Depth.Z` of Blender is one.
const CHANNELS: &[&str] = &["Z", "depth", "Y", "R"];
/// What a byte of a packed picture becomes at most, and what is always read. The methods other than zip can go beyond the first
/// for maps of one value; those are no depth.
const MAX_RATIO: u64 = 1032;
const FREE_BYTES: u64 = 8 << 20;

/// A map of depth; 0 where it is not a number above 0.
///
/// # Errors
///
/// [`SourceFault`]: damaged, more pixels than the file can hold, or no channel of depth.
pub fn decode_exr(bytes: &[u8]) -> Result<DepthMap, SourceFault> {
    let damaged =
        |e: exr::error::Error| SourceFault::bad(format!("the EXR file cannot be read ({e})"), "export it again");
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
        return Err(SourceFault::bad(what, "the file is damaged; export it again"));
    }
    let found: Vec<String> = meta
        .headers
        .first()
        .map(|h| h.channels.list.iter().map(|c| c.name.to_string()).collect())
        .unwrap_or_default();
    let last = |name: &str| name.rsplit('.').next().unwrap_or_default().to_ascii_lowercase();
    let wanted = CHANNELS.iter().find_map(|want| {
        let want = want.to_ascii_lowercase();
        found.iter().find(|name| last(name) == want)
    });
    let wanted = match (wanted, found.as_slice()) {
        (Some(name), _) => name,
        (None, [only]) => only,
        _ => {
            let what = format!("none of the channels {} is depth", found.join(", "));
            return Err(SourceFault::bad(what, "name the channel Z"));
        }
    };
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
