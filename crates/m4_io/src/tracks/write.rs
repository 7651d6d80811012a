//! Writes [`Tracks`] as `tracks.npz`.

use crate::atomic;
use crate::npy::Header;
use m4_core::Tracks;
use std::io::{self, Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Writes tracks, atomically; the same tracks give the same bytes.
///
/// # Errors
///
/// Error of the operating system.
pub fn write(path: &Path, tracks: &Tracks) -> io::Result<()> {
    let (frames, count) = (tracks.frames() as u64, tracks.count() as u64);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let places = tracks.xyz().as_flattened();
    let places: Vec<u8> = places.iter().flat_map(|v| v.to_le_bytes()).collect();
    member(&mut zip, "coords", "<f4", vec![frames, count, 3], &places)?;
    let visible: Vec<u8> = tracks.visible().iter().map(|&v| u8::from(v)).collect();
    member(&mut zip, "visibs", "|b1", vec![frames, count], &visible)?;
    if let Some(colours) = tracks.colours() {
        member(&mut zip, "colors", "|u1", vec![count, 3], colours.as_flattened())?;
    }
    if let Some(confidence) = tracks.confidence_steps() {
        member(&mut zip, "confidence", "|u1", vec![frames, count], confidence)?;
    }
    let bytes = zip.finish().map_err(io::Error::from)?;
    atomic::write(path, bytes.get_ref())
}

fn member(
    zip: &mut ZipWriter<Cursor<Vec<u8>>>,
    name: &str,
    descr: &str,
    shape: Vec<u64>,
    bytes: &[u8],
) -> io::Result<()> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .last_modified_time(DateTime::default())
        .large_file(bytes.len() as u64 + 4096 > u64::from(u32::MAX));
    zip.start_file(format!("{name}.npy"), options)?;
    zip.write_all(&Header::new(descr, shape).to_bytes())?;
    zip.write_all(bytes)
}
