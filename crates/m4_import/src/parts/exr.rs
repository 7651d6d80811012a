//! Depth in OpenEXR files.

use crate::core::SourceFault;
use exr::meta::MetaData;
use exr::prelude::{FlatSamples, ReadChannels, ReadLayers, read};
use m4_scene::Plane;
use std::io::Cursor;

/// First bytes of a file.
pub(crate) const MAGIC: &[u8] = &[0x76, 0x2f, 0x31, 0x01];
/// Most pixels for a byte of a file: what its best compression of a constant map does.
const MAX_RATIO: usize = 1032;
/// Most channels of a file with depth.
const MAX_CHANNELS: usize = 16;
/// Names of the channel of depth, the first that is there.
const CHANNELS: [&str; 4] = ["Z", "Y", "R", "depth"];

/// The channel Z (or Y, R, depth) of a file in memory, as it is stored.
pub(crate) fn read_depth(bytes: &[u8]) -> Result<Plane<f32>, SourceFault> {
    let damaged = |e: exr::error::Error| {
        SourceFault::bad(
            format!("it is no OpenEXR file that can be read ({e})"),
            "write the depth map again",
        )
    };
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), true).map_err(damaged)?;
    let header = meta.headers.first();
    let header = header.ok_or_else(|| SourceFault::missing("a layer", "write the depth map again"))?;
    let (w, h) = (header.layer_size.0, header.layer_size.1);
    let channels = header.channels.list.len();
    let pixels = w.checked_mul(h).and_then(|n| n.checked_mul(channels));
    let most = bytes.len().saturating_mul(MAX_RATIO);
    if header.deep || meta.headers.len() > 1 || channels > MAX_CHANNELS || pixels.is_none_or(|n| n == 0 || n > most) {
        let what = format!(
            "it has {} layers, the first of {w} x {h} pixels with {channels} channels, in {} bytes",
            meta.headers.len(),
            bytes.len()
        );
        return Err(SourceFault::unsupported(
            what,
            "write one flat layer with the channel Z",
        ));
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(damaged)?;
    let list = &image.layer_data.channel_data.list;
    let found = CHANNELS.iter().find_map(|name| list.iter().find(|c| c.name.eq(name)));
    let channel = found.ok_or_else(|| {
        let names: Vec<String> = list.iter().map(|c| c.name.to_string()).collect();
        SourceFault::missing(
            format!("the channel {}", CHANNELS.join(", ")),
            format!("it has {}; write depth as channel Z", names.join(", ")),
        )
    })?;
    let values: Vec<f32> = match &channel.sample_data {
        FlatSamples::F16(all) => all.iter().map(|v| v.to_f32()).collect(),
        FlatSamples::F32(all) => all.clone(),
        FlatSamples::U32(all) => all.iter().map(|&v| v as f32).collect(),
    };
    Plane::from_vec(w, h, values)
        .map_err(|e| SourceFault::bad(e.to_string(), "write the depth map without subsampling"))
}
