//! The sample tables: the position of each frame's bytes, and its time.

use super::Mp4Error;
use super::boxes::{Body, child, required};

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
