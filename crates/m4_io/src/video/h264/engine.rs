//! Decodes frames with OpenH264, in this process or in another at the other end of two pipes, with the same result bit by bit.
//!
//! The protocol between the two; numbers are little-endian:
//!
//! ```text
//! to the decoder:    MAGIC  width u32  height u32  headers (u32, bytes)
//! from the decoder:  MAGIC  ready u8
//! then any number of times
//! to the decoder:    flags u8  frame (u32, bytes with start codes)
//! from the decoder:  answer u8, and for IMAGE the planes: luma, then both chroma, without padding
//! ```
//!
//! The decoder never says how long something is: its answers are the size that was agreed on.

use crate::video::colour::YuvMatrix;
use crate::video::decoder::{
    Allowed, Child, Confined, DecoderEnd, DecoderProgram, Halt, Start, become_program, limit_self,
};
use m4_core::{Progress, RgbImage};
use openh264::OpenH264API;
use openh264::decoder::{DecodedYUV, Decoder, DecoderConfig, Flush};
use openh264::formats::YUVSource;
use std::collections::VecDeque;
use std::ffi::OsString;
use std::io::{self, BufReader, BufWriter, ErrorKind, Read, Write};

/// Frames on their way to a child while the first answer is waited for: it decodes while this process converts.
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
        let mut hello = [0; MAGIC.len() + 1];
        if !child.read_exact(&mut hello).map_err(Refusal::Halt)? {
            return Err(Refusal::Halt(child.why_ended()));
        }
        let [magic @ .., ready] = hello;
        match (magic == MAGIC, ready) {
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

    /// Gives a frame (with start codes), behind parameter sets when it is `fresh`. An image is made only when it is wanted.
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
                let flags = if fresh { FRESH } else { 0 } | if wanted { WANTED } else { 0 };
                child.send(request(frame, flags));
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
            DAMAGED => Ok(None),
            DECODED => Ok(Some(None)),
            IMAGE => {
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
            NO_MEMORY => Err(Halt::Failed(DecoderEnd::Memory { limit_mb: memory_bytes >> 20 })),
            other => Err(answer(&format!("its answer {other} is none of minute4d's decoder"))),
        }
    }
}

fn answer(what: &str) -> Halt {
    Halt::Failed(DecoderEnd::Answer { what: what.to_owned() })
}

/// `dsOutOfMemory` of OpenH264's `DECODING_STATE`.
const OUT_OF_MEMORY: i64 = 0x4000;

/// The decoder of one stream, in this process.
pub struct H264 {
    decoder: Decoder,
    setup: Setup,
    /// The decoder has no parameter sets, or may have dropped them.
    fresh: bool,
    /// Parameter sets and a frame.
    joined: Vec<u8>,
}

/// What became of a coded frame.
pub enum Frame<'a> {
    /// It is damaged.
    Damaged,
    /// There is no memory for it.
    NoMemory,
    /// It is decoded.
    Whole(DecodedYUV<'a>),
}

impl H264 {
    /// `None` when the library cannot be set up.
    pub fn new(setup: Setup) -> Option<Self> {
        // Parameter sets were changed so that no image is held back (see `sps::undelayed`); flushing
        // would leak the decoder's images.
        let settings = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let decoder = Decoder::with_api_config(OpenH264API::from_source(), settings).ok()?;
        Some(Self { decoder, setup, fresh: true, joined: Vec::new() })
    }

    /// Decodes one frame (with start codes), behind the parameter sets when it is `fresh`.
    pub fn decode(&mut self, frame: &[u8], fresh: bool) -> Frame<'_> {
        let frame = if fresh || self.fresh {
            self.joined.clear();
            self.joined.extend_from_slice(&self.setup.headers);
            self.joined.extend_from_slice(frame);
            &self.joined
        } else {
            frame
        };
        // A decoder that met an error may have dropped its parameter sets.
        self.fresh = true;
        let size = self.setup.size;
        match self.decoder.decode(frame) {
            Ok(Some(yuv)) if yuv.dimensions() == size && holds(&yuv, size) => {
                self.fresh = false;
                Frame::Whole(yuv)
            }
            Err(e) if e.native_code() & OUT_OF_MEMORY != 0 => Frame::NoMemory,
            _ => Frame::Damaged,
        }
    }
}

/// Luma (0), blue (1) or red (2): its bytes, from a row to the next, and the size of what is seen.
fn plane<'a>(yuv: &'a DecodedYUV<'_>, which: usize, size: (usize, usize)) -> (&'a [u8], usize, (usize, usize)) {
    let (luma_stride, chroma_stride, _) = yuv.strides();
    let half = (size.0.div_ceil(2), size.1.div_ceil(2));
    match which {
        0 => (yuv.y(), luma_stride, size),
        1 => (yuv.u(), chroma_stride, half),
        _ => (yuv.v(), chroma_stride, half),
    }
}

/// True when the planes have all rows of an image of `size`.
fn holds(yuv: &DecodedYUV<'_>, size: (usize, usize)) -> bool {
    (0..3).all(|which| {
        let (bytes, stride, (width, height)) = plane(yuv, which, size);
        width <= stride && bytes.len() >= height.saturating_sub(1) * stride + width
    })
}

/// The rows of luma (0), blue (1) or red (2) of a [`Frame::Whole`], without what lies between them.
pub fn rows<'a>(yuv: &'a DecodedYUV<'_>, which: usize, size: (usize, usize)) -> impl Iterator<Item = &'a [u8]> {
    let (bytes, stride, (width, height)) = plane(yuv, which, size);
    bytes.chunks(stride.max(1)).take(height).map(move |row| &row[..width])
}

