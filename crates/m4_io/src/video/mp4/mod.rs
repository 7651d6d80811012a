//! MP4 and QuickTime files: the bytes of each frame, its presentation time, and the orientation.
//!
//! Boxes are decoded by `mp4-atom`, which takes memory as it reads, and only those that a reader of
//! clips needs: what cameras write into others cannot make a file unreadable.

mod movie;
mod shown;

pub use movie::{Movie, Sample, SampleEntry, Track};
pub use shown::{Orientation, Timeline};

use mp4_atom::{Atom, DecodeMaybe, Error, FourCC, Header, Moof, Moov, ReadFrom};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom};

/// Why a file could not be taken apart.
#[derive(Debug, thiserror::Error)]
pub enum Mp4Error {
    /// The system failed.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The file ends before its index.
    #[error("{0}")]
    Truncated(String),
    /// The index is spread over the file (`moof`), as in streams.
    #[error("a fragmented MP4 file")]
    Fragmented,
    /// A box contradicts itself or the file.
    #[error("{0}")]
    Bad(String),
}

/// What a track of a handler type holds, for messages.
pub fn kind_name(handler: FourCC) -> String {
    match handler.as_ref() {
        b"soun" => "sound".to_owned(),
        b"text" | b"sbtl" | b"subt" => "subtitles".to_owned(),
        b"meta" | b"tmcd" => "metadata".to_owned(),
        _ => format!("a track of type {:?}", name(handler)),
    }
}

/// The codec of a sample entry, for messages.
pub fn codec_name(entry: FourCC) -> String {
    match entry.as_ref() {
        b"hvc1" | b"hev1" | b"dvh1" | b"dvhe" => "HEVC (H.265)".to_owned(),
        b"av01" => "AV1".to_owned(),
        b"vp09" => "VP9".to_owned(),
        b"vp08" => "VP8".to_owned(),
        b"mp4v" => "MPEG-4 Part 2".to_owned(),
        b"apch" | b"apcn" | b"apcs" | b"apco" | b"ap4h" | b"ap4x" => "ProRes".to_owned(),
        b"jpeg" | b"mjpa" | b"mjpb" => "Motion JPEG".to_owned(),
        _ => format!("coded as {:?}", name(entry)),
    }
}

/// Longest index that is read into memory, bytes: an hour of 240 frames per second takes 40 MB.
const MAX_INDEX_BYTES: u64 = 512 << 20;

/// For messages: the four characters, where they are characters.
fn name(kind: FourCC) -> String {
    kind.as_ref()
        .iter()
        .map(|&b| {
            if b.is_ascii_graphic() {
                char::from(b)
            } else {
                '?'
            }
        })
        .collect()
}

/// True when bytes 4..8 of a file are a box type that MP4 and QuickTime files start with.
pub fn looks_like_mp4(start: &[u8]) -> bool {
    let kinds = [
        b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot",
    ];
    start
        .get(4..8)
        .is_some_and(|kind| kinds.iter().any(|k| *k == kind))
}

/// The body of the top-level `moov` box.
fn read_moov(file: &mut (impl Read + Seek), len: u64) -> Result<Vec<u8>, Mp4Error> {
    let (mut at, mut fragments, mut cut) = (0u64, false, None);
    while at + 8 <= len {
        file.seek(SeekFrom::Start(at))?;
        let header = match Header::read_from(file) {
            Ok(header) => header,
            Err(Error::Io(e)) if e.kind() == ErrorKind::UnexpectedEof => break,
            Err(Error::Io(e)) => return Err(e.into()),
            Err(e) => {
                return Err(Mp4Error::Bad(format!(
                    "the size of the box at byte {at} cannot be ({e})"
                )));
            }
        };
        let start = file.stream_position()?;
        let available = len.saturating_sub(start);
        let size = header.size.map_or(available, |size| size as u64);
        let missing = size.saturating_sub(available);
        if header.kind == Moov::KIND {
            if missing > 0 {
                let what =
                    format!("its index (moov box) needs {missing} bytes more than the file has");
                return Err(Mp4Error::Truncated(what));
            }
            if size > MAX_INDEX_BYTES {
                return Err(Mp4Error::Bad(format!(
                    "its index (moov box) is {} MiB long",
                    size >> 20
                )));
            }
            let mut bytes = vec![0; size as usize];
            file.read_exact(&mut bytes)?;
            return Ok(bytes);
        }
        fragments |= header.kind == Moof::KIND;
        if missing > 0 {
            cut = Some((header.kind, missing));
            break;
        }
        at = start + size;
    }
    if fragments {
        return Err(Mp4Error::Fragmented);
    }
    Err(Mp4Error::Truncated(match cut {
        Some((kind, missing)) => format!(
            "the file ends inside box {:?}, {missing} bytes early, and its index (moov box) is missing",
            name(kind)
        ),
        None => "its index (moov box) is missing".into(),
    }))
}

/// The boxes inside of a body, in order; stops at the first that does not fit.
fn children(mut rest: &[u8]) -> impl Iterator<Item = (FourCC, &[u8])> {
    std::iter::from_fn(move || {
        let header = Header::decode_maybe(&mut rest).ok()??;
        let (inside, behind) = rest.split_at_checked(header.size.unwrap_or(rest.len()))?;
        rest = behind;
        Some((header.kind, inside))
    })
}

/// The body of the first box of a kind.
fn child<T: Atom>(body: &[u8]) -> Option<&[u8]> {
    children(body)
        .find(|(kind, _)| *kind == T::KIND)
        .map(|(_, inside)| inside)
}

/// The body of a box that must be there.
fn inside<'a, T: Atom>(body: &'a [u8], parent: &str) -> Result<&'a [u8], Mp4Error> {
    child::<T>(body)
        .ok_or_else(|| Mp4Error::Bad(format!("box {:?} is missing from {parent}", name(T::KIND))))
}

fn decode<T: Atom>(mut body: &[u8]) -> Result<T, Mp4Error> {
    T::decode_body(&mut body).map_err(|e| {
        let what = match e {
            Error::OutOfBounds => "is too short for its entries".to_owned(),
            other => format!("cannot be read ({other})"),
        };
        Mp4Error::Bad(format!("box {:?} {what}", name(T::KIND)))
    })
}

/// The first box of a kind, decoded; `None` if there is none.
fn optional<T: Atom>(body: &[u8]) -> Result<Option<T>, Mp4Error> {
    child::<T>(body).map(decode).transpose()
}

/// The first box of a kind, which must be there.
fn required<T: Atom>(body: &[u8], parent: &str) -> Result<T, Mp4Error> {
    decode(inside::<T>(body, parent)?)
}
