//! H.264 in MP4 files, decoded in a separate process if a decoder program is registered, else in
//! this one.
//!
//! The decoder (OpenH264) takes 8-bit 4:2:0 progressive streams of the Baseline, Main and High
//! profiles, B-frames included; [`Failure::Unsupported`] says why anything else is left to ffmpeg.

mod engine;
mod read;
mod sps;

pub use engine::serve;
pub use read::read;

use super::mp4::SampleEntry;
use crate::Fault;
use engine::Setup;
use mp4_atom::{Atom, Avcc};
use sps::{Sps, undelayed};

/// Why a stream is not read.
#[derive(Debug)]
pub enum Failure {
    /// It is this, which the decoder does not take; another one may.
    Unsupported(String),
    /// Something else.
    Fault(Fault),
}

impl From<Fault> for Failure {
    fn from(fault: Fault) -> Self {
        Self::Fault(fault)
    }
}

const START_CODE: [u8; 4] = [0, 0, 0, 1];

/// How a track's samples are cut into NAL units, and its parameter sets.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Bytes of a length, 1 to 4.
    length_size: usize,
    /// Parameter sets with start codes.
    headers: Vec<u8>,
    /// The first sequence parameter set.
    pub sps: Sps,
}

/// What a sample holds besides its slices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleKind {
    /// No other image is predicted from this one.
    pub disposable: bool,
    /// A sequence parameter set for another size is inside.
    pub resizes: Option<(usize, usize)>,
}

impl Config {
    /// Parses the body of an `avcC` box; `None` if it is damaged.
    fn parse(mut avcc: &[u8]) -> Option<Self> {
        let avcc = Avcc::decode_body(&mut avcc).ok()?;
        let mut headers = Vec::new();
        for nal in &avcc.sequence_parameter_sets {
            headers.extend_from_slice(&START_CODE);
            headers.extend(undelayed(nal)?);
        }
        for nal in &avcc.picture_parameter_sets {
            headers.extend_from_slice(&START_CODE);
            headers.extend_from_slice(nal);
        }
        let sps = avcc
            .sequence_parameter_sets
            .iter()
            .find_map(|nal| Sps::parse(nal))?;
        Some(Self {
            length_size: avcc.length_size.into(),
            headers,
            sps,
        })
    }

    /// The configuration of a track. Fails, with what it is, for those that the decoder does not
    /// take.
    fn of(entry: &SampleEntry) -> Result<Self, String> {
        let avcc = entry
            .avcc
            .as_deref()
            .ok_or("H.264 without a decoder configuration")?;
        let config =
            Self::parse(avcc).ok_or("H.264 whose decoder configuration (avcC) is damaged")?;
        config.check()?;
        Ok(config)
    }

    fn check(&self) -> Result<(), String> {
        let sps = &self.sps;
        let what = if sps.bit_depth != 8 {
            format!("{}-bit H.264 (profile {})", sps.bit_depth, sps.profile)
        } else if sps.chroma_format != 1 {
            let name = ["4:0:0", "4:2:0", "4:2:2", "4:4:4"].get(sps.chroma_format as usize);
            format!("H.264 with {} colour sampling", name.unwrap_or(&"unknown"))
        } else if !sps.progressive {
            "interlaced H.264".to_owned()
        } else if ![66, 77, 100].contains(&sps.profile) {
            format!("H.264 of profile {}", sps.profile)
        } else {
            return Ok(());
        };
        Err(what)
    }

    /// What a decoder of this stream must know.
    pub fn setup(&self) -> Setup {
        Setup {
            size: self.sps.size,
            headers: self.headers.clone(),
        }
    }

    /// Writes a sample with start codes to `out`. `None` when its lengths do not add up.
    pub fn annex_b(&self, sample: &[u8], out: &mut Vec<u8>) -> Option<SampleKind> {
        out.clear();
        let mut kind = SampleKind {
            disposable: true,
            resizes: None,
        };
        let (mut rest, mut slices) = (sample, 0);
        while !rest.is_empty() {
            let (length, tail) = rest.split_at_checked(self.length_size)?;
            let length = length.iter().fold(0usize, |n, &b| n << 8 | usize::from(b));
            let (nal, tail) = tail.split_at_checked(length)?;
            rest = tail;
            let Some(&header) = nal.first() else { continue };
            out.extend_from_slice(&START_CODE);
            match header & 31 {
                1..=5 => {
                    slices += 1;
                    kind.disposable &= header >> 5 & 3 == 0;
                }
                7 => {
                    let size = Sps::parse(nal)?.size;
                    kind.resizes = kind.resizes.or((size != self.sps.size).then_some(size));
                    continue;
                }
                _ => {}
            }
            out.extend_from_slice(nal);
        }
        (slices > 0).then_some(kind)
    }
}
