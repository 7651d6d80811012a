//! H.264 in MP4 files, decoded in a separate process if a decoder program is registered, else in this one.
//!
//! The decoder (OpenH264) takes 8-bit 4:2:0 progressive streams of the Baseline, Main and High
//! profiles, B-frames included; [`Unsupported`] says why anything else is left to ffmpeg.

mod engine;
mod read;
mod sps;

pub use engine::serve;
pub use read::{count, read};

use engine::Setup;
use sps::{Sps, undelayed};

/// Why a stream is not decoded here, for "the video is ...".
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unsupported(pub String);

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
    /// Parses the body of an `avcC` box.
    pub fn parse(avcc: &[u8]) -> Result<Self, Unsupported> {
        Self::parts(avcc).ok_or_else(|| Unsupported("H.264 whose decoder configuration (avcC) is damaged".into()))
    }

    fn parts(avcc: &[u8]) -> Option<Self> {
        let length_size = usize::from(avcc.get(4)? & 3) + 1;
        let mut rest = avcc.get(6..)?;
        let mut headers = Vec::new();
        let mut sps = None;
        let mut sets = |rest: &mut &[u8], count: u8| -> Option<()> {
            for _ in 0..count {
                let len = usize::from(u16::from_be_bytes(*rest.first_chunk()?));
                let nal = rest.get(2..2 + len)?;
                *rest = &rest[2 + len..];
                headers.extend_from_slice(&START_CODE);
                if nal.first()? & 31 == 7 {
                    sps = sps.or_else(|| Sps::parse(nal));
                    headers.extend(undelayed(nal)?);
                } else {
                    headers.extend_from_slice(nal);
                }
            }
            Some(())
        };
        sets(&mut rest, avcc.get(5)? & 31)?;
        let count = *rest.first()?;
        rest = &rest[1..];
        sets(&mut rest, count)?;
        Some(Self { length_size, headers, sps: sps? })
    }

    /// Fails for streams that the decoder does not take.
    pub fn check(&self) -> Result<(), Unsupported> {
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
        Err(Unsupported(what))
    }

    /// What a decoder of this stream must know.
    pub fn setup(&self) -> Setup {
        Setup { size: (self.sps.width, self.sps.height), headers: self.headers.clone() }
    }

    /// Writes a sample with start codes to `out`. `None` when its lengths do not add up.
    pub fn annex_b(&self, sample: &[u8], out: &mut Vec<u8>) -> Option<SampleKind> {
        out.clear();
        let mut kind = SampleKind { disposable: true, resizes: None };
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
                    let size = Sps::parse(nal).map(|s| (s.width, s.height))?;
                    kind.resizes = kind.resizes.or((size != (self.sps.width, self.sps.height)).then_some(size));
                    continue;
                }
                _ => {}
            }
            out.extend_from_slice(nal);
        }
        (slices > 0).then_some(kind)
    }
}
