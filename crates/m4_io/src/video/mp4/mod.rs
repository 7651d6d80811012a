//! MP4 and QuickTime files: the bytes of each frame, its presentation time, and the orientation.
//!
//! Only what a reader of clips needs (ISO/IEC 14496-12, -15). Every count is checked against the
//! bytes that are there before anything is allocated, so that no file can make the reader panic or
//! take more memory than a small multiple of its index.

mod boxes;
mod edits;
mod movie;
mod samples;

pub use boxes::looks_like_mp4;
pub use edits::Timeline;
pub use movie::{Movie, SampleEntry, Track};
pub use samples::Sample;

use std::io;

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
        _ => format!("a track of type {:?}", boxes::name(handler)),
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
        _ => format!("coded as {:?}", boxes::name(entry)),
    }
}
