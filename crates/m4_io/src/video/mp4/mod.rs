//! MP4 and QuickTime files: the bytes of each frame, its presentation time, and the orientation.
//!
//! Only what a reader of clips needs (ISO/IEC 14496-12, -15). Every count is checked against the
//! bytes that are there before anything is allocated, so that no file can make the reader panic or
//! take more memory than a small multiple of its index.

mod movie;

pub use movie::{Movie, Sample, SampleEntry, Track};

use m4_core::{Plane, RgbImage};
use std::io::{self, Read, Seek, SeekFrom};

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
pub fn kind_name(handler: [u8; 4]) -> String {
    match &handler {
        b"soun" => "sound".to_owned(),
        b"text" | b"sbtl" | b"subt" => "subtitles".to_owned(),
        b"meta" | b"tmcd" => "metadata".to_owned(),
        _ => format!("a track of type {:?}", name(handler)),
    }
}

/// The codec of a sample entry, for messages.
pub fn codec_name(entry: [u8; 4]) -> String {
    match &entry {
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

/// Where the stored image's columns and rows go on the display.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Orientation {
    /// Stored columns become displayed rows.
    transpose: bool,
    /// Displayed columns run against the stored axis they come from.
    flip_x: bool,
    /// Displayed rows run against the stored axis they come from.
    flip_y: bool,
}

impl Orientation {
    /// From the display matrix of a track (`x' = a x + c y`, `y' = b x + d y`, y down); `None` if not one of the eight up to scale.
    pub fn from_matrix([a, b, _, c, d, _, _, _, _]: [i32; 9]) -> Option<Self> {
        // Rounding of turned matrices leaves a few units where 0 is meant (65536 = 1).
        let small = |v: i32| v.unsigned_abs() < 1024;
        if small(b) && small(c) && !small(a) && !small(d) {
            Some(Self { transpose: false, flip_x: a < 0, flip_y: d < 0 })
        } else if small(a) && small(d) && !small(b) && !small(c) {
            // x' follows y with the sign of c, y' follows x with the sign of b.
            Some(Self { transpose: true, flip_x: c < 0, flip_y: b < 0 })
        } else {
            None
        }
    }

    /// True when width and height change places.
    pub fn swaps_sides(self) -> bool {
        self.transpose
    }

    /// The image as it is displayed.
    pub fn apply(self, image: RgbImage) -> RgbImage {
        if self == (Self { transpose: false, flip_x: false, flip_y: false }) {
            return image;
        }
        let (w, h) = image.size();
        let (width, height) = if self.transpose { (h, w) } else { (w, h) };
        Plane::from_fn(width, height, |x, y| {
            let x = if self.flip_x { width - 1 - x } else { x };
            let y = if self.flip_y { height - 1 - y } else { y };
            image[if self.transpose { (y, x) } else { (x, y) }]
        })
    }
}

/// One entry of an edit list.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edit {
    /// Ticks of the movie; 0 = to the end of the track.
    pub duration: u64,
    /// Ticks of the track where the part starts; -1 = nothing is shown.
    pub media_time: i64,
    /// Speed, 1 = as filmed.
    pub rate: f64,
}

/// Maps ticks of a track to seconds of the presentation.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    parts: Vec<Part>,
    ticks_per_s: f64,
}

/// A stretch of the track that is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Part {
    /// Ticks of the track.
    from: f64,
    /// Ticks of the track, not included.
    to: f64,
    /// Seconds.
    shown_at: f64,
    rate: f64,
}

impl Timeline {
    /// `movie_scale` and `track_scale` are ticks per second, above 0.
    pub fn new(edits: &[Edit], movie_scale: u32, track_scale: u32) -> Self {
        let (movie, track) = (f64::from(movie_scale.max(1)), f64::from(track_scale.max(1)));
        let mut parts = Vec::new();
        let mut shown_at = 0.0;
        for edit in edits {
            let length_s = edit.duration as f64 / movie;
            if edit.media_time >= 0 && edit.rate > 0.0 {
                let from = edit.media_time as f64;
                // The duration was rounded to ticks of the movie: a frame that starts within one of
                // the end belongs to what was cut away.
                let to = from + (length_s - 1.0 / movie) * track * edit.rate;
                let to = if edit.duration == 0 { f64::INFINITY } else { to.max(from + 1.0) };
                parts.push(Part { from, to, shown_at, rate: edit.rate });
            }
            shown_at += length_s;
        }
        if parts.is_empty() {
            parts.push(Part { from: f64::NEG_INFINITY, to: f64::INFINITY, shown_at: 0.0, rate: 1.0 });
        }
        Self { parts, ticks_per_s: track }
    }

    /// Seconds at which the frame of composition time `ticks` is shown; `None` when cut away. Only differences count.
    pub fn shown_s(&self, ticks: i64) -> Option<f64> {
        let ticks = ticks as f64;
        let part = self.parts.iter().find(|p| ticks >= p.from && ticks < p.to)?;
        let origin = if part.from.is_finite() { part.from } else { 0.0 };
        Some(part.shown_at + (ticks - origin) / self.ticks_per_s / part.rate)
    }
}

#[cfg(test)]
mod tests {
    use super::{Edit, Orientation, Timeline};

    #[test]
    fn other_display_matrices_have_no_orientation() {
        assert_eq!(Orientation::from_matrix([46341, 46341, 0, -46341, 46341, 0, 0, 0, 1 << 30]), None);
        assert_eq!(Orientation::from_matrix([0; 9]), None);
    }

    fn edit(duration: u64, media_time: i64, rate: f64) -> Edit {
        Edit { duration, media_time, rate }
    }

    #[test]
    fn edit_list_delays_and_cuts_shift_frames() {
        let timeline = Timeline::new(&[edit(500, -1, 1.0), edit(1000, 24_000, 1.0)], 1000, 12_000);
        assert_eq!(timeline.shown_s(23_500), None);
        assert_eq!(timeline.shown_s(24_000), Some(0.5));
        assert_eq!(timeline.shown_s(35_500), Some(0.5 + 11.5 / 12.0));
        assert_eq!(timeline.shown_s(36_000), None);
    }

    #[test]
    fn slow_motion_stretches_a_part() {
        let timeline = Timeline::new(&[edit(600, 0, 1.0), edit(600, 600, 0.25)], 600, 600);
        assert_eq!(timeline.shown_s(300), Some(0.5));
        assert_eq!(timeline.shown_s(660), Some(1.0 + 60.0 / 600.0 * 4.0));
    }

    #[test]
    fn clips_without_edit_lists_keep_all_frames() {
        let timeline = Timeline::new(&[], 600, 600);
        assert_eq!(timeline.shown_s(-300), Some(-0.5));
        let open = Timeline::new(&[edit(0, 1024, 1.0)], 600, 12_288);
        assert_eq!(open.shown_s(1024), Some(0.0));
        assert_eq!(open.shown_s(1 << 40).map(f64::is_finite), Some(true));
    }
}
