//! A folder with the three files to a model.

use super::binary::{self, Fault};
use super::error::ReadColmapError;
use super::model::{ColmapModel, Tables};
use super::text;
use crate::file::load;
use std::path::Path;

/// Reads `cameras`, `images` and `points3D` of a folder: the binary files where they are, else the text.
/// Poses are camera to world and lenses pinholes, in our conventions; what points were seen by which
/// image is not read.
///
/// # Errors
///
/// [`ReadColmapError`], which names the file and the line or byte at fault.
pub fn read(folder: &Path) -> Result<ColmapModel, ReadColmapError> {
    let is_binary = folder.join("cameras.bin").exists();
    let tables = if is_binary {
        Tables {
            cameras: parse(&folder.join("cameras.bin"), binary::read_cameras)?,
            images: parse(&folder.join("images.bin"), binary::read_images)?,
            points: parse(&folder.join("points3D.bin"), binary::read_points)?,
        }
    } else {
        Tables {
            cameras: parse(&folder.join("cameras.txt"), utf8(text::read_cameras))?,
            images: parse(&folder.join("images.txt"), utf8(text::read_images))?,
            points: parse(&folder.join("points3D.txt"), utf8(text::read_points))?,
        }
    };
    tables.into_model().map_err(|reason| ReadColmapError::Inconsistent {
        path: folder.to_path_buf(),
        reason,
    })
}

fn utf8<T>(parse: impl Fn(&str) -> Result<T, Fault>) -> impl Fn(&[u8]) -> Result<T, Fault> {
    move |bytes| {
        let text = std::str::from_utf8(bytes).map_err(|e| Fault::Damaged {
            place: format!("byte {}", e.valid_up_to()),
            reason: "it is not UTF-8".into(),
        })?;
        parse(text)
    }
}

pub(super) fn parse<T>(path: &Path, parse: impl Fn(&[u8]) -> Result<T, Fault>) -> Result<T, ReadColmapError> {
    let path = path.to_path_buf();
    let bytes = match load(&path) {
        Ok(bytes) => bytes,
        Err(source) => return Err(ReadColmapError::Io { path, source }),
    };
    parse(&bytes).map_err(|fault| match fault {
        Fault::Damaged { place, reason } => ReadColmapError::Damaged { path, place, reason },
        Fault::Unsupported(what) => ReadColmapError::Unsupported { path, what },
    })
}
