//! Tracks as `tracks.npz`, with the array names of TAPIP3D, so that its files can be read directly.
//!
//! ```text
//! coords   [frames][tracks][3]   float32   world units; NaN where unknown
//! visibs   [frames][tracks]      bool (or 8-bit integers)
//! colors   [tracks][3]           uint8     optional, sRGB
//! confidence [frames][tracks]    uint8     optional, of the places: 255 is sure (ours; not known to TAPIP3D)
//! ```
//!
//! Other members of the archive are passed over. Files are not trusted: shapes are compared with
//! the clip and with the memory allowed before anything is read, and no member is read further than
//! its shape says.

use crate::error::AtPath;
use crate::npy::{Array, Header, Npz, Number};
use crate::range::{self, COORDINATE};
use crate::{Fault, ReadError, atomic};
use m4_core::Tracks;
use std::io::{self, Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

const HINT: &str = "give the tracks of this clip, or remove `tracks_path` from the list of frames";

/// Reads the tracks of a clip of `frames` frames; each array may take `limit_bytes`.
pub fn read(path: &Path, frames: usize, limit_bytes: u64) -> Result<Tracks, ReadError> {
    inner(path, frames, limit_bytes).at(path)
}

fn inner(path: &Path, frames: usize, limit_bytes: u64) -> Result<Tracks, Fault> {
    let mut npz = Npz::open(path)?;
    let coords = npz.need("coords", limit_bytes)?;
    let tracks = match coords.shape[..] {
        [f, tracks, 3] if f == frames => tracks,
        _ => {
            return Err(unfit(
                "coords",
                &coords,
                &format!("({frames} frames, tracks, 3)"),
            ));
        }
    };
    if coords.number != Number::F32 {
        return Err(Fault::bad(
            "the array `coords` holds other numbers than float32",
            "save it as <f4",
        ));
    }
    let xyz = coords.numbers()?.values;
    let xyz: Vec<[f32; 3]> = xyz
        .as_chunks::<3>()
        .0
        .iter()
        .map(|p| p.map(|v| v as f32))
        .collect();
    check_places(&xyz, tracks)?;
    let a_frame = format!("({frames} frames, {tracks} tracks)");
    let bytes = [Number::Bool, Number::U8, Number::I8];
    let visible = of_bytes(
        npz.need("visibs", limit_bytes)?,
        "visibs",
        &bytes,
        &[frames, tracks],
        &a_frame,
    )?;
    let colours = match npz.array("colors", limit_bytes)? {
        Some(array) => Some(of_bytes(
            array,
            "colors",
            &[Number::U8],
            &[tracks, 3],
            &format!("({tracks} tracks, 3)"),
        )?),
        None => None,
    };
    let confidence = match npz.array("confidence", limit_bytes)? {
        Some(array) => Some(of_bytes(
            array,
            "confidence",
            &[Number::U8],
            &[frames, tracks],
            &a_frame,
        )?),
        None => None,
    };

    let wrong = |e: m4_core::ShapeError| Fault::bad(e.to_string(), HINT);
    let visible = visible.iter().map(|&b| b != 0).collect();
    let mut tracks3d = Tracks::new(frames, tracks, xyz, visible).map_err(wrong)?;
    if let Some(confidence) = confidence {
        tracks3d = tracks3d.with_confidence_steps(confidence).map_err(wrong)?;
    }
    match colours {
        Some(rgb) => tracks3d
            .with_colours(rgb.as_chunks::<3>().0.to_vec())
            .map_err(wrong),
        None => Ok(tracks3d),
    }
}

/// Refuses places `[frames][tracks]` out of range.
pub(crate) fn check_places(xyz: &[[f32; 3]], tracks: usize) -> Result<(), Fault> {
    let strays = |v: &f32| !v.is_nan() && !COORDINATE.contains(&f64::from(*v));
    let stray = |(at, p): (usize, &[f32; 3])| Some((at, *p.iter().find(|v| strays(v))?));
    let Some((at, v)) = xyz.iter().enumerate().find_map(stray) else {
        return Ok(());
    };
    let (frame, track) = (at / tracks.max(1), at % tracks.max(1));
    let expected = range::words(&COORDINATE, "scene units");
    let what = format!(
        "the position of track {track} in frame {frame} holds {v:e}; {expected} was expected"
    );
    Err(Fault::bad(what, "unknown positions must be NaN"))
}

fn unfit(name: &str, array: &Array<'_>, expected: &str) -> Fault {
    Fault::bad(
        format!(
            "its array `{name}` has shape {:?} where {expected} was expected",
            array.shape
        ),
        HINT,
    )
}

/// The bytes of an array that must have this shape and one of these types of a byte.
fn of_bytes(
    mut array: Array<'_>,
    name: &str,
    types: &[Number],
    shape: &[usize],
    expected: &str,
) -> Result<Vec<u8>, Fault> {
    if array.shape != shape {
        return Err(unfit(name, &array, expected));
    }
    if !types.contains(&array.number) {
        let what = format!(
            "its array `{name}` holds numbers of type {:?}",
            array.number
        );
        return Err(Fault::bad(what, format!("save it as one of {types:?}")));
    }
    let bytes = array.next_bytes(shape.iter().product())?;
    array.end()?;
    Ok(bytes)
}

/// Writes tracks, atomically; the same tracks give the same bytes.
pub fn write(path: &Path, tracks: &Tracks) -> io::Result<()> {
    let (frames, count) = (tracks.frames() as u64, tracks.count() as u64);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let places = tracks.xyz().as_flattened();
    let places: Vec<u8> = places.iter().flat_map(|v| v.to_le_bytes()).collect();
    member(&mut zip, "coords", "<f4", vec![frames, count, 3], &places)?;
    let visible: Vec<u8> = tracks.visible().iter().map(|&v| u8::from(v)).collect();
    member(&mut zip, "visibs", "|b1", vec![frames, count], &visible)?;
    if let Some(colours) = tracks.colours() {
        member(
            &mut zip,
            "colors",
            "|u1",
            vec![count, 3],
            colours.as_flattened(),
        )?;
    }
    if let Some(confidence) = tracks.confidence_steps() {
        member(
            &mut zip,
            "confidence",
            "|u1",
            vec![frames, count],
            confidence,
        )?;
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
