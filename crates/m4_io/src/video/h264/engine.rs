//! Decodes frames with OpenH264, in this process or in another at the other end of two pipes, with
//! the same result bit by bit.
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

use crate::video::colour::bytes_420;
use crate::video::decoder::{
    Allowed, Child, Confined, DecoderProgram, Start, become_program, limit_self,
};
use crate::{DecoderEnd, ErrorKind, Fault};
use m4_core::Progress;
use openh264::OpenH264API;
use openh264::decoder::{DecodedYUV, Decoder, DecoderConfig, Flush};
use openh264::formats::YUVSource;
use std::collections::VecDeque;
use std::ffi::OsString;
use std::io::{self, BufReader, BufWriter, Read, Write};

/// Frames on their way to a child while the first answer is waited for: it decodes while this
/// process converts.
const WINDOW: usize = 6;
/// Bytes of messages that a child may write: OpenH264 writes none, the system a few.
const MESSAGE_BYTES: u64 = 1 << 20;

/// What became of a coded frame.
#[derive(Debug)]
pub enum Frame {
    /// It is damaged, or there is no memory for it in this process.
    Damaged,
    /// It is decoded, and not wanted.
    Decoded,
    /// Its planes: luma, then both chroma, without padding.
    Image(Vec<u8>),
    /// There is no memory for it.
    NoMemory,
}

/// The decoder of one stream.
pub struct Engine<'a> {
    place: Place<'a>,
    size: (usize, usize),
}

enum Place<'a> {
    Here {
        decoder: Box<H264>,
        done: VecDeque<Frame>,
    },
    There(Child<'a>),
}

impl<'a> Engine<'a> {
    /// Starts `program`; without one this process decodes. `None` when OpenH264 cannot be set up.
    pub fn start(
        program: Option<&DecoderProgram>,
        setup: Setup,
        allowed: Allowed,
        progress: &'a dyn Progress,
    ) -> Result<Option<Self>, Fault> {
        let size = setup.size;
        let Some(program) = program else {
            let decoder = H264::new(setup).map(Box::new);
            return Ok(decoder.map(|decoder| Self {
                place: Place::Here {
                    decoder,
                    done: VecDeque::new(),
                },
                size,
            }));
        };
        let start = Start {
            decoder: "the H.264 decoder",
            talks: true,
            bare: false,
        };
        let mut command = program.command(&allowed);
        let child = Child::start(
            &mut command,
            start,
            allowed,
            MESSAGE_BYTES,
            Box::new(|_| true),
            progress,
        );
        let mut child = child.map_err(|e| {
            let what = format!(
                "the decoder program {} cannot be started ({e})",
                program.program.display()
            );
            Fault::Content {
                kind: ErrorKind::Io,
                what,
                hint: "install the program again".into(),
            }
        })?;
        child.send(setup.write());
        let mut hello = [0; MAGIC.len() + 1];
        receive(&mut child, &mut hello)?;
        let [magic @ .., ready] = hello;
        match (magic == MAGIC, ready) {
            (true, 1) => Ok(Some(Self {
                place: Place::There(child),
                size,
            })),
            (true, 0) => Ok(None),
            _ => Err(unknown(
                &child,
                "it does not answer as minute4d's decoder does".into(),
            )),
        }
    }

    /// Frames that may be given before an answer is taken.
    pub fn window(&self) -> usize {
        match self.place {
            Place::Here { .. } => 0,
            Place::There(_) => WINDOW,
        }
    }

    /// Gives a frame (with start codes), behind parameter sets when it is `fresh`. An image is made
    /// only when it is wanted.
    pub fn give(&mut self, frame: &[u8], fresh: bool, wanted: bool) {
        match &mut self.place {
            Place::Here { decoder, done } => done.push_back(decoder.decode(frame, fresh, wanted)),
            Place::There(child) => {
                let mut request =
                    vec![if fresh { FRESH } else { 0 } | if wanted { WANTED } else { 0 }];
                write_block(frame, &mut request);
                child.send(request);
            }
        }
    }

    /// What became of the first of the frames given whose answer was not taken.
    pub fn take(&mut self) -> Result<Frame, Fault> {
        let child = match &mut self.place {
            Place::Here { done, .. } => return Ok(done.pop_front().unwrap_or(Frame::Damaged)),
            Place::There(child) => child,
        };
        let mut answer = [0];
        receive(child, &mut answer)?;
        match answer[0] {
            DAMAGED => Ok(Frame::Damaged),
            DECODED => Ok(Frame::Decoded),
            IMAGE => {
                let mut planes = vec![0; bytes_420(self.size)];
                receive(child, &mut planes)?;
                Ok(Frame::Image(planes))
            }
            NO_MEMORY => {
                let limit_mb = child.allowed.memory_bytes >> 20;
                Err(child.failed(DecoderEnd::Memory { limit_mb }))
            }
            other => Err(unknown(
                child,
                format!("its answer {other} is none of minute4d's decoder"),
            )),
        }
    }
}

/// Fills `bytes` with what the child writes.
fn receive(child: &mut Child<'_>, bytes: &mut [u8]) -> Result<(), Fault> {
    if child.read_exact(bytes)? {
        Ok(())
    } else {
        Err(child.why_ended())
    }
}

