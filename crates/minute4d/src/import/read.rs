//! One arm a format.

use super::ImportError;
use crate::export::Format;
use m4_formats::ply::frame_name;
use m4_formats::{Imported, fourdgs, gltf, ply, splatv, spz, usd};
use m4_io::megasam;
use m4_scene::{Scene, Splats};
use std::path::Path;

/// Formats that can be imported.
const READ: [Format; 8] = [
    Format::Fourdgs,
    Format::Ply,
    Format::Splatv,
    Format::Spz,
    Format::Gltf,
    Format::Megasam,
    Format::MegasamCvd,
    Format::MegasamReconstruction,
];

fn known() -> String {
    READ.map(Format::name).join(", ")
}

/// The format of a file: the one asked for, or the one that its name says.
pub(super) fn format(file: &Path, asked: Option<Format>) -> Result<Format, ImportError> {
    if let Some(layout) = megasam::detect(file).filter(|_| file.is_dir()) {
        return Ok(Format::of_layout(layout));
    }
    // a folder of MegaSaM that lacks files is told by its reader, which says which
    if file.is_dir() && asked != Some(Format::MegasamReconstruction) {
        let first = file.join(frame_name(0));
        return Err(ImportError::Sequence {
            path: file.to_path_buf(),
            first: first.is_file().then_some(first),
        });
    }
    let format = asked
        .or_else(|| Format::of_path(file))
        .ok_or_else(|| ImportError::Unknown {
            path: file.to_path_buf(),
            known: known(),
        })?;
    if READ.contains(&format) {
        return Ok(format);
    }
    Err(ImportError::WriteOnly {
        name: format.name(),
        known: known(),
    })
}

/// The scene in a file.
pub(super) fn read(format: Format, path: &Path) -> Result<Imported, ImportError> {
    read_back(format, path, 0, 0.0).unwrap_or_else(|| {
        Err(ImportError::WriteOnly {
            name: format.name(),
            known: known(),
        })
    })
}

/// The scene in what was exported; of a sequence that of file `moment`, of USD the splats at frame `t`. `None`
/// for formats that are not read.
pub(crate) fn read_back(format: Format, path: &Path, moment: usize, t: f64) -> Option<Result<Imported, ImportError>> {
    Some(match format {
        Format::Fourdgs => fourdgs::read(path).map_err(ImportError::from),
        Format::Splatv => splatv::read(path).map_err(ImportError::from),
        Format::Ply => ply::read(path).map_err(ImportError::from),
        Format::PlySequence => ply::read(&path.join(frame_name(moment))).map_err(ImportError::from),
        Format::Spz => spz::read(path, spz::SpzAxes::Rub).map(still).map_err(ImportError::from),
        Format::Gltf => gltf::read(path).map(still).map_err(ImportError::from),
        Format::Usd => usd::read(path, t).map(still).map_err(ImportError::from),
        Format::Colmap
        | Format::Nerfstudio
        | Format::Mp4
        | Format::Megasam
        | Format::MegasamCvd
        | Format::MegasamReconstruction => return None,
    })
}

/// Splats of one instant as a scene; our axes have y down.
fn still(splats: Splats) -> Imported {
    Imported {
        scene: Scene {
            splats,
            background: [0.0; 3],
            time_frames: 1,
            duration_s: None,
            mip: false,
            near: 0.01,
            source: Vec::new(),
        },
        up: Some([0.0, -1.0, 0.0]),
        losses: Vec::new(),
    }
}
