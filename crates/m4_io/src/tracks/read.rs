//! Reads `tracks.npz` as [`Tracks`].

use super::{ReadTracksError, TracksErrorCause};
use crate::npy::Header;
use m4_core::Tracks;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use zip::ZipArchive;
use zip::result::ZipError;

/// Reads the tracks of a clip of `frames` frames; each array may take `limit_bytes`.
///
/// # Errors
///
/// [`ReadTracksError`]: the file cannot be read, is no such archive, is of another clip, or is too large.
pub fn read(path: &Path, frames: usize, limit_bytes: u64) -> Result<Tracks, ReadTracksError> {
    inner(path, frames, limit_bytes).map_err(|cause| ReadTracksError {
        path: path.to_path_buf(),
        cause,
    })
}

fn inner(path: &Path, frames: usize, limit_bytes: u64) -> Result<Tracks, TracksErrorCause> {
    let file = BufReader::new(File::open(path).map_err(TracksErrorCause::Io)?);
    let mut archive = ZipArchive::new(file).map_err(|e| TracksErrorCause::Archive(e.to_string()))?;

    let of_clip = |shape: &[u64]| matches!(shape, [f, _, 3] if *f == frames as u64);
    let coords = array(&mut archive, "coords", &["<f4"], limit_bytes, &|shape| {
        (!of_clip(shape)).then(|| format!("({frames} frames, tracks, 3)"))
    })?
    .ok_or(TracksErrorCause::Missing("coords"))?;
    let count = coords.shape[1];
    let xyz: Vec<[f32; 3]> = coords.bytes.as_chunks::<12>().0.iter().map(place).collect();
    let tracks = count as usize;
    if let Some(at) = xyz.iter().position(|p| p.iter().any(|v| v.is_infinite())) {
        return Err(TracksErrorCause::Infinite {
            frame: at / tracks.max(1),
            track: at % tracks.max(1),
        });
    }
    let byte = ["|b1", "|u1", "|i1"];
    let visible = array(&mut archive, "visibs", &byte, limit_bytes, &|shape| {
        (shape != [frames as u64, count]).then(|| format!("({frames} frames, {count} tracks)"))
    })?
    .ok_or(TracksErrorCause::Missing("visibs"))?;
    let colours = array(&mut archive, "colors", &["|u1"], limit_bytes, &|shape| {
        (shape != [count, 3]).then(|| format!("({count} tracks, 3)"))
    })?;

    let confidence = array(&mut archive, "confidence", &["|u1"], limit_bytes, &|shape| {
        (shape != [frames as u64, count]).then(|| format!("({frames} frames, {count} tracks)"))
    })?;

    let wrong = |e: m4_core::ShapeError| TracksErrorCause::Archive(e.to_string());
    let visible = visible.bytes.iter().map(|&b| b != 0).collect();
    let mut made = Tracks::new(frames, tracks, xyz, visible).map_err(wrong)?;
    if let Some(confidence) = confidence {
        made = made.with_confidence_steps(confidence.bytes).map_err(wrong)?;
    }
    match colours {
        Some(rgb) => made.with_colours(rgb.bytes.as_chunks::<3>().0.to_vec()).map_err(wrong),
        None => Ok(made),
    }
}

fn place(bytes: &[u8; 12]) -> [f32; 3] {
    [0, 4, 8].map(|k| f32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]))
}

struct Array {
    shape: Vec<u64>,
    bytes: Vec<u8>,
}

/// One member of the archive; `None` if it is missing. `unfit` says what was expected if a shape is another.
fn array(
    archive: &mut ZipArchive<BufReader<File>>,
    name: &'static str,
    types: &[&str],
    limit_bytes: u64,
    unfit: &dyn Fn(&[u64]) -> Option<String>,
) -> Result<Option<Array>, TracksErrorCause> {
    let bad = |reason: String| TracksErrorCause::Array { array: name, reason };
    let mut member = match archive.by_name(&format!("{name}.npy")) {
        Ok(member) => member,
        Err(ZipError::FileNotFound) => return Ok(None),
        Err(e) => return Err(TracksErrorCause::Archive(e.to_string())),
    };
    let header = Header::read(&mut member).map_err(bad)?;
    if !types.contains(&header.descr.as_str()) {
        let (found, types) = (&header.descr, types.join(" or "));
        return Err(bad(format!("holds numbers of type {found}; save it as {types}")));
    }
    if header.fortran_order {
        return Err(bad("is in Fortran order; save it with numpy.ascontiguousarray".into()));
    }
    if let Some(expected) = unfit(&header.shape) {
        return Err(TracksErrorCause::Shape {
            array: name,
            found: header.shape,
            expected,
        });
    }
    // "<f4" and "|u1": the last letter is the number of bytes
    let width = if header.descr.ends_with('4') { 4 } else { 1 };
    let needed_bytes = header.len().and_then(|n| n.checked_mul(width)).unwrap_or(u64::MAX);
    if needed_bytes > limit_bytes {
        return Err(TracksErrorCause::TooLarge {
            array: name,
            needed_bytes,
            limit_bytes,
        });
    }
    let mut bytes = Vec::new();
    let read = member.take(needed_bytes.saturating_add(1)).read_to_end(&mut bytes);
    read.map_err(|e| bad(format!("cannot be unpacked ({e})")))?;
    if bytes.len() as u64 != needed_bytes {
        return Err(bad(format!(
            "has {} bytes of numbers, or more, where its shape {:?} asks for {needed_bytes}",
            bytes.len(),
            header.shape
        )));
    }
    Ok(Some(Array {
        shape: header.shape,
        bytes,
    }))
}
