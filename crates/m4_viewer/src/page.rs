//! Writes and reads a page with a scene in it.
//!
//! The page as it is built ([`TEMPLATE`]) has one marker. In its place go
//!
//! ```html
//! <img id="m4-poster" alt="" style="--aspect:1.333333" src="data:image/jpeg;base64,..">
//! <script type="application/json" id="m4-manifest">{..}</script>
//! <script type="text/plain" id="m4-splats">BASE64 of gzip of the payload</script>
//! <script type="text/plain" id="m4-frames">BASE64 of the clip of the source</script>
//! ```
//!
//! the poster, which is the first of the frames and is seen while the rest is still being read, the
//! splats and the frames only where there are some. Every `<` in the JSON is written `\u003c`: in a
//! script `</script` ends the element, and behind `<!--` and `<script` it does not end where it
//! should (HTML, 13.2.5.15 to 31). Base64 has none.

use crate::frames::Frames;
use crate::manifest::Manifest;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
pub use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use std::io::{Read, Write};

/// The page without a scene, as `crates/m4_viewer/page` builds it.
pub const TEMPLATE: &str = include_str!("../page.html");
/// Placeholder of the scene.
pub const MARKER: &str = "<!--minute4d-data-->";

const MANIFEST: (&str, &str) = ("application/json", "m4-manifest");
const SPLATS: (&str, &str) = ("text/plain", "m4-splats");
const FRAMES: (&str, &str) = ("text/plain", "m4-frames");
const END: &str = "</script>";
/// Text before the bytes of the poster.
const POSTER: &str = "src=\"data:image/jpeg;base64,";

/// Why a page cannot be made or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageError {
    /// The template has no single marker.
    #[error(
        "the page has {0} places for a scene where it must have one; build crates/m4_viewer/page again"
    )]
    Marker(usize),
    /// The manifest cannot be written or read as JSON.
    #[error("the manifest of the page is invalid: {0}")]
    Manifest(#[from] serde_json::Error),
    /// Compression, in memory.
    #[error("the splats cannot be packed or unpacked: {0}")]
    Gzip(#[from] std::io::Error),
    /// An element that is missing.
    #[error("the page has no element {0}; it was not written by minute4d, or only in part")]
    Missing(&'static str),
    /// An element in which a browser would look for the end of a comment.
    #[error(
        "the element {0} of the page holds <!--, behind which browsers do not find its end; write the page again from its scene"
    )]
    Comment(&'static str),
    /// Offsets that do not fit the frames.
    #[error(
        "the offsets of the frames do not divide the {0} bytes of the frames; the page is damaged"
    )]
    Offsets(usize),
    /// An element that is not base64.
    #[error("the element {id} of the page is damaged: {source}")]
    Base64 {
        /// The name of the element.
        id: &'static str,
        /// The fault.
        source: base64::DecodeError,
    },
}

/// Contents of a page.
#[derive(Debug, Clone, Copy)]
pub struct Parts<'a> {
    /// Its metadata.
    pub manifest: &'a Manifest,
    /// The payload before gzip; `None` for a page that waits for the first scene of a server.
    pub payload: Option<&'a [u8]>,
    /// The frames that the manifest describes.
    pub frames: Option<&'a Frames>,
}

/// The page as bytes of HTML; quick compression is for a page that goes no further than this
/// machine.
pub fn compose(
    template: &str,
    parts: &Parts<'_>,
    compression: Compression,
) -> Result<Vec<u8>, PageError> {
    let count = template.matches(MARKER).count();
    let Some((before, after)) = template.split_once(MARKER).filter(|_| count == 1) else {
        return Err(PageError::Marker(count));
    };
    // In JSON it is nowhere but in strings.
    let json = serde_json::to_string(parts.manifest)?.replace('<', "\\u003c");
    let mut out = before.as_bytes().to_vec();
    if let Some(frames) = parts.frames {
        out.extend_from_slice(poster(frames).as_bytes());
    }
    element(&mut out, MANIFEST, &json);
    if let Some(payload) = parts.payload {
        let mut gzip = GzEncoder::new(Vec::with_capacity(payload.len()), compression);
        gzip.write_all(payload)?;
        element(&mut out, SPLATS, &STANDARD.encode(gzip.finish()?));
    }
    if let Some(frames) = parts.frames {
        element(&mut out, FRAMES, &STANDARD.encode(&frames.bytes));
    }
    out.extend_from_slice(after.as_bytes());
    Ok(out)
}

