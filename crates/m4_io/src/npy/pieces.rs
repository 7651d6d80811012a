//! Arrays that are made piece by piece, written, and compared with what is on the disk.

use super::Header;
use std::io::{self, Read, Seek, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// An array whose bytes are made piece by piece, so that it is never in memory as a whole.
pub(crate) struct Pieces<'a> {
    /// Its name in an archive or folder, without `.npy`.
    pub name: &'static str,
    /// Type of its numbers, such as `<f4`.
    pub descr: &'static str,
    /// Slowest dimension first.
    pub shape: Vec<usize>,
    /// How many pieces it has.
    pub count: usize,
    /// The bytes of piece `i`, in C order.
    pub piece: Box<dyn Fn(usize) -> Vec<u8> + 'a>,
}

impl Pieces<'_> {
    fn header(&self) -> Header {
        Header::new(self.descr, self.shape.iter().map(|&n| n as u64).collect())
    }
}

/// Writes `array`; `go_on` is asked before each piece.
///
/// # Errors
///
/// That of `to`, or [`io::ErrorKind::Interrupted`] if `go_on` says no.
pub(crate) fn write_npy(to: &mut dyn Write, array: &Pieces<'_>, go_on: &dyn Fn() -> bool) -> io::Result<()> {
    to.write_all(&array.header().to_bytes())?;
    for i in 0..array.count {
        if !go_on() {
            return Err(io::ErrorKind::Interrupted.into());
        }
        to.write_all(&(array.piece)(i))?;
    }
    Ok(())
}

/// Writes `arrays` as numpy's `savez_compressed` does; the same arrays give the same bytes.
///
/// # Errors
///
/// As [`write_npy`].
pub(crate) fn write_npz(to: impl Write + Seek, arrays: &[Pieces<'_>], go_on: &dyn Fn() -> bool) -> io::Result<()> {
    let mut zip = ZipWriter::new(to);
    for array in arrays {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .last_modified_time(DateTime::default())
            .large_file(true);
        zip.start_file(format!("{}.npy", array.name), options)?;
        write_npy(&mut zip, array, go_on)?;
    }
    zip.finish()?.flush()
}

/// Compares what is on the disk with `array`, bit by bit.
///
/// # Errors
///
/// The first difference, in words.
pub(crate) fn same(mut from: impl Read, array: &Pieces<'_>) -> Result<(), String> {
    let header = Header::read(&mut from)?;
    if header != array.header() {
        return Err(format!("has the header {header:?}"));
    }
    for i in 0..array.count {
        let expected = (array.piece)(i);
        let mut found = vec![0; expected.len()];
        from.read_exact(&mut found)
            .map_err(|e| format!("ends in frame {i} ({e})"))?;
        if found != expected {
            return Err(format!("differs in frame {i}"));
        }
    }
    match from.read(&mut [0]) {
        Ok(0) => Ok(()),
        Ok(_) => Err("goes on after its last frame".into()),
        Err(e) => Err(e.to_string()),
    }
}
