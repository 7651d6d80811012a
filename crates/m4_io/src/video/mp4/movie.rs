//! Tracks: their contents and their presentation.

use super::boxes::{Body, Kind, child, children, read_moov, required};
use super::edits::Edit;
use super::samples::samples;
use super::{Mp4Error, Sample, Timeline};
use std::io::{Read, Seek};

/// Most parts that a track may be cut into; each frame is looked up among them.
const MAX_EDITS: usize = 1000;

/// What is in a file.
#[derive(Debug)]
pub struct Movie {
    /// In the order of the file.
    pub tracks: Vec<Track>,
}

/// Codes of ITU-T H.273 for the colours of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nclx {
    /// Table 3.
    pub transfer: u16,
    /// Table 4.
    pub matrix: u16,
    /// `None` where the box has no such flag (QuickTime's `nclc`).
    pub full_range: Option<bool>,
}

/// How the samples of a video track are coded.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleEntry {
    /// As in `avc1`.
    pub codec: Kind,
    /// Body of the `avcC` box.
    pub avcc: Option<Vec<u8>>,
    /// Colours, where the file states them.
    pub colours: Option<Nclx>,
    /// Width of a pixel over its height, where the file states it.
    pub pixel_aspect: Option<f64>,
}

/// One track.
#[derive(Debug)]
pub struct Track {
    /// `vide`, `soun`, ...
    pub handler: Kind,
    /// Display matrix `a b u c d v x y w` (16.16 and 2.30 fixed point).
    pub matrix: [i32; 9],
    /// When samples are shown.
    pub timeline: Timeline,
    /// One for each way of coding that is used; usually one.
    pub entries: Vec<SampleEntry>,
    /// In decoding order. For video tracks only.
    pub samples: Vec<Sample>,
}

impl Movie {
    /// Reads the index of a file of `len` bytes.
    pub fn read(file: &mut (impl Read + Seek), len: u64) -> Result<Self, Mp4Error> {
        let moov = read_moov(file, len)?;
        let mut mvhd = required(&moov, b"mvhd", "the index (moov box)")?;
        let skipped = if mvhd.version()? == 1 { 16 } else { 8 };
        mvhd.take(skipped)?;
        let scale = mvhd.u32()?;
        let mut left = len;
        let traks = children(&moov).filter(|(kind, _)| kind == b"trak");
        let tracks: Vec<Track> = traks.map(|(_, body)| track(body, scale, &mut left)).collect::<Result<_, _>>()?;
        let empty = tracks.iter().all(|t| t.samples.is_empty());
        if empty && child(&moov, b"mvex").is_some() {
            return Err(Mp4Error::Fragmented);
        }
        Ok(Self { tracks })
    }

    /// The video track with the most samples.
    pub fn video(&self) -> Option<&Track> {
        let videos = self.tracks.iter().filter(|t| &t.handler == b"vide" && !t.entries.is_empty());
        // `max_by_key` takes the last of equals, a file's first track is its main one.
        videos.rev().max_by_key(|t| t.samples.len())
    }
}

fn track(trak: &[u8], movie_scale: u32, left: &mut u64) -> Result<Track, Mp4Error> {
    let mut tkhd = required(trak, b"tkhd", "a track")?;
    let times = if tkhd.version()? == 1 { 32 } else { 20 };
    // Times, reserved, layer, group, volume, reserved.
    tkhd.take(times + 16)?;
    let mut matrix = [0; 9];
    for entry in &mut matrix {
        *entry = tkhd.i32()?;
    }
    let mdia = required(trak, b"mdia", "a track")?.bytes;
    let mut mdhd = required(mdia, b"mdhd", "a track")?;
    let times = if mdhd.version()? == 1 { 16 } else { 8 };
    mdhd.take(times)?;
    let scale = mdhd.u32()?;
    let mut hdlr = required(mdia, b"hdlr", "a track")?;
    hdlr.take(8)?;
    let kind = hdlr.take(4)?;
    let handler = [kind[0], kind[1], kind[2], kind[3]];

    let mut entries = Vec::new();
    let mut list = Vec::new();
    if &handler == b"vide" {
        if scale == 0 {
            return Err(Mp4Error::Bad("its video track has 0 ticks per second".into()));
        }
        let minf = required(mdia, b"minf", "a track")?.bytes;
        let stbl = required(minf, b"stbl", "a track")?.bytes;
        let mut stsd = required(stbl, b"stsd", "the sample table")?;
        stsd.version()?;
        stsd.u32()?;
        entries = children(stsd.bytes).filter_map(|(kind, body)| entry(kind, body)).collect();
        list = samples(stbl, left)?;
    }
    let edits = match child(trak, b"edts").and_then(|edts| child(edts.bytes, b"elst")) {
        Some(elst) => edit_list(elst)?,
        None => Vec::new(),
    };
    Ok(Track { handler, matrix, timeline: Timeline::new(&edits, movie_scale, scale), entries, samples: list })
}

fn edit_list(mut elst: Body<'_>) -> Result<Vec<Edit>, Mp4Error> {
    let wide = elst.version()? == 1;
    let count = elst.count(if wide { 20 } else { 12 })?;
    if count > MAX_EDITS {
        return Err(Mp4Error::Bad(format!("its edit list has {count} entries")));
    }
    let mut edits = Vec::with_capacity(count);
    for _ in 0..count {
        let (duration, media_time) = if wide {
            (elst.u64()?, elst.u64()?.cast_signed())
        } else {
            (u64::from(elst.u32()?), i64::from(elst.i32()?))
        };
        edits.push(Edit { duration, media_time, rate: f64::from(elst.i32()?) / 65536.0 });
    }
    Ok(edits)
}

/// A visual sample entry (ISO/IEC 14496-12, 12.1.3): 78 bytes, then boxes.
fn entry(codec: Kind, body: &[u8]) -> Option<SampleEntry> {
    let inside = body.get(78..)?;
    let colours = child(inside, b"colr").and_then(|mut colr| {
        let kind = colr.take(4).ok()?;
        let whole = kind == b"nclx";
        if !whole && kind != b"nclc" {
            return None;
        }
        colr.u16().ok()?;
        Some(Nclx {
            transfer: colr.u16().ok()?,
            matrix: colr.u16().ok()?,
            full_range: if whole { Some(colr.u8().ok()? & 0x80 != 0) } else { None },
        })
    });
    let pixel_aspect = child(inside, b"pasp").and_then(|mut pasp| {
        let aspect = f64::from(pasp.u32().ok()?) / f64::from(pasp.u32().ok()?);
        (0.1..=10.0).contains(&aspect).then_some(aspect)
    });
    Some(SampleEntry { codec, avcc: child(inside, b"avcC").map(|b| b.bytes.to_vec()), colours, pixel_aspect })
}
