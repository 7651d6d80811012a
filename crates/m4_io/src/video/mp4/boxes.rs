//! MP4 boxes: a type of four characters, a length, and bytes.

use super::Mp4Error;
use std::io::{Read, Seek, SeekFrom};

/// Longest index that is read into memory, bytes: an hour of 240 frames per second takes 40 MB.
const MAX_INDEX_BYTES: u64 = 512 << 20;

/// The type: four characters.
pub type Kind = [u8; 4];

/// For messages.
pub fn name(kind: Kind) -> String {
    kind.iter().map(|&b| if b.is_ascii_graphic() { char::from(b) } else { '?' }).collect()
}

/// True when bytes 4..8 of a file are a box type that MP4 and QuickTime files start with.
pub fn looks_like_mp4(start: &[u8]) -> bool {
    let known: [&Kind; 7] = [b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot"];
    start.get(4..8).is_some_and(|kind| known.iter().any(|k| *k == kind))
}

/// The body of the top-level `moov` box.
pub fn read_moov(file: &mut (impl Read + Seek), len: u64) -> Result<Vec<u8>, Mp4Error> {
    let (mut at, mut fragments, mut cut) = (0u64, false, None);
    while at + 8 <= len {
        file.seek(SeekFrom::Start(at))?;
        let mut header = [0; 16];
        file.read_exact(&mut header[..8])?;
        let kind: Kind = [header[4], header[5], header[6], header[7]];
        let short = u64::from(u32::from_be_bytes([header[0], header[1], header[2], header[3]]));
        let (head, size) = match short {
            0 => (8, len - at),
            1 => {
                if at + 16 > len {
                    break;
                }
                file.read_exact(&mut header[8..])?;
                let mut long = [0; 8];
                long.copy_from_slice(&header[8..]);
                (16, u64::from_be_bytes(long))
            }
            size => (8, size),
        };
        if size < head {
            return Err(Mp4Error::Bad(format!("box {:?} at byte {at} says that it is {size} bytes long", name(kind))));
        }
        let end = at.checked_add(size).filter(|&end| end <= len);
        if kind == *b"moov" {
            let Some(end) = end else {
                return Err(Mp4Error::Truncated(format!(
                    "its index (moov box) needs {} bytes more than the file has",
                    size - (len - at)
                )));
            };
            let body = end - at - head;
            if body > MAX_INDEX_BYTES {
                return Err(Mp4Error::Bad(format!("its index (moov box) is {} MiB long", body >> 20)));
            }
            let mut bytes = vec![0; body as usize];
            file.read_exact(&mut bytes)?;
            return Ok(bytes);
        }
        fragments |= kind == *b"moof";
        match end {
            Some(end) => at = end,
            None => {
                cut = Some((kind, size - (len - at)));
                break;
            }
        }
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
pub fn children(body: &[u8]) -> impl Iterator<Item = (Kind, &[u8])> {
    let mut rest = body;
    std::iter::from_fn(move || {
        let header = rest.first_chunk::<8>()?;
        let kind = [header[4], header[5], header[6], header[7]];
        let short = u32::from_be_bytes([header[0], header[1], header[2], header[3]]) as usize;
        let (head, size) = match short {
            0 => (8, rest.len()),
            1 => (16, usize::try_from(u64::from_be_bytes(*rest.get(8..)?.first_chunk()?)).ok()?),
            size => (8, size),
        };
        let inside = rest.get(head..size)?;
        rest = &rest[size..];
        Some((kind, inside))
    })
}

/// The first box of a kind inside of a body.
pub fn child<'a>(body: &'a [u8], kind: &Kind) -> Option<Body<'a>> {
    children(body).find(|(k, _)| k == kind).map(|(kind, bytes)| Body { kind, bytes })
}

/// What is inside of a box, read from the front.
#[derive(Debug, Clone, Copy)]
pub struct Body<'a> {
    kind: Kind,
    /// What is left.
    pub bytes: &'a [u8],
}

impl<'a> Body<'a> {
    pub fn take(&mut self, n: usize) -> Result<&'a [u8], Mp4Error> {
        let (head, tail) = self
            .bytes
            .split_at_checked(n)
            .ok_or_else(|| Mp4Error::Bad(format!("box {:?} is too short", name(self.kind))))?;
        self.bytes = tail;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Mp4Error> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }

    pub fn u8(&mut self) -> Result<u8, Mp4Error> {
        Ok(self.array::<1>()?[0])
    }

    pub fn u16(&mut self) -> Result<u16, Mp4Error> {
        Ok(u16::from_be_bytes(self.array()?))
    }

    pub fn u32(&mut self) -> Result<u32, Mp4Error> {
        Ok(u32::from_be_bytes(self.array()?))
    }

    pub fn i32(&mut self) -> Result<i32, Mp4Error> {
        Ok(i32::from_be_bytes(self.array()?))
    }

    pub fn u64(&mut self) -> Result<u64, Mp4Error> {
        Ok(u64::from_be_bytes(self.array()?))
    }

    /// The version of a full box; skips its flags.
    pub fn version(&mut self) -> Result<u8, Mp4Error> {
        Ok(self.array::<4>()?[0])
    }

    /// A count of entries of `size` bytes each that are all there.
    pub fn count(&mut self, size: usize) -> Result<usize, Mp4Error> {
        let count = self.u32()? as usize;
        if count.checked_mul(size).is_none_or(|bytes| bytes > self.bytes.len()) {
            return Err(Mp4Error::Bad(format!(
                "box {:?} says that it has {count} entries but has room for {}",
                name(self.kind),
                self.bytes.len() / size
            )));
        }
        Ok(count)
    }
}

/// A child that must be there.
pub fn required<'a>(body: &'a [u8], kind: &Kind, inside: &str) -> Result<Body<'a>, Mp4Error> {
    child(body, kind).ok_or_else(|| Mp4Error::Bad(format!("box {:?} is missing from {inside}", name(*kind))))
}
