//! Decodes one coded frame into one image with OpenH264, and serves that to another process at the other end of two pipes.

use super::wire::{self, Setup};
use crate::video::decoder::{Allowed, Confined, become_program, limit_self};
use openh264::OpenH264API;
use openh264::decoder::{DecodedYUV, Decoder, DecoderConfig, Flush};
use openh264::formats::YUVSource;
use std::ffi::OsString;
use std::io::{self, BufReader, BufWriter, ErrorKind, Read, Write};

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
///
/// # Errors
///
/// When the program cannot be executed, when the limits cannot be set, when the input is not that of [`crate::video::read()`], or when one of the two pipes
/// breaks. Damaged video is no error here: it is answered.
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
    output.write_all(&wire::MAGIC)?;
    output.write_all(&[u8::from(decoder.is_some())])?;
    output.flush()?;
    let Some(mut decoder) = decoder else { return Ok(()) };
    let mut frame = Vec::new();
    while let Some(flags) = wire::read_request(&mut input, &mut frame)? {
        match decoder.decode(&frame, flags & wire::FRESH != 0) {
            Frame::Damaged => output.write_all(&[wire::DAMAGED])?,
            Frame::NoMemory => output.write_all(&[wire::NO_MEMORY])?,
            Frame::Whole(_) if flags & wire::WANTED == 0 => output.write_all(&[wire::DECODED])?,
            Frame::Whole(yuv) => {
                output.write_all(&[wire::IMAGE])?;
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
