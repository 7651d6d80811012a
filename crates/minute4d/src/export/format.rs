//! The export formats.

use crate::Refusal;
use serde::Serialize;
use std::path::Path;
use std::str::FromStr;

/// A format that other tools read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Format {
    /// `.4dgs`: splats with time.
    #[serde(rename = "4dgs")]
    Fourdgs,
    /// One PLY file of 3DGS.
    Ply,
    /// A folder with one PLY file a frame.
    PlySequence,
    /// `.splatv`: splats with time, of the splaTV player.
    Splatv,
    /// SPZ, one instant.
    Spz,
    /// Binary glTF with `KHR_gaussian_splatting`, one instant.
    Gltf,
    /// Of a capture: a COLMAP model with images, masks and points of static regions.
    Colmap,
    /// Of a capture: a folder of nerfstudio with images, masks, depth and points.
    Nerfstudio,
    /// A video along the cameras of the source.
    Mp4,
}

/// What a format does with time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Time {
    /// It holds all of it.
    Clip,
    /// It holds one instant.
    Instant,
    /// It holds one instant a frame.
    Sequence,
    /// It holds images.
    Video,
    /// It holds a capture, no splats.
    Capture,
}

/// A row of the table: format, name, usual name of the file, time.
type Entry = (Format, &'static str, &'static str, Time);

const FORMATS: &[Entry] = &[
    (Format::Fourdgs, "4dgs", "scene.4dgs", Time::Clip),
    (Format::Ply, "ply", "scene.ply", Time::Instant),
    (Format::PlySequence, "ply-sequence", "ply", Time::Sequence),
    (Format::Splatv, "splatv", "scene.splatv", Time::Clip),
    (Format::Spz, "spz", "scene.spz", Time::Instant),
    (Format::Gltf, "gltf", "scene.glb", Time::Instant),
    (Format::Colmap, "colmap", "colmap", Time::Capture),
    (Format::Nerfstudio, "nerfstudio", "nerfstudio", Time::Capture),
    (Format::Mp4, "mp4", "scene.mp4", Time::Video),
];

impl Format {
    /// Every format.
    pub fn all() -> impl Iterator<Item = Self> {
        FORMATS.iter().map(|entry| entry.0)
    }

    fn entry(self) -> &'static Entry {
        // Every variant has a row: see the test.
        FORMATS.iter().find(|entry| entry.0 == self).unwrap_or(&FORMATS[0])
    }

    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.entry().1
    }

    /// The usual name of its file or folder.
    #[must_use]
    pub fn file_name(self) -> &'static str {
        self.entry().2
    }

    /// Whether it holds captures.
    #[must_use]
    pub fn takes_capture(self) -> bool {
        self.time() == Time::Capture
    }

    /// What it does with time.
    #[must_use]
    pub fn time(self) -> Time {
        self.entry().3
    }

    /// The names of all formats.
    #[must_use]
    pub fn names() -> String {
        let names: Vec<&str> = FORMATS.iter().map(|entry| entry.1).collect();
        names.join(", ")
    }

    /// The format that the ending of a file name stands for.
    #[must_use]
    pub fn of_path(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        let same = |entry: &&Entry| Path::new(entry.2).extension().is_some_and(|e| e == ending.as_str());
        FORMATS.iter().find(same).map(|entry| entry.0)
    }
}

impl FromStr for Format {
    type Err = Refusal;

    fn from_str(text: &str) -> Result<Self, Refusal> {
        let found = FORMATS.iter().find(|entry| entry.1 == text);
        found.map(|entry| entry.0).ok_or_else(|| {
            let names = Self::names();
            Refusal::usage(format!("{text:?} is not a format; choose one of {names}"))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{FORMATS, Format};
    use std::path::Path;

    #[test]
    fn every_format_has_a_row_of_its_own() {
        for format in Format::all() {
            assert_eq!(format.entry().0, format);
            assert_eq!(format.name().parse::<Format>().unwrap(), format);
            assert_eq!(FORMATS.iter().filter(|e| e.1 == format.name()).count(), 1);
            let json = serde_json::to_value(format).unwrap();
            assert_eq!(json, format.name());
        }
        assert!("obj".parse::<Format>().unwrap_err().to_string().contains("4dgs, ply,"));
    }

    #[test]
    fn endings_name_formats() {
        assert_eq!(Format::of_path(Path::new("a/b.4DGS")), Some(Format::Fourdgs));
        assert_eq!(Format::of_path(Path::new("b.ply")), Some(Format::Ply));
        assert_eq!(Format::of_path(Path::new("ply")), None);
        assert_eq!(Format::of_path(Path::new("dog_droid.npz")), None);
    }
}
