//! Reads a folder with the three files as a model.

use super::binary::{self, Fault};
use super::error::ReadColmapError;
use super::model::{ColmapModel, ColmapTables, ModelFault, Tables};
use super::text;
use crate::scene::file::load;
use std::path::Path;

/// Reads `cameras`, `images` and `points3D` of a folder: the binary files where they are, else the text.
/// Poses are camera to world and lenses pinholes, in our conventions; what points were seen by which
/// image is not read.
///
/// # Errors
///
/// [`ReadColmapError`], which names the file and the line or byte at fault.
pub fn read(folder: &Path) -> Result<ColmapModel, ReadColmapError> {
    let ColmapTables { cameras, images } = read_tables(folder)?;
    let points = if is_binary(folder) {
        parse(&folder.join("points3D.bin"), binary::read_points)?
    } else {
        parse(&folder.join("points3D.txt"), utf8(text::read_points))?
    };
    let tables = Tables {
        cameras,
        images,
        points,
    };
    let file = || {
        folder.join(if is_binary(folder) {
            "cameras.bin"
        } else {
            "cameras.txt"
        })
    };
    tables.into_model().map_err(|fault| match fault {
        ModelFault::Camera(id, reason) => ReadColmapError::Damaged {
            path: file(),
            place: format!("camera {id}"),
            reason,
        },
        ModelFault::Unsupported(what) => ReadColmapError::Unsupported { path: file(), what },
        ModelFault::Inconsistent(reason) => ReadColmapError::Inconsistent {
            path: folder.to_path_buf(),
            reason,
        },
    })
}

/// Reads `cameras` and `images` of a folder as they are, lenses of every model: the binary files where they are, else the text.
///
/// # Errors
///
/// [`ReadColmapError`], which names the file and the line or byte at fault.
pub fn read_tables(folder: &Path) -> Result<ColmapTables, ReadColmapError> {
    Ok(if is_binary(folder) {
        ColmapTables {
            cameras: parse(&folder.join("cameras.bin"), binary::read_cameras)?,
            images: parse(&folder.join("images.bin"), binary::read_images)?,
        }
    } else {
        ColmapTables {
            cameras: parse(&folder.join("cameras.txt"), utf8(text::read_cameras))?,
            images: parse(&folder.join("images.txt"), utf8(text::read_images))?,
        }
    })
}

fn is_binary(folder: &Path) -> bool {
    folder.join("cameras.bin").exists()
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
