//! One arm a format.

use super::{ImportError, ImportFormat};
use crate::export::Format;
use m4_formats::ply::frame_name;
use m4_formats::{Imported, fourdgs, gltf, ply, splatv, spz, usd};
use m4_scene::{Scene, Splats};
use std::path::Path;

/// The scene in a file.
pub(super) fn read(format: Format, path: &Path) -> Result<Imported, ImportError> {
    read_back(format, path, 0, 0.0).unwrap_or_else(|| {
        Err(ImportError::WriteOnly {
            name: format.name(),
            known: ImportFormat::names(),
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
