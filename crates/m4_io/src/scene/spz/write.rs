//! Writes one instant of a scene as an SPZ file.

use super::encode::{Encoded, SH_REST_BITS, SH1_BITS, encode};
use crate::scene::rub::turn_splats;
use crate::scene::verified::VerifiedFile;
use crate::scene::{Loss, WriteFileError, Written, instant};
use flate2::{Compression, GzBuilder};
use m4_core::Scene;
use std::io::Write;
use std::path::Path;

/// Effort of gzip: that of zlib.
const GZIP_LEVEL: u32 = 6;

/// Writes the splats that the instant `t` (frames) sees; the bytes on the disk are compared before the
/// file gets its name.
///
/// # Errors
///
/// [`WriteFileError`]; what was at `path` is then still there.
pub fn write(path: &Path, scene: &Scene, t: f64) -> Result<Written, WriteFileError> {
    if !t.is_finite() {
        let what = format!("t = {t}; a number of frames was expected");
        return Err(WriteFileError::bad("SPZ", what));
    }
    let io = |e| WriteFileError::io(path, e);
    let mut splats = instant(&scene.splats, t, scene.time_frames as f64);
    turn_splats(&mut splats);
    let encoded = encode(&splats, scene.mip).map_err(|what| WriteFileError::bad("SPZ", what))?;
    let count = splats.n();
    drop(splats);
    let mut file = VerifiedFile::create(path).map_err(io)?;
    // neither name nor time of day: the same scene gives the same bytes
    let mut stream = GzBuilder::new().mtime(0).write(&mut file, Compression::new(GZIP_LEVEL));
    stream.write_all(&encoded.bytes).map_err(io)?;
    stream.finish().map_err(io)?;
    file.verify().map_err(|e| WriteFileError::verify(path, e))?;
    let bytes = file.commit().map_err(io)?;
    Ok(Written {
        path: path.to_path_buf(),
        bytes,
        splats: count,
        losses: losses(scene, t, &encoded),
    })
}

fn losses(scene: &Scene, t: f64, encoded: &Encoded) -> Vec<Loss> {
    let clipped = |n: usize, range: &str| match n {
        0 => String::new(),
        n => format!(" ({n} outside of {range} were clipped)"),
    };
    let mut losses = vec![
        Loss::Baked(format!("everything, at frame {t}")),
        Loss::Dropped("motion, the background and the colour corrections of the frames".into()),
        Loss::Quantised(format!(
            "positions to steps of 2^-{} units",
            encoded.header.fractional_bits
        )),
        Loss::Quantised(format!(
            "scales to steps of 6.4 %{}, opacities to 1/255, rotations to 0.0014",
            clipped(encoded.clipped_scales, "e^-10 to e^5.94")
        )),
        Loss::Quantised(format!(
            "colours to steps of 1/136{}",
            clipped(encoded.clipped_colours, "-0.44 to 1.44")
        )),
    ];
    if scene.splats.layout().sh_degree > 0 {
        losses.push(Loss::Quantised(format!(
            "harmonics to {SH1_BITS} bits (degree 1) and {SH_REST_BITS} bits{}",
            clipped(encoded.clipped_harmonics, "-1 to 1")
        )));
    }
    losses
}
