//! Writes one instant of a scene as an SPZ file.

use super::encode::{Encoded, MAX_FRACTIONAL_BITS, encode};
use super::error::WriteSpzError;
use super::options::{SpzAxes, SpzOptions};
use crate::scene::rub::turn_splats;
use crate::scene::verified::VerifiedFile;
use crate::scene::{Loss, WriteFileError, Written, instant};
use flate2::{Compression, GzBuilder};
use m4_core::Scene;
use std::io::Write;
use std::path::Path;

/// Writes the splats that the instant [`SpzOptions::t`] sees; the bytes on the disk are compared before the
/// file gets its name.
///
/// # Errors
///
/// [`WriteSpzError`]; what was at `path` is then still there.
pub fn write(path: &Path, scene: &Scene, options: &SpzOptions) -> Result<Written, WriteSpzError> {
    check(path, options)?;
    let io = |e| WriteSpzError::File(WriteFileError::io(path, e));
    let mut splats = instant(&scene.splats, options.t, scene.time_frames as f64);
    if options.axes == SpzAxes::Rub {
        turn_splats(&mut splats);
    }
    let encoded = encode(&splats, scene.mip, options).map_err(|what| WriteSpzError::BadScene {
        path: path.to_path_buf(),
        what,
    })?;
    let count = splats.n();
    drop(splats);
    let mut file = VerifiedFile::create(path).map_err(io)?;
    // neither name nor time of day: the same scene gives the same bytes
    let mut stream = GzBuilder::new()
        .mtime(0)
        .write(&mut file, Compression::new(options.gzip_level));
    stream.write_all(&encoded.bytes).map_err(io)?;
    stream.finish().map_err(io)?;
    file.verify()
        .map_err(|e| WriteSpzError::File(WriteFileError::verify(path, e)))?;
    let bytes = file.commit().map_err(io)?;
    Ok(Written {
        path: path.to_path_buf(),
        bytes,
        splats: count,
        losses: losses(scene, options, &encoded),
    })
}

fn check(path: &Path, options: &SpzOptions) -> Result<(), WriteSpzError> {
    let bad = |setting, value: String, expected| {
        Err(WriteSpzError::BadOption {
            path: path.to_path_buf(),
            setting,
            value,
            expected,
        })
    };
    if !options.t.is_finite() {
        return bad("t", options.t.to_string(), "a number of frames");
    }
    for (setting, bits) in [("sh1_bits", options.sh1_bits), ("sh_rest_bits", options.sh_rest_bits)] {
        if !(1..=8).contains(&bits) {
            return bad(setting, bits.to_string(), "1 to 8");
        }
    }
    if let Some(bits) = options.fractional_bits
        && bits > MAX_FRACTIONAL_BITS
    {
        return bad("fractional_bits", bits.to_string(), "0 to 22");
    }
    if options.gzip_level > 9 {
        return bad("gzip_level", options.gzip_level.to_string(), "0 to 9");
    }
    Ok(())
}

fn losses(scene: &Scene, options: &SpzOptions, encoded: &Encoded) -> Vec<Loss> {
    let clipped = |n: usize, range: &str| match n {
        0 => String::new(),
        n => format!(" ({n} outside of {range} were clipped)"),
    };
    let mut losses = vec![
        Loss::Baked(format!("everything, at frame {}", options.t)),
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
            "harmonics to {} bits (degree 1) and {} bits{}",
            options.sh1_bits,
            options.sh_rest_bits,
            clipped(encoded.clipped_harmonics, "-1 to 1")
        )));
    }
    losses
}
