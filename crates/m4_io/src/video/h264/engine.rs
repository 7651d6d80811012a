//! Decodes frames in this process or in another, with the same result bit by bit.

use super::decode::{Frame, H264};
use super::wire::{self, Setup, plane_bytes};
use crate::video::colour::YuvMatrix;
use crate::video::decoder::{Allowed, Child, DecoderEnd, DecoderProgram, Halt, Start};
use m4_core::{Progress, RgbImage};
use openh264::formats::YUVSource;
use std::collections::VecDeque;
use std::io;

/// Frames that are on their way to a child while the answer to the first of them is waited for: it decodes while
/// this process converts.
const WINDOW: usize = 6;
/// Bytes of messages that a child may write: OpenH264 writes none, the system a few.
const MESSAGE_BYTES: u64 = 1 << 20;

/// What became of a frame: `None` if it is damaged, and an image where one was wanted.
type Answer = Option<Option<RgbImage>>;

/// The decoder of one stream.
pub struct Engine<'a> {
    place: Place<'a>,
    matrix: YuvMatrix,
    size: (usize, usize),
}

enum Place<'a> {
    Here { decoder: Box<H264>, done: VecDeque<Answer> },
    There { child: Child<'a>, memory_bytes: u64 },
}

/// Why a child decodes nothing.
#[derive(Debug)]
pub enum Refusal {
    /// It cannot be started.
    Start(io::Error),
    /// It ended.
    Halt(Halt),
    /// OpenH264 cannot be set up.
    Setup,
}

impl<'a> Engine<'a> {
    /// Decodes in this process; `None` when the library cannot be set up.
    pub fn here(setup: Setup, matrix: YuvMatrix) -> Option<Self> {
        let size = setup.size;
        let (decoder, done) = (Box::new(H264::new(setup)?), VecDeque::new());
        Some(Self { place: Place::Here { decoder, done }, matrix, size })
    }

    /// Decodes in a process of its own.
    pub fn there(
        program: &DecoderProgram,
        setup: &Setup,
        matrix: YuvMatrix,
        allowed: Allowed,
        progress: &'a dyn Progress,
    ) -> Result<Self, Refusal> {
        let start = Start { talks: true, bare: false };
        let mut command = program.command(&allowed);
        let child = Child::start(&mut command, start, allowed, MESSAGE_BYTES, Box::new(|_| true), progress);
        let mut child = child.map_err(Refusal::Start)?;
        child.send(setup.write());
        let mut hello = [0; wire::MAGIC.len() + 1];
        if !child.read_exact(&mut hello).map_err(Refusal::Halt)? {
            return Err(Refusal::Halt(child.why_ended()));
        }
        let [magic @ .., ready] = hello;
        match (magic == wire::MAGIC, ready) {
            (true, 1) => {
                Ok(Self { place: Place::There { child, memory_bytes: allowed.memory_bytes }, matrix, size: setup.size })
            }
            (true, 0) => Err(Refusal::Setup),
            _ => Err(Refusal::Halt(answer("it does not answer as minute4d's decoder does"))),
        }
    }

    /// Frames that may be given before an answer is taken.
    pub fn window(&self) -> usize {
        match self.place {
            Place::Here { .. } => 0,
            Place::There { .. } => WINDOW,
        }
    }

    /// Gives a frame (with start codes), behind parameter sets when it is `fresh`. An image is made only when it
    /// is wanted.
    pub fn give(&mut self, frame: &[u8], fresh: bool, wanted: bool) {
        match &mut self.place {
            Place::Here { decoder, done } => done.push_back(match decoder.decode(frame, fresh) {
                Frame::Damaged | Frame::NoMemory => None,
                Frame::Whole(_) if !wanted => Some(None),
                Frame::Whole(yuv) => {
                    let (luma, chroma, _) = yuv.strides();
                    let planes = [yuv.y(), yuv.u(), yuv.v()];
                    let image = self.matrix.image_420(self.size, planes, [luma, chroma]);
                    image.map(Some)
                }
            }),
            Place::There { child, .. } => {
                let flags = if fresh { wire::FRESH } else { 0 } | if wanted { wire::WANTED } else { 0 };
                child.send(wire::request(frame, flags));
            }
        }
    }

    /// What became of the first of the frames given whose answer was not taken.
    pub fn take(&mut self) -> Result<Answer, Halt> {
        let (child, memory_bytes) = match &mut self.place {
            Place::Here { done, .. } => return Ok(done.pop_front().flatten()),
            Place::There { child, memory_bytes } => (child, *memory_bytes),
        };
        let mut kind = [0];
        if !child.read_exact(&mut kind)? {
            return Err(child.why_ended());
        }
        match kind[0] {
            wire::DAMAGED => Ok(None),
            wire::DECODED => Ok(Some(None)),
            wire::IMAGE => {
                let (luma, chroma) = plane_bytes(self.size);
                let mut bytes = vec![0; luma + 2 * chroma];
                if !child.read_exact(&mut bytes)? {
                    return Err(child.why_ended());
                }
                let (y, rest) = bytes.split_at(luma);
                let (u, v) = rest.split_at(chroma);
                let strides = [self.size.0, self.size.0.div_ceil(2)];
                Ok(self.matrix.image_420(self.size, [y, u, v], strides).map(Some))
            }
            wire::NO_MEMORY => Err(Halt::Failed(DecoderEnd::Memory { limit_mb: memory_bytes >> 20 })),
            other => Err(answer(&format!("its answer {other} is none of minute4d's decoder"))),
        }
    }
}

fn answer(what: &str) -> Halt {
    Halt::Failed(DecoderEnd::Answer { what: what.to_owned() })
}