/// Decodes H.264 for another process until `input` ends: what a program does that was registered with
/// [`crate::video::set_decoder_program`] and finds the arguments of its registration in its command line.
/// `limits` are the arguments behind those. On Linux the limits of memory, time, files, processes and core dumps are set
/// before the first byte is read, for the whole process, and it can gain no privileges. Where a command line follows the
/// limits, the process becomes that program instead of decoding.
/// Fails when the program cannot be executed, when the limits cannot be set, when the input is not that of
/// [`crate::video::read()`], or when one of the two pipes breaks. Damaged video is no error here: it is answered.
pub fn serve(limits: &[OsString], input: impl Read, output: impl Write) -> io::Result<()> {
    let number = |i: usize| limits.get(i)?.to_str()?.parse().ok();
    let (Some(memory_bytes), Some(cpu_s)) = (number(0), number(1)) else {
        let what =
            "two limits were expected, bytes and seconds: this is a part of minute4d that is not to be started by hand";
        return Err(io::Error::new(ErrorKind::InvalidInput, what));
    };
    let allowed = Allowed { memory_bytes, cpu_s, idle_s: 0 };
    if let Some(line) = limits.get(2..).filter(|line| !line.is_empty()) {
        return Err(become_program(line, &allowed));
    }
    limit_self(&allowed, Confined::Decoder)?;
    // Requests are read in two parts.
    let mut input = BufReader::new(input);
    let mut output = BufWriter::with_capacity(1 << 16, output);
    let setup = Setup::read(&mut input)?;
    let size = setup.size;
    let decoder = H264::new(setup);
    output.write_all(&MAGIC)?;
    output.write_all(&[u8::from(decoder.is_some())])?;
    output.flush()?;
    let Some(mut decoder) = decoder else { return Ok(()) };
    let mut frame = Vec::new();
    while let Some(flags) = read_request(&mut input, &mut frame)? {
        match decoder.decode(&frame, flags & FRESH != 0) {
            Frame::Damaged => output.write_all(&[DAMAGED])?,
            Frame::NoMemory => output.write_all(&[NO_MEMORY])?,
            Frame::Whole(_) if flags & WANTED == 0 => output.write_all(&[DECODED])?,
            Frame::Whole(yuv) => {
                output.write_all(&[IMAGE])?;
                for plane in 0..3 {
                    for row in rows(&yuv, plane, size) {
                        output.write_all(row)?;
                    }
                }
            }
        }
        output.flush()?;
    }
    Ok(())
}

/// The first bytes in both directions.
pub const MAGIC: [u8; 8] = *b"m4h264\x00\x01";
/// Flag: the image is wanted, not only decoded.
pub const WANTED: u8 = 1;
/// Flag: parameter sets go before the frame.
pub const FRESH: u8 = 2;
/// Answer: the frame is damaged.
pub const DAMAGED: u8 = 0;
/// Answer: the frame was decoded, and is not needed.
pub const DECODED: u8 = 1;
/// Answer: the frame was decoded and follows.
pub const IMAGE: u8 = 2;
/// Answer: there is no memory for the frame.
pub const NO_MEMORY: u8 = 3;

/// What a decoder must know before its first frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setup {
    /// Pixels.
    pub size: (usize, usize),
    /// Parameter sets with start codes.
    pub headers: Vec<u8>,
}

impl Setup {
    /// As bytes.
    pub fn write(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend((self.size.0 as u32).to_le_bytes());
        bytes.extend((self.size.1 as u32).to_le_bytes());
        write_block(&self.headers, &mut bytes);
        bytes
    }

    /// From bytes.
    pub fn read(input: &mut impl Read) -> io::Result<Self> {
        let mut magic = [0; 8];
        input.read_exact(&mut magic)?;
        if magic != MAGIC {
            let what = "standard input is not that of minute4d: this is a part of it that is not to be started by hand";
            return Err(io::Error::new(ErrorKind::InvalidData, what));
        }
        let size = (read_u32(input)? as usize, read_u32(input)? as usize);
        let mut headers = Vec::new();
        read_block(input, &mut headers)?;
        Ok(Self { size, headers })
    }
}

/// A request to decode `frame`.
pub fn request(frame: &[u8], flags: u8) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(frame.len() + 5);
    bytes.push(flags);
    write_block(frame, &mut bytes);
    bytes
}

/// Reads a request into `frame` and returns its flags; `None` when there are no more.
pub fn read_request(input: &mut impl Read, frame: &mut Vec<u8>) -> io::Result<Option<u8>> {
    let mut flags = [0];
    match input.read_exact(&mut flags) {
        Ok(()) => {}
        Err(e) if e.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        Err(e) => return Err(e),
    }
    read_block(input, frame)?;
    Ok(Some(flags[0]))
}

/// Lengths of luma and of one chroma plane of an image, bytes.
pub fn plane_bytes((width, height): (usize, usize)) -> (usize, usize) {
    (width * height, width.div_ceil(2) * height.div_ceil(2))
}

fn write_block(block: &[u8], bytes: &mut Vec<u8>) {
    // Frames are at most some hundred MiB: `MAX_SAMPLE_BYTES`, and start codes.
    bytes.extend((block.len() as u32).to_le_bytes());
    bytes.extend_from_slice(block);
}

fn read_block(input: &mut impl Read, block: &mut Vec<u8>) -> io::Result<()> {
    let length = read_u32(input)?;
    block.clear();
    // Grows with what comes.
    input.take(u64::from(length)).read_to_end(block)?;
    if block.len() != length as usize {
        return Err(ErrorKind::UnexpectedEof.into());
    }
    Ok(())
}

fn read_u32(input: &mut impl Read) -> io::Result<u32> {
    let mut bytes = [0; 4];
    input.read_exact(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}