fn unknown(child: &Child<'_>, what: String) -> Fault {
    child.failed(DecoderEnd::Answer { what })
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

impl H264 {
    /// `None` when the library cannot be set up.
    pub fn new(setup: Setup) -> Option<Self> {
        // Parameter sets were changed so that no image is held back (see `sps::undelayed`);
        // flushing would leak the decoder's images.
        let settings = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let decoder = Decoder::with_api_config(OpenH264API::from_source(), settings).ok()?;
        Some(Self {
            decoder,
            setup,
            fresh: true,
            joined: Vec::new(),
        })
    }

    /// Decodes one frame (with start codes), behind the parameter sets when it is `fresh`.
    pub fn decode(&mut self, frame: &[u8], fresh: bool, wanted: bool) -> Frame {
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
            Ok(Some(yuv)) if yuv.dimensions() == size => {
                self.fresh = false;
                if wanted {
                    packed(&yuv, size).map_or(Frame::Damaged, Frame::Image)
                } else {
                    Frame::Decoded
                }
            }
            Err(e) if e.native_code() & OUT_OF_MEMORY != 0 => Frame::NoMemory,
            _ => Frame::Damaged,
        }
    }
}

/// The planes of an image of `size` without what lies between their rows; `None` if rows are
/// missing.
fn packed(yuv: &DecodedYUV<'_>, size: (usize, usize)) -> Option<Vec<u8>> {
    let (luma, chroma, _) = yuv.strides();
    let half = (size.0.div_ceil(2), size.1.div_ceil(2));
    let mut bytes = Vec::with_capacity(bytes_420(size));
    for (plane, stride, (width, height)) in [
        (yuv.y(), luma, size),
        (yuv.u(), chroma, half),
        (yuv.v(), chroma, half),
    ] {
        for row in 0..height {
            bytes.extend_from_slice(plane.get(row * stride..)?.get(..width)?);
        }
    }
    Some(bytes)
}

/// Decodes H.264 for another process until `input` ends: what a program does that was registered
/// with [`crate::video::set_decoder_program`] and finds the arguments of its registration in its
/// command line. `limits` are the arguments behind those. On Linux the limits of memory, time,
/// files, processes and core dumps are set before the first byte is read, for the whole process,
/// and it can gain no privileges. Where a command line follows the limits, the process becomes that
/// program instead of decoding. Fails when the program cannot be executed, when the limits cannot
/// be set, when the input is not that of [`crate::video::read()`], or when one of the two pipes
/// breaks. Damaged video is no error here: it is answered.
pub fn serve(limits: &[OsString], input: impl Read, output: impl Write) -> io::Result<()> {
    let number = |i: usize| limits.get(i)?.to_str()?.parse().ok();
    let (Some(memory_bytes), Some(cpu_s)) = (number(0), number(1)) else {
        let what = "two limits were expected, bytes and seconds: this is a part of minute4d that is not to be started by hand";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
    };
    let allowed = Allowed {
        memory_bytes,
        cpu_s,
        idle_s: 0,
    };
    if let Some((program, arguments)) = limits[2..].split_first() {
        return Err(become_program(program, arguments, &allowed));
    }
    limit_self(&allowed, Confined::Decoder)?;
    // Requests are read in two parts.
    let mut input = BufReader::new(input);
    let mut output = BufWriter::with_capacity(1 << 16, output);
    let decoder = H264::new(Setup::read(&mut input)?);
    output.write_all(&MAGIC)?;
    output.write_all(&[u8::from(decoder.is_some())])?;
    output.flush()?;
    let Some(mut decoder) = decoder else {
        return Ok(());
    };
    let mut frame = Vec::new();
    while let Some(flags) = read_request(&mut input, &mut frame)? {
        let (answer, planes) = match decoder.decode(&frame, flags & FRESH != 0, flags & WANTED != 0)
        {
            Frame::Damaged => (DAMAGED, Vec::new()),
            Frame::Decoded => (DECODED, Vec::new()),
            Frame::Image(planes) => (IMAGE, planes),
            Frame::NoMemory => (NO_MEMORY, Vec::new()),
        };
        output.write_all(&[answer])?;
        output.write_all(&planes)?;
        output.flush()?;
    }
    Ok(())
}

/// The first bytes in both directions.
const MAGIC: [u8; 8] = *b"m4h264\x00\x01";
/// Flag: the image is wanted, not only decoded.
const WANTED: u8 = 1;
/// Flag: parameter sets go before the frame.
const FRESH: u8 = 2;
// Answers: see `Frame`.
const DAMAGED: u8 = 0;
const DECODED: u8 = 1;
const IMAGE: u8 = 2;
const NO_MEMORY: u8 = 3;

/// What a decoder must know before its first frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setup {
    /// Pixels.
    pub size: (usize, usize),
    /// Parameter sets with start codes.
    pub headers: Vec<u8>,
}

impl Setup {
    fn write(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend((self.size.0 as u32).to_le_bytes());
        bytes.extend((self.size.1 as u32).to_le_bytes());
        write_block(&self.headers, &mut bytes);
        bytes
    }

    fn read(input: &mut impl Read) -> io::Result<Self> {
        let mut magic = [0; 8];
        input.read_exact(&mut magic)?;
        if magic != MAGIC {
            let what = "standard input is not that of minute4d: this is a part of it that is not to be started by hand";
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        let size = (read_u32(input)? as usize, read_u32(input)? as usize);
        let mut headers = Vec::new();
        read_block(input, &mut headers)?;
        Ok(Self { size, headers })
    }
}

/// Reads a request into `frame` and returns its flags; `None` when there are no more.
fn read_request(input: &mut impl Read, frame: &mut Vec<u8>) -> io::Result<Option<u8>> {
    let mut flags = [0];
    match input.read_exact(&mut flags) {
        Ok(()) => {}
        Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        Err(e) => return Err(e),
    }
    read_block(input, frame)?;
    Ok(Some(flags[0]))
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
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    Ok(())
}

fn read_u32(input: &mut impl Read) -> io::Result<u32> {
    let mut bytes = [0; 4];
    input.read_exact(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}
