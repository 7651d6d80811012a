//! Calls the reader of each format.

use super::{ImportError, ImportFormat};
use crate::export::Format;
use m4_io::scene::ply::frame_name;
use m4_io::scene::{Imported, fourdgs, ply};
use std::path::Path;

/// The scene in a file.
pub(super) fn read(format: Format, path: &Path) -> Result<Imported, ImportError> {
    read_back(format, path, 0).unwrap_or_else(|| {
        Err(ImportError::WriteOnly {
            name: format.name(),
            known: ImportFormat::names(),
        })
    })
}

/// The scene in what was exported; of a sequence that of file `moment`. `None` for formats that are not read.
pub(crate) fn read_back(format: Format, path: &Path, moment: usize) -> Option<Result<Imported, ImportError>> {
    Some(match format {
        Format::Fourdgs => fourdgs::read(path).map_err(ImportError::from),
        Format::Ply => ply::read(path).map_err(ImportError::from),
        Format::PlySequence => ply::read(&path.join(frame_name(moment))).map_err(ImportError::from),
        Format::Splatv | Format::Spz | Format::Gltf | Format::Colmap | Format::Nerfstudio | Format::Mp4 => return None,
    })
}
