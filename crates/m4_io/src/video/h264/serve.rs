//! The decoder process at the other end of the pipes.

use super::decode::{Frame, H264, rows};
use super::wire::{self, Setup};
use crate::video::decoder::{Allowed, Confined, become_program, limit_self};
use std::ffi::OsString;
use std::io::{self, BufReader, BufWriter, ErrorKind, Read, Write};

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
    let allowed = Allowed {
        memory_bytes,
        cpu_s,
        idle_s: 0,
    };
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
