//! Tracks: their contents and their presentation.

use super::{Mp4Error, Timeline, child, children, inside, optional, read_moov, required};
use crate::video::colour::Colours;
use mp4_atom::{
    Atom, Avcc, Co64, Colr, Ctts, Edts, Elst, FourCC, Hdlr, Matrix, Mdhd, Mdia, Minf, Mvex, Mvhd,
    Pasp, Stbl, Stco, Stsc, Stsd, Stsz, StszSamples, Stts, Tkhd, Trak,
};
use std::io::{Read, Seek};

/// Most parts that a track may be cut into; each frame is looked up among them.
const MAX_EDITS: usize = 1000;
/// Most samples that are read: four days at 30 frames per second, and 240 MB here.
const MAX_SAMPLES: usize = 10_000_000;
/// Bytes of a visual sample entry before the boxes in it (ISO/IEC 14496-12, 12.1.3).
const ENTRY_BYTES: usize = 78;
/// The handler of video tracks.
const VIDEO: FourCC = FourCC::new(b"vide");

/// What is in a file.
#[derive(Debug)]
pub struct Movie {
    /// In the order of the file.
    pub tracks: Vec<Track>,
}

/// How the samples of a video track are coded.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleEntry {
    /// As in `avc1`.
    pub codec: FourCC,
    /// Body of the `avcC` box.
    pub avcc: Option<Vec<u8>>,
    pub colours: Colours,
    /// Width of a pixel over its height, where the file states it.
    pub pixel_aspect: Option<f64>,
}

/// One track.
#[derive(Debug)]
pub struct Track {
    /// `vide`, `soun`, ...
    pub handler: FourCC,
    /// Of the display.
    pub matrix: Matrix,
    /// When samples are shown.
    pub timeline: Timeline,
    /// One for each way of coding that is used; usually one.
    pub entries: Vec<SampleEntry>,
    /// In decoding order. For video tracks only.
    pub samples: Vec<Sample>,
}

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

impl Movie {
    /// Reads the index of a file of `len` bytes.
    pub fn read(file: &mut (impl Read + Seek), len: u64) -> Result<Self, Mp4Error> {
        let moov = read_moov(file, len)?;
        let scale = required::<Mvhd>(&moov, "the index (moov box)")?.timescale;
        let mut left = len;
        let traks = children(&moov).filter(|(kind, _)| *kind == Trak::KIND);
        let tracks: Vec<Track> = traks
            .map(|(_, body)| track(body, scale, &mut left))
            .collect::<Result<_, _>>()?;
        if tracks.iter().all(|t| t.samples.is_empty()) && child::<Mvex>(&moov).is_some() {
            return Err(Mp4Error::Fragmented);
        }
        Ok(Self { tracks })
    }

    /// The video track with the most samples.
    pub fn video(&self) -> Option<&Track> {
        let videos = self
            .tracks
            .iter()
            .filter(|t| t.handler == VIDEO && !t.entries.is_empty());
        // `max_by_key` takes the last of equals, a file's first track is its main one.
        videos.rev().max_by_key(|t| t.samples.len())
    }
}

fn track(trak: &[u8], movie_scale: u32, left: &mut u64) -> Result<Track, Mp4Error> {
    let matrix = required::<Tkhd>(trak, "a track")?.matrix;
    let mdia = inside::<Mdia>(trak, "a track")?;
    let scale = required::<Mdhd>(mdia, "a track")?.timescale;
    // Not decoded as a whole: its name is in any encoding.
    let handler = inside::<Hdlr>(mdia, "a track")?
        .get(8..)
        .and_then(|rest| rest.first_chunk::<4>());
    let handler =
        FourCC::from(handler.ok_or_else(|| Mp4Error::Bad("box \"hdlr\" is too short".into()))?);

    let (mut entries, mut list) = (Vec::new(), Vec::new());
    if handler == VIDEO {
        if scale == 0 {
            return Err(Mp4Error::Bad(
                "its video track has 0 ticks per second".into(),
            ));
        }
        let stbl = inside::<Stbl>(inside::<Minf>(mdia, "a track")?, "a track")?;
        // Behind its version and the number of entries.
        let stsd = inside::<Stsd>(stbl, TABLE)?.get(8..).unwrap_or_default();
        entries = children(stsd)
            .filter_map(|(kind, body)| entry(kind, body))
            .collect();
        list = samples(stbl, left)?;
    }
    let elst = child::<Edts>(trak).map_or(Ok(None), optional::<Elst>)?;
    let edits = elst.map_or_else(Vec::new, |elst| elst.entries);
    if edits.len() > MAX_EDITS {
        return Err(Mp4Error::Bad(format!(
            "its edit list has {} entries",
            edits.len()
        )));
    }
    Ok(Track {
        handler,
        matrix,
        timeline: Timeline::new(&edits, movie_scale, scale),
        entries,
        samples: list,
    })
}

