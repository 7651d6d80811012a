//! Calls the writer of each format.

use super::{ExportError, ExportJob, Format, video};
use crate::{Error, Observer};
use m4_core::Scene;
use m4_io::cameras::{colmap, nerfstudio};
use m4_io::scene::{Written, fourdgs, gltf, ply, splatv, spz};
use std::path::Path;

/// Writes `scene` to `out`; `moments` are those of [`ExportJob::moments`].
pub(super) fn write(
    scene: &Scene,
    out: &Path,
    moments: &[f64],
    job: &ExportJob,
    observer: &dyn Observer,
) -> Result<Written, Error> {
    let t = moments.first().copied().unwrap_or(0.0);
    let written = match job.format {
        Format::Fourdgs => fourdgs::write(out, scene, &job.fourdgs).map_err(ExportError::from)?,
        Format::Splatv => splatv::write(out, scene).map_err(ExportError::from)?,
        Format::Ply => ply::write(out, scene, t).map_err(ExportError::from)?,
        Format::PlySequence => {
            let mut stopped = false;
            let written = ply::write_sequence(out, scene, moments, |done| {
                observer.update("export", done, moments.len(), "");
                stopped = observer.cancelled();
                !stopped
            })
            .map_err(ExportError::from)?;
            if stopped {
                return Err(Error::Stopped {
                    stage: "export",
                    saved: false,
                });
            }
            written
        }
        Format::Spz => {
            let options = spz::SpzOptions {
                t,
                ..spz::SpzOptions::default()
            };
            spz::write(out, scene, &options).map_err(ExportError::from)?
        }
        Format::Gltf => gltf::write(out, scene, &gltf::GltfOptions { t }).map_err(ExportError::from)?,
        Format::Colmap => {
            let options = colmap::ColmapOptions {
                // the points are those of the middle of the clip
                t: (scene.time_frames.saturating_sub(1) / 2) as f64,
                ..colmap::ColmapOptions::default()
            };
            // where COLMAP and those who read its models look
            colmap::write(&out.join("sparse/0"), scene, &options).map_err(ExportError::from)?
        }
        Format::Nerfstudio => {
            let options = nerfstudio::NerfstudioOptions::default();
            nerfstudio::write(out, scene, &options).map_err(ExportError::from)?
        }
        Format::Mp4 => video::write(out, scene, job.fps, observer)?,
    };
    Ok(written)
}
