//! Calls the writer of each format.

use super::{ExportError, ExportJob, Format, video};
use crate::{Error, Observer};
use m4_core::Scene;
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
        Format::Fourdgs => fourdgs::write(out, scene, &job.fourdgs)?,
        Format::Splatv => splatv::write(out, scene)?,
        Format::Ply => ply::write(out, scene, t)?,
        Format::PlySequence => {
            let mut stopped = false;
            let written = ply::write_sequence(out, scene, moments, |done| {
                observer.update("export", done, moments.len(), "");
                stopped = observer.cancelled();
                !stopped
            })?;
            if stopped {
                return Err(Error::Stopped {
                    stage: "export",
                    saved: false,
                });
            }
            written
        }
        Format::Spz => spz::write(out, scene, t)?,
        Format::Gltf => gltf::write(out, scene, t)?,
        Format::Colmap | Format::Nerfstudio => return Err(ExportError::NeedsCapture { format: job.format }.into()),
        Format::Mp4 => video::write(out, scene, job.fps, observer)?,
    };
    Ok(written)
}