/// A visual sample entry; what it says of colours and pixels counts where it can be read.
fn entry(codec: FourCC, body: &[u8]) -> Option<SampleEntry> {
    let boxes = body.get(ENTRY_BYTES..)?;
    let colours = match optional(boxes).ok().flatten() {
        Some(Colr::Nclx {
            transfer_characteristics: transfer,
            matrix_coefficients: matrix,
            full_range_flag,
            ..
        }) => Colours {
            transfer,
            matrix,
            full_range: Some(full_range_flag),
        },
        Some(Colr::Nclc {
            transfer_characteristics: transfer,
            matrix_coefficients: matrix,
            ..
        }) => Colours {
            transfer,
            matrix,
            full_range: None,
        },
        _ => Colours::default(),
    };
    let aspect = optional(boxes)
        .ok()
        .flatten()
        .map(|p: Pasp| f64::from(p.h_spacing) / f64::from(p.v_spacing));
    Some(SampleEntry {
        codec,
        avcc: child::<Avcc>(boxes).map(<[u8]>::to_vec),
        colours,
        pixel_aspect: aspect.filter(|a| (0.1..=10.0).contains(a)),
    })
}

const TABLE: &str = "the sample table";

/// The samples of a `stbl` box in decoding order. Those of one size have no list of which the
/// length could be compared: they take their bytes from `left`, what the tracks before have left of
/// the file.
fn samples(stbl: &[u8], left: &mut u64) -> Result<Vec<Sample>, Mp4Error> {
    let sizes = required::<Stsz>(stbl, TABLE)?.samples;
    let count = match &sizes {
        StszSamples::Identical { count, .. } => *count as usize,
        StszSamples::Different { sizes } => sizes.len(),
    };
    if let StszSamples::Identical { count, size } = sizes {
        let rest = left.checked_sub(u64::from(count) * u64::from(size));
        *left = rest.ok_or_else(|| {
            Mp4Error::Bad(format!(
                "{count} samples of {size} bytes are more than the file has"
            ))
        })?;
    }
    if count > MAX_SAMPLES {
        return Err(Mp4Error::Bad(format!("it has {count} samples")));
    }
    let sizes = match sizes {
        StszSamples::Identical { size, .. } => vec![size; count],
        StszSamples::Different { sizes } => sizes,
    };
    let mut samples = place(stbl, &sizes)?;
    time(stbl, &mut samples)?;
    Ok(samples)
}

/// Offsets, from `stsc` (runs of chunks) and `stco` or `co64` (where each chunk is).
fn place(stbl: &[u8], sizes: &[u32]) -> Result<Vec<Sample>, Mp4Error> {
    let chunks: Vec<u64> = match optional::<Stco>(stbl)? {
        Some(stco) => stco.entries.into_iter().map(u64::from).collect(),
        None => required::<Co64>(stbl, TABLE)?.entries,
    };
    let runs = required::<Stsc>(stbl, TABLE)?.entries;
    let mut run = 0;
    let mut samples = Vec::with_capacity(sizes.len());
    for (i, mut offset) in chunks.into_iter().enumerate() {
        while runs
            .get(run + 1)
            .is_some_and(|next| next.first_chunk as usize <= i + 1)
        {
            run += 1;
        }
        let in_chunk = runs.get(run).map_or(0, |r| r.samples_per_chunk as usize);
        for &size in sizes.iter().skip(samples.len()).take(in_chunk) {
            samples.push(Sample {
                offset,
                size,
                ticks: 0,
            });
            offset = offset.saturating_add(u64::from(size));
        }
    }
    if samples.len() < sizes.len() {
        return Err(Mp4Error::Bad(format!(
            "its index places {} of {} samples",
            samples.len(),
            sizes.len()
        )));
    }
    Ok(samples)
}

/// Composition times, from `stts` (durations) and `ctts` (offsets).
fn time(stbl: &[u8], samples: &mut [Sample]) -> Result<(), Mp4Error> {
    let (total, mut ticks) = (samples.len(), 0i64);
    let mut untimed = samples.iter_mut();
    for run in required::<Stts>(stbl, TABLE)?.entries {
        // Some cameras write a small negative duration for the last sample.
        let delta = i32::try_from(run.sample_delta).map_or(1, i64::from);
        for sample in untimed.by_ref().take(run.sample_count as usize) {
            sample.ticks = ticks;
            ticks = ticks.saturating_add(delta);
        }
    }
    let timed = total - untimed.len();
    if timed < total {
        return Err(Mp4Error::Bad(format!(
            "its index times {timed} of {total} samples"
        )));
    }
    let mut rest = samples.iter_mut();
    for run in optional::<Ctts>(stbl)?.unwrap_or_default().entries {
        // Version 0 is unsigned on paper; writers put negative numbers there anyway.
        let offset = i64::from(run.sample_offset as i32);
        for sample in rest.by_ref().take(run.sample_count as usize) {
            sample.ticks = sample.ticks.saturating_add(offset);
        }
    }
    Ok(())
}
