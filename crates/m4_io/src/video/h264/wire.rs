//! The protocol between the program and its decoder over two pipes. Numbers are little-endian.
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

use std::io::{self, Read};

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
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
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
        Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
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
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    Ok(())
}

fn read_u32(input: &mut impl Read) -> io::Result<u32> {
    let mut bytes = [0; 4];
    input.read_exact(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}
