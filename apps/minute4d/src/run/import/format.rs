//! The import formats: splats as a scene, clips with poses as a capture.

use m4_io::dataset::{SourceFormat, megasam};
use m4_io::scene::ply::frame_name;
use minute4d::Refusal;
use minute4d::export::Format;
use std::path::Path;
use std::str::FromStr;

const SCENES: [Format; 2] = [Format::Fourdgs, Format::Ply];

/// A format of a file or folder to import.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImportFormat {
    /// Splats.
    Scene(Format),
    /// A clip that another tool posed.
    Source(SourceFormat),
}

impl ImportFormat {
    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scene(format) => format.name(),
            Self::Source(format) => format.name(),
        }
    }

    /// Everything that can be imported, the names in one line.
    pub fn names() -> String {
        let scenes = SCENES.into_iter().map(Format::name);
        let all: Vec<&str> = scenes
            .chain(SourceFormat::all().map(SourceFormat::name))
            .collect();
        all.join(", ")
    }

    /// The format of what is at `path`: the one asked for, or the one that its name and first bytes
    /// say.
    ///
    /// # Errors
    ///
    /// A refusal where nothing says it, or it cannot be imported.
    pub fn of(path: &Path, asked: Option<Self>) -> Result<Self, Refusal> {
        if let Some(asked) = asked {
            return Ok(asked);
        }
        if let Some(source) = m4_io::dataset::detect(path) {
            return Ok(Self::Source(source));
        }
        // by its name alone: its reader says what is wrong with it
        if megasam::detect_name(path) {
            return Ok(Self::Source(SourceFormat::Megasam));
        }
        if path.is_dir() {
            if m4_io::dataset::davis::detect(path) {
                return Err(Refusal::bad_input(format!(
                    "{} is a DAVIS clip, which has no camera poses; estimate them with `minute4d run IMAGES --masks ANNOTATIONS -o \
                     OUT`, with the folders of one clip",
                    path.display()
                )));
            }
            let first = path.join(frame_name(0));
            let (path, names) = (path.display(), Self::names());
            return Err(Refusal::bad_input(if first.is_file() {
                format!(
                    "{path} is a folder: a sequence cannot be imported as a clip, since the correspondence of splats between files is \
                     unknown; give one of its files, such as {}",
                    first.display()
                )
            } else {
                format!(
                    "{path} is a folder with none of the known layouts; if it has one, select it with --format, one of {names}"
                )
            }));
        }
        let format = Format::of_path(path).ok_or_else(|| {
            let (path, names) = (path.display(), Self::names());
            Refusal::usage(format!(
                "the format of {path} is not recognised by its name; add --format, one of {names}"
            ))
        })?;
        if SCENES.contains(&format) {
            Ok(Self::Scene(format))
        } else {
            Err(write_only(format))
        }
    }
}

/// The refusal of a format that is written only.
pub(super) fn write_only(format: Format) -> Refusal {
    let (name, names) = (format.name(), ImportFormat::names());
    Refusal::usage(format!("{name} files cannot be imported; {names} can"))
}

impl FromStr for ImportFormat {
    type Err = Refusal;

    fn from_str(text: &str) -> Result<Self, Refusal> {
        if let Some(format) = SCENES.into_iter().find(|f| f.name() == text) {
            return Ok(Self::Scene(format));
        }
        if let Some(source) = SourceFormat::all().find(|f| f.name() == text) {
            return Ok(Self::Source(source));
        }
        let written = Format::all().find(|f| f.name() == text);
        Err(written.map_or_else(
            || {
                let names = Self::names();
                Refusal::usage(format!(
                    "no format is called {text}; these can be imported: {names}"
                ))
            },
            write_only,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::ImportFormat;
    use m4_io::dataset::SourceFormat;
    use minute4d::export::Format;

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
        assert!(all.len() == count && count > 8, "{names}");
        let colmap: ImportFormat = "colmap".parse().unwrap();
        assert_eq!(colmap, ImportFormat::Source(SourceFormat::Colmap));
        let ply: ImportFormat = "ply".parse().unwrap();
        assert_eq!(ply, ImportFormat::Scene(Format::Ply));
        assert!(
            "spz"
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