/// The element of the first frame.
fn poster(frames: &Frames) -> String {
    let index = &frames.index;
    let aspect = index.width as f64 / index.height.max(1) as f64;
    format!(
        "<img id=\"m4-poster\" alt=\"\" style=\"--aspect:{aspect:.6}\" {POSTER}{}\">",
        STANDARD.encode(&frames.poster)
    )
}

/// The bytes of that element, where it is there.
fn poster_of(html: &str) -> Result<Option<Vec<u8>>, PageError> {
    let rest = html.split_once("<img id=\"m4-poster\" ").map(|(_, r)| r);
    let text = rest
        .and_then(|rest| rest.split_once('>'))
        .and_then(|(element, _)| element.split_once(POSTER))
        .and_then(|(_, text)| text.strip_suffix('"'));
    text.map(|text| bytes("m4-poster", text)).transpose()
}

fn opening((kind, id): (&str, &str)) -> String {
    format!("<script type=\"{kind}\" id=\"{id}\">")
}

fn element(out: &mut Vec<u8>, name: (&str, &str), text: &str) {
    out.extend_from_slice(opening(name).as_bytes());
    out.extend_from_slice(text.as_bytes());
    out.extend_from_slice(END.as_bytes());
}

/// Contents read back from a page.
#[derive(Debug, Clone, PartialEq)]
pub struct Contents {
    /// Its metadata.
    pub manifest: Manifest,
    /// The payload without gzip, for [`crate::payload::decode`]; `None` where there is none.
    pub payload: Option<Vec<u8>>,
    /// The frames, where there are some.
    pub frames: Option<Frames>,
}

/// Most bytes that the splats of a page may unpack to: a hundred million splats.
const MOST_BYTES: u64 = 4 << 30;

/// Takes a page apart.
pub fn read(html: &str) -> Result<Contents, PageError> {
    let manifest = manifest_of(html)?;
    let payload = match find(html, SPLATS)? {
        Some(text) => {
            let mut payload = Vec::new();
            let gzip = bytes(SPLATS.1, text)?;
            GzDecoder::new(gzip.as_slice())
                .take(MOST_BYTES)
                .read_to_end(&mut payload)?;
            Some(payload)
        }
        None => None,
    };
    let frames = frames_of(html, &manifest)?;
    Ok(Contents {
        manifest,
        payload,
        frames,
    })
}

/// The frames of a page, without its splats.
pub fn read_frames(html: &str) -> Result<Option<Frames>, PageError> {
    frames_of(html, &manifest_of(html)?)
}

fn manifest_of(html: &str) -> Result<Manifest, PageError> {
    let text = find(html, MANIFEST)?.ok_or(PageError::Missing(MANIFEST.1))?;
    Ok(serde_json::from_str(text)?)
}

fn frames_of(html: &str, manifest: &Manifest) -> Result<Option<Frames>, PageError> {
    let Some(index) = manifest.frames.clone() else {
        return Ok(None);
    };
    let text = find(html, FRAMES)?.ok_or(PageError::Missing(FRAMES.1))?;
    let bytes = bytes(FRAMES.1, text)?;
    let ordered = index.offsets.windows(2).all(|w| w[0] <= w[1]);
    if !ordered || index.offsets.last() != Some(&bytes.len()) {
        return Err(PageError::Offsets(bytes.len()));
    }
    let poster = poster_of(html)?.ok_or(PageError::Missing("m4-poster"))?;
    Ok(Some(Frames {
        index,
        bytes,
        poster,
    }))
}

/// The text of an element, as a browser finds it.
fn find<'a>(html: &'a str, name: (&str, &'static str)) -> Result<Option<&'a str>, PageError> {
    let rest = html
        .split_once(opening(name).as_str())
        .map(|(_, rest)| rest);
    let text = rest
        .and_then(|rest| rest.split_once(END))
        .map(|(text, _)| text);
    if text.is_some_and(|text| text.contains("<!--")) {
        return Err(PageError::Comment(name.1));
    }
    Ok(text)
}

fn bytes(id: &'static str, text: &str) -> Result<Vec<u8>, PageError> {
    STANDARD
        .decode(text)
        .map_err(|source| PageError::Base64 { id, source })
}
