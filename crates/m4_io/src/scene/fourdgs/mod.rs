//! `.4dgs`: splats with a velocity and a Gaussian in time, in chunks that can be sought (version
//! 1).
//!
//! The model `gaussian-birth` is ours (docs/spec/optimiser.md 1.4): a centre that moves along a
//! straight line, a marginal in time that is cut off at 0.05, scales and a rotation that stay.
//! Nothing is baked but the harmonics of time. What the format has no field for (background, near
//! plane, Mip filter, number of frames) travels as a metadata record named `minute4d`, the cameras
//! of the video as the format's own sensor and rig records. The container itself is read and
//! written by the `fourdgs` crate.
//!
//! | scene | file |
//! |---|---|
//! | frames | seconds, `duration_s / (time_frames - 1)` each; 1/30 s where the scene does not know |
//! | static splat | `sigma_t = inf`, no motion |
//! | colour `1/2 + C0 k` | "linear RGB" of 0..1: the value as it is, said to be `srgb-rec709-display` |
//! | harmonics of degree 1 to 3 | one byte each over -4..4, signs and order of 3DGS |
//! | quaternion (w, x, y, z) | (x, y, z, w) |
//! | world, y down | as it is; the coordinate frame record says so |

mod cameras;
mod convert;
mod read;
#[cfg(test)]
mod tests;

pub use read::{parse, read};

use super::{
    Clock, DEFAULT_FPS, Loss, Written, at_peak, check_finite, check_unbound, plural, publish,
};
use crate::WriteError;
use ::fourdgs::quantization::{Bounds, Profile};
use ::fourdgs::stream_reader::{ReadOptions, read_from};
use ::fourdgs::{GaussianSet, SceneExtras, WriteOptions, write_to_vec};
use convert::{ClipTime, to_set, verify};
use m4_core::Scene;
use std::collections::BTreeMap;
use std::path::Path;

/// Effort of deflate, 0 to 9: the default of the container's reference encoder.
const COMPRESSION: u32 = 6;

/// Writes a scene, atomically. The bytes are decoded and compared before the file takes its name.
/// Fails when the scene has values that are not finite, the file system refuses, or the bytes do
/// not decode to the scene.
pub fn write(path: &Path, scene: &Scene) -> Result<Written, WriteError> {
    let (bytes, losses) = encode(path, scene)?;
    publish(path, &bytes)?;
    Ok(Written {
        path: path.to_path_buf(),
        bytes: bytes.len() as u64,
        splats: scene.splats.n(),
        losses,
    })
}

/// The bytes of the file `path`, decoded and compared with the scene, and what they cannot hold.
pub fn encode(path: &Path, scene: &Scene) -> Result<(Vec<u8>, Vec<Loss>), WriteError> {
    check_finite(path, scene)?;
    check_unbound(path, &scene.splats)?;
    let clock = Clock::of(scene);
    let clip = ClipTime {
        step_s: clock.step_s,
        frames: scene.time_frames.max(1),
    };
    let splats = at_peak(&scene.splats);
    let (set, clipped) = to_set(&splats, &clip);
    let (provenance, unheld) = cameras::provenance(scene, &clip);
    let extras = SceneExtras {
        camera: cameras::view(scene, &clip),
        metadata: vec![cameras::record(scene)],
        provenance,
        ..SceneExtras::default()
    };
    let options = WriteOptions {
        profile: Profile::Default,
        level: COMPRESSION,
        write_statistics: true,
        verify: false,
        library: concat!("minute4d ", env!("CARGO_PKG_VERSION")).to_owned(),
        metadata: BTreeMap::from([("color_space".to_owned(), "srgb-rec709-display".to_owned())]),
        ..WriteOptions::default()
    };
    let bad = |e: ::fourdgs::Error| WriteError::bad(path, e.to_string());
    let bytes = write_to_vec(&set, f64::from(clip.duration_s()), &options, &extras).map_err(bad)?;
    let bounds = Bounds::for_profile(options.profile, median(&set));
    decodes_to(&bytes, &set, &bounds).map_err(|reason| WriteError::encode(path, reason))?;

    let mut losses = Vec::new();
    if clock.assumed {
        losses.push(Loss::Baked(format!(
            "seconds, at {DEFAULT_FPS} frames per second: the scene does not know how long it lasts"
        )));
    }
    if scene.splats.layout().time_degree > 0 {
        losses.push(Loss::Baked(
            "the harmonics of time: every colour is that in the middle of the splat's lifetime"
                .to_owned(),
        ));
    }
    if scene.mip {
        losses.push(Loss::Dropped(
            "the Mip filter for other players (minute4d finds it in the metadata)".to_owned(),
        ));
    }
    losses.extend(unheld);
    losses.extend(clipped);
    losses.extend(steps(&bounds, &set, splats.layout().sh_degree));
    Ok((bytes, losses))
}

fn decodes_to(bytes: &[u8], set: &GaussianSet, bounds: &Bounds) -> Result<(), String> {
    let options = ReadOptions {
        recover_truncated: false,
        ..ReadOptions::default()
    };
    let file = read_from(bytes, &options).map_err(|e| e.to_string())?;
    verify(set, bounds, &file)
}

/// The median over all scales, as the container measures its bound of positions by; see `Bounds`.
fn median(set: &GaussianSet) -> f64 {
    let mut scales = set.scales.clone();
    if scales.is_empty() {
        return 1e-3;
    }
    scales.sort_unstable_by(f32::total_cmp);
    let (low, high) = (scales[(scales.len() - 1) / 2], scales[scales.len() / 2]);
    if scales.len() % 2 == 1 {
        f64::from(high)
    } else {
        0.5 * (f64::from(low) + f64::from(high))
    }
}

fn steps(bounds: &Bounds, set: &GaussianSet, sh_degree: usize) -> Vec<Loss> {
    let percent = |v: f64| format!("{} %", 100.0 * v);
    let mut all = vec![
        format!("positions by up to {:.2e} units", bounds.pos),
        format!("scales by up to {}", percent(bounds.scale_rel)),
        format!(
            "colours and opacities by up to {:.1}/255",
            255.0 * bounds.rgb
        ),
    ];
    let moving = set.sigma_t.iter().filter(|s| s.is_finite()).count();
    if moving > 0 {
        all.push(format!(
            "of {}: moments by up to {} ms, durations by up to {}",
            plural(moving, "moving splat"),
            1e3 * bounds.time,
            percent(bounds.sigma_rel)
        ));
    }
    if sh_degree > 0 {
        all.push("harmonics by up to 0.016".to_owned());
    }
    all.into_iter().map(Loss::Quantised).collect()
}
