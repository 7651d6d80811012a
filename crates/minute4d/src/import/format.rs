//! What can be imported: splats as a scene, posed clips as a capture.

use super::ImportError;
use crate::export::Format;
use m4_formats::ply::frame_name;
use m4_import::SourceFormat;
use m4_io::megasam;
use serde::{Serialize, Serializer};
use std::path::Path;
use std::str::FromStr;

/// Scenes that can be imported.
const SCENES: [Format; 5] = [Format::Fourdgs, Format::Ply, Format::Splatv, Format::Spz, Format::Gltf];

/// A format of a file or folder to import.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImportFormat {
    /// Splats, or one of the layouts of MegaSaM, which are written, too.
    Known(Format),
    /// A clip that another tool posed.
    Source(SourceFormat),
}

impl ImportFormat {
    /// As on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Known(format) => format.name(),
            Self::Source(format) => format.name(),
        }
    }

    /// Everything that can be imported, the names in one line.
    #[must_use]
    pub fn names() -> String {
        let layouts = Format::all().filter(|f| f.layout().is_some());
        let known = SCENES.into_iter().chain(layouts).map(Format::name);
        let sources = SourceFormat::all().filter(|&f| f != SourceFormat::Megasam);
        let all: Vec<&str> = known.chain(sources.map(SourceFormat::name)).collect();
        all.join(", ")
    }

    /// The format of what is at `path`: the one asked for, or the one that its name and first bytes say.
    ///
    /// # Errors
    ///
    /// [`ImportError`] where nothing says it, or it cannot be imported.
    pub fn of(path: &Path, asked: Option<Self>) -> Result<Self, ImportError> {
        if let Some(asked) = asked {
            return Ok(asked);
        }
        match m4_import::detect(path) {
            // its layouts have names of their own
            Some(SourceFormat::Megasam) => {}
            Some(source) => return Ok(Self::Source(source)),
            None => {}
        }
        if let Some(layout) = megasam::detect(path).filter(|_| path.is_dir()) {
            return Ok(Self::Known(Format::of_layout(layout)));
        }
        if path.is_dir() {
            if m4_import::formats::davis::detect(path) {
                return Err(ImportError::NoPoses {
                    path: path.to_path_buf(),
                });
            }
            let first = path.join(frame_name(0));
            return Err(if first.is_file() {
                ImportError::Sequence {
                    path: path.to_path_buf(),
                    first,
                }
            } else {
                ImportError::Folder {
                    path: path.to_path_buf(),
                    known: Self::names(),
                }
            });
        }
        let format = Format::of_path(path).ok_or_else(|| ImportError::Unknown {
            path: path.to_path_buf(),
            known: Self::names(),
        })?;
        if SCENES.contains(&format) || format.layout().is_some() {
            Ok(Self::Known(format))
        } else {
            Err(ImportError::WriteOnly {
                name: format.name(),
                known: Self::names(),
            })
        }
    }
}

impl FromStr for ImportFormat {
    type Err = ImportError;

    fn from_str(text: &str) -> Result<Self, ImportError> {
        let scene = SCENES.into_iter().find(|f| f.name() == text);
        let layout = || Format::all().find(|f| f.layout().is_some() && f.name() == text);
        if let Some(format) = scene.or_else(layout) {
            return Ok(Self::Known(format));
        }
        if let Some(source) = SourceFormat::all().find(|f| f.name() == text) {
            return Ok(Self::Source(source));
        }
        let written = Format::all().find(|f| f.name() == text);
        Err(match written {
            Some(format) => ImportError::WriteOnly {
                name: format.name(),
                known: Self::names(),
            },
            None => ImportError::NoSuchFormat {
                given: text.to_owned(),
                known: Self::names(),
            },
        })
    }
}

impl Serialize for ImportFormat {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::ImportFormat;
    use crate::export::Format;
    use m4_import::SourceFormat;

    #[test]
    fn every_name_is_of_one_format() {
        let names = ImportFormat::names();
        let mut all: Vec<&str> = names.split(", ").collect();
        for name in &all {
            assert_eq!(name.parse::<ImportFormat>().unwrap().name(), *name);
        }
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert!(all.len() == count && count > 15, "{names}");
        let colmap: ImportFormat = "colmap".parse().unwrap();
        assert_eq!(colmap, ImportFormat::Source(SourceFormat::Colmap));
        assert_eq!(
            "megasam".parse::<ImportFormat>().unwrap(),
            ImportFormat::Known(Format::Megasam)
        );
        assert!(
            "usd"
                .parse::<ImportFormat>()
                .unwrap_err()
                .to_string()
                .contains("cannot be imported")
        );
        assert!(
            "obj"
                .parse::<ImportFormat>()
                .unwrap_err()
                .to_string()
                .contains("colmap")
        );
    }
}
