//! Tracks: their contents and their presentation.

use super::{Body, Edit, Kind, Mp4Error, Timeline, child, children, read_moov, required};
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

/// Most samples that are read: four days at 30 frames per second, and 240 MB here.
const MAX_SAMPLES: usize = 10_000_000;

/// One coded frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Bytes from the start of the file.
    pub offset: u64,
    /// Bytes.
    pub size: u32,
    /// Composition time, ticks of the track.
    pub ticks: i64,
}

/// The samples of a `stbl` box in decoding order. Those of one size have no list of which the length could be compared: they take
/// their bytes from `left`, what the tracks before have left of the file.
pub fn samples(stbl: &[u8], left: &mut u64) -> Result<Vec<Sample>, Mp4Error> {
    let sizes = Sizes::read(required(stbl, b"stsz", "the sample table")?, left)?;
    if sizes.count > MAX_SAMPLES {
        return Err(Mp4Error::Bad(format!("it has {} samples", sizes.count)));
    }
    let mut samples = Vec::with_capacity(sizes.count);
    place(stbl, &sizes, &mut samples)?;
    time(stbl, &mut samples)?;
    Ok(samples)
}

struct Sizes<'a> {
    count: usize,
    /// Of every sample, or 0.
    constant: u32,
    each: &'a [u8],
}

impl<'a> Sizes<'a> {
    fn read(mut stsz: Body<'a>, left: &mut u64) -> Result<Self, Mp4Error> {
        stsz.version()?;
        let constant = stsz.u32()?;
        if constant == 0 {
            let count = stsz.count(4)?;
            return Ok(Self { count, constant, each: stsz.bytes });
        }
        let count = stsz.u32()? as usize;
        let Some(rest) = left.checked_sub((count as u64).saturating_mul(u64::from(constant))) else {
            return Err(Mp4Error::Bad(format!("{count} samples of {constant} bytes are more than the file has")));
        };
        *left = rest;
        Ok(Self { count, constant, each: &[] })
    }

    fn get(&self, i: usize) -> u32 {
        if self.constant != 0 {
            return self.constant;
        }
        let bytes = self.each.get(4 * i..).and_then(|b| b.first_chunk());
        bytes.map_or(0, |b| u32::from_be_bytes(*b))
    }
}

/// Offsets, from `stsc` (runs of chunks) and `stco` or `co64` (where each chunk is).
fn place(stbl: &[u8], sizes: &Sizes<'_>, samples: &mut Vec<Sample>) -> Result<(), Mp4Error> {
    let (mut chunks, wide) = match child(stbl, b"stco") {
        Some(stco) => (stco, false),
        None => (required(stbl, b"co64", "the sample table")?, true),
    };
    chunks.version()?;
    let chunk_count = chunks.count(if wide { 8 } else { 4 })?;
    let mut stsc = required(stbl, b"stsc", "the sample table")?;
    stsc.version()?;
    let run_count = stsc.count(12)?;
    let mut runs = Vec::with_capacity(run_count);
    for _ in 0..run_count {
        let (first, per_chunk) = (stsc.u32()?, stsc.u32()?);
        stsc.u32()?;
        runs.push((first, per_chunk));
    }
    let mut run = 0;
    for chunk in 1..=chunk_count {
        let mut offset = if wide { chunks.u64()? } else { u64::from(chunks.u32()?) };
        while runs.get(run + 1).is_some_and(|next| next.0 as usize <= chunk) {
            run += 1;
        }
        let per_chunk = runs.get(run).map_or(0, |r| r.1);
        for _ in 0..per_chunk {
            if samples.len() == sizes.count {
                return Ok(());
            }
            let size = sizes.get(samples.len());
            samples.push(Sample { offset, size, ticks: 0 });
            offset = offset.saturating_add(u64::from(size));
        }
    }
    if samples.len() < sizes.count {
        return Err(Mp4Error::Bad(format!("its index places {} of {} samples", samples.len(), sizes.count)));
    }
    Ok(())
}

/// Composition times, from `stts` (durations) and `ctts` (offsets).
fn time(stbl: &[u8], samples: &mut [Sample]) -> Result<(), Mp4Error> {
    let mut stts = required(stbl, b"stts", "the sample table")?;
    stts.version()?;
    let runs = stts.count(8)?;
    let (mut next, mut ticks) = (0usize, 0i64);
    for _ in 0..runs {
        let (count, delta) = (stts.u32()? as usize, stts.u32()?);
        // Some cameras write a small negative duration for the last sample.
        let delta = if delta > i32::MAX as u32 { 1 } else { i64::from(delta) };
        for sample in samples.iter_mut().skip(next).take(count) {
            sample.ticks = ticks;
            ticks = ticks.saturating_add(delta);
        }
        next = next.saturating_add(count).min(samples.len());
    }
    if next < samples.len() {
        return Err(Mp4Error::Bad(format!("its index times {next} of {} samples", samples.len())));
    }
    let Some(mut ctts) = child(stbl, b"ctts") else {
        return Ok(());
    };
    ctts.version()?;
    let runs = ctts.count(8)?;
    let mut next = 0usize;
    for _ in 0..runs {
        // Version 0 is unsigned on paper; writers put negative numbers there anyway.
        let (count, offset) = (ctts.u32()? as usize, ctts.i32()?);
        for sample in samples.iter_mut().skip(next).take(count) {
            sample.ticks = sample.ticks.saturating_add(i64::from(offset));
        }
        next = next.saturating_add(count).min(samples.len());
    }
    Ok(())
}
