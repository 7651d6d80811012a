//! `.splatv`: the file of the splaTV viewer, 64 bytes per splat.
//!
//! There is no specification; this is what the players `splaTV` and `gsplat.js` read. Numbers are
//! little-endian. The file is `0x674b` and the length of the JSON as `u32`, the JSON, and one
//! texture of `texwidth x texheight` texels of four `u32`:
//!
//! ```text
//! JSON    [{"type": "splat", "size": bytes, "texwidth": 4096, "texheight": rows, "cameras": [...]}]
//! word 0..3    mean at the middle of its life, 3 x f32, world units
//! word 3, 4    rotation (w, x, y, z), halves           word 5, 6    scales, 3 halves, world units
//! word 7       red, green, blue, opacity, a byte each
//! word 8..13   motion: 3 linear, 3 quadratic, 3 cubic coefficients, halves, world units per clip^n
//! word 13, 14  change of the rotation, 4 halves per clip  word 15      middle of its life, its length s
//! ```
//!
//! Time runs from 0 to 1; a splat is drawn with its opacity times `exp(-((t - middle) / s)^2)`, so
//! that `s` is the square root of 2 times our standard deviation, and not at all where that is
//! below 0.02. The tail of the last row of the texture is zeros. A camera is written as in the
//! `cameras.json` of 3DGS, with `cx`, `cy` and `time` besides; what else a scene knows is under the
//! key `minute4d`.

use super::splats::{Life, Row, sigmoid};
use super::{C0, Loss, Written, at_peak, check_finite, check_unbound, plural, publish};
use crate::WriteError;
use half::f16;
use m4_core::{Camera, Column, Scene, SourceFrame, Splats};
use serde::Serialize;
use std::f64::consts::SQRT_2;
use std::path::Path;

/// First word of a file.
const MAGIC: u32 = 0x674b;
/// Bytes of a splat.
const SPLAT_BYTES: usize = 64;
/// Bytes of a texel.
const TEXEL_BYTES: usize = 16;
/// Texels in a row: 1024 splats.
const TEX_WIDTH: usize = 4096;

/// The longest life that is written, clips; a static splat has it.
const LONGEST_LIFE: f64 = 60_000.0;

/// Writes a scene, atomically. Colours become those in the middle of each splat's life, seen from
/// all sides alike. Fails when the scene has values that are not finite or too large for a half, or
/// the file system refuses.
pub fn write(path: &Path, scene: &Scene) -> Result<Written, WriteError> {
    check_finite(path, scene)?;
    check_unbound(path, &scene.splats)?;
    let n = scene.splats.n();
    let last = scene.time_frames.saturating_sub(1).max(1) as f64;
    let splats = at_peak(&scene.splats);
    let per_row = TEX_WIDTH * TEXEL_BYTES / SPLAT_BYTES;
    let rows = n.div_ceil(per_row).max(1);
    let texture = rows * TEX_WIDTH * TEXEL_BYTES;
    let part = FilePart {
        kind: "splat".to_owned(),
        size: texture as u64,
        texwidth: TEX_WIDTH as u64,
        texheight: rows as u64,
        cameras: views(scene, last),
        minute4d: Facts::of(scene),
    };
    let json = serde_json::to_vec(&[part]).map_err(|e| WriteError::bad(path, e.to_string()))?;
    let length = u32::try_from(json.len())
        .map_err(|_| WriteError::bad(path, format!("its cameras take {} bytes", json.len())))?;
    let mut bytes = Vec::with_capacity(8 + json.len() + texture);
    bytes.extend(MAGIC.to_le_bytes());
    bytes.extend(length.to_le_bytes());
    bytes.extend(&json);
    let mut worst = 0.0f64;
    for i in 0..n {
        let (words, shift) = words(&splats, i, last).map_err(|what| WriteError::bad(path, what))?;
        bytes.extend(words.iter().flat_map(|w| w.to_le_bytes()));
        worst = worst.max(shift);
    }
    bytes.resize(8 + json.len() + texture, 0);
    publish(path, &bytes)?;
    Ok(Written {
        path: path.to_path_buf(),
        bytes: bytes.len() as u64,
        splats: n,
        losses: losses(scene, worst * last),
    })
}

/// Two halves in a word, the first in the low bits.
fn pair(low: f16, high: f16) -> u32 {
    u32::from(low.to_bits()) | u32::from(high.to_bits()) << 16
}

/// The words of splat `i`, and how far the middle of its life moved by rounding, clips.
fn words(splats: &Splats, i: usize, last: f64) -> Result<([u32; 16], f64), String> {
    let row = Row::of(splats, i);
    let half = |what: &str, value: f64| {
        let rounded = f16::from_f64(value);
        if rounded.is_finite() {
            Ok(rounded)
        } else {
            Err(format!(
                "{what} of splat {i} is {value:.3e}, and a half holds 65504 at most"
            ))
        }
    };
    // A half below the smallest one would be a splat without extent.
    let scale = |k: usize| {
        let value = f64::from(row.log_scale[k]).exp();
        half("the scale", value.max(f64::from(f16::from_bits(1))))
    };
    let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0).round() as u32;
    let colour = |c: usize| byte(0.5 + C0 * f64::from(splats.column(Column::Colour, c)[i]));
    let life = Life::of(splats, i);
    let (middle, length) = life.map_or((0.0, LONGEST_LIFE), |l| {
        let sd = f64::from(l.log_time_sd).exp();
        (
            f64::from(l.time_mean) / last,
            (SQRT_2 * sd / last).min(LONGEST_LIFE),
        )
    });
    let centre = half("the middle of the life", middle)?;
    let shift = f64::from(centre) - middle;
    let velocity: [f64; 3] = life.map_or([0.0; 3], |l| l.velocity.map(|v| f64::from(v) * last));
    let mut motion = [f16::ZERO; 3];
    for (half_way, &v) in motion.iter_mut().zip(&velocity) {
        *half_way = half("the motion", v)?;
    }
    // Where the splat is at the moment that its middle was rounded to.
    let mean: [f32; 3] =
        std::array::from_fn(|k| (f64::from(row.mean[k]) + velocity[k] * shift) as f32);
    let quat = row.quat.map(f16::from_f32);
    // 0 would be never.
    let length = half(
        "the length of the life",
        length.max(f64::from(f16::MIN_POSITIVE_SUBNORMAL)),
    )?;
    let words = [
        mean[0].to_bits(),
        mean[1].to_bits(),
        mean[2].to_bits(),
        pair(quat[0], quat[1]),
        pair(quat[2], quat[3]),
        pair(scale(0)?, scale(1)?),
        pair(scale(2)?, f16::ZERO),
        colour(0) | colour(1) << 8 | colour(2) << 16 | byte(sigmoid(row.opacity)) << 24,
        pair(motion[0], motion[1]),
        pair(motion[2], f16::ZERO),
        0,
        0,
        0,
        0,
        0,
        pair(centre, length),
    ];
    Ok((words, shift.abs()))
}

fn losses(scene: &Scene, worst_shift: f64) -> Vec<Loss> {
    let layout = scene.splats.layout();
    let mut losses = Vec::new();
    if layout.time_degree > 0 {
        losses.push(Loss::Baked(
            "the harmonics of time: every colour is that in the middle of the splat's lifetime"
                .to_owned(),
        ));
    }
    if layout.sh_degree > 0 {
        losses.push(Loss::Dropped(
            "the spherical harmonics: a colour is the same from every direction".to_owned(),
        ));
    }
    if scene.mip {
        losses.push(Loss::Dropped(
            "the Mip filter for players (the header says that the scene wants it)".to_owned(),
        ));
    }
    if scene
        .source
        .iter()
        .any(|s| s.exposure != m4_core::Exposure::IDENTITY)
    {
        losses.push(Loss::Dropped("the exposure of every frame".to_owned()));
    }
    losses.push(Loss::Quantised("colours and opacities to bytes".to_owned()));
    losses.push(Loss::Quantised(
        "scales and rotations to halves, 11 bits".to_owned(),
    ));
    if scene.splats.n_dynamic() > 0 {
        losses.push(Loss::Quantised(format!(
            "of {}: motions and durations to 11 bits, moments by up to {worst_shift:.3} frames",
            plural(scene.splats.n_dynamic(), "moving splat")
        )));
    }
    losses
}

/// A part of the file; players read the first alone.
#[derive(Debug, Serialize)]
struct FilePart {
    #[serde(rename = "type")]
    kind: String,
    size: u64,
    texwidth: u64,
    texheight: u64,
    cameras: Vec<CameraJson>,
    minute4d: Facts,
}

/// A camera as in the `cameras.json` of 3DGS: OpenCV axes, `rotation` is camera to world, row by
/// row.
#[derive(Debug, Serialize)]
struct CameraJson {
    id: u64,
    img_name: String,
    width: u64,
    height: u64,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
    fy: f64,
    fx: f64,
    cx: f64,
    cy: f64,
    /// Of the clip, 0 to 1.
    time: f64,
}

/// Metadata that viewers ignore.
#[derive(Debug, Serialize)]
struct Facts {
    time_frames: usize,
    duration_s: Option<f64>,
    background: [f32; 3],
    near: f32,
    mip: bool,
}

impl Facts {
    fn of(scene: &Scene) -> Self {
        Self {
            time_frames: scene.time_frames,
            duration_s: scene.duration_s,
            background: scene.background,
            near: scene.near,
            mip: scene.mip,
        }
    }
}

/// The cameras of a scene; `last` is its last frame.
fn views(scene: &Scene, last: f64) -> Vec<CameraJson> {
    let view = |(i, frame): (usize, &SourceFrame)| {
        let Camera { intrinsics: k, c2w } = &frame.camera;
        CameraJson {
            id: i as u64,
            img_name: format!("{i:05}"),
            width: k.width as u64,
            height: k.height as u64,
            position: c2w.translation.into(),
            rotation: std::array::from_fn(|r| std::array::from_fn(|c| c2w.rotation[(r, c)])),
            fy: k.fy,
            fx: k.fx,
            cx: k.cx,
            cy: k.cy,
            time: frame.t / last,
        }
    };
    scene.source.iter().enumerate().map(view).collect()
}

#[cfg(test)]
mod tests {
    use super::write;
    use crate::ErrorKind;
    use crate::scene::Loss;
    use crate::scene::splats::{Life, Row, sigmoid};
    use half::f16;
    use m4_core::{Column, Scene, SplatLayout, Splats, nalgebra::Vector4};
    use m4_testkit::{SceneSpec, random_scene};
    use serde_json::{Value, json};

    fn scene() -> Scene {
        random_scene(&SceneSpec {
            n_static: 300,
            n_dynamic: 900,
            time_frames: 41,
            ..SceneSpec::default()
        })
    }

    /// The 16 words of every splat in a texture.
    fn texture(bytes: &[u8]) -> Vec<[u32; 16]> {
        let word = |b: &[u8; 4]| u32::from_le_bytes(*b);
        let splats = bytes.as_chunks::<64>().0.iter();
        splats
            .map(|splat| {
                let words = splat.as_chunks::<4>().0;
                std::array::from_fn(|k| word(&words[k]))
            })
            .collect()
    }

    /// The two halves of a word.
    fn halves(word: u32) -> [f64; 2] {
        [word as u16, (word >> 16) as u16].map(|bits| f16::from_bits(bits).to_f64())
    }

    #[test]
    fn splatv_parameters_have_half_precision() {
        let scene = scene();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.splatv");
        let written = write(&path, &scene).unwrap();
        // two rows of 1024 splats
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(written.bytes, bytes.len() as u64);
        assert_eq!(bytes[..4], 0x674bu32.to_le_bytes());
        let length = u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
        assert_eq!(bytes.len(), 8 + length + 2 * 4096 * 16);
        let part = &serde_json::from_slice::<Value>(&bytes[8..8 + length]).unwrap()[0];
        assert_eq!(
            (&part["type"], &part["size"]),
            (&json!("splat"), &json!(2 * 4096 * 16))
        );
        assert_eq!(
            (&part["texwidth"], &part["texheight"]),
            (&json!(4096), &json!(2))
        );
        let facts = &part["minute4d"];
        assert_eq!(
            (&facts["time_frames"], &facts["mip"]),
            (&json!(41), &json!(true))
        );
        assert_eq!(
            part["cameras"].as_array().unwrap().len(),
            scene.source.len()
        );
        let (camera, frame) = (&part["cameras"][1], &scene.source[1]);
        assert_eq!(camera["fx"], json!(frame.camera.intrinsics.fx));
        assert_eq!(
            camera["rotation"][0][2],
            json!(frame.camera.c2w.rotation[(0, 2)])
        );
        assert_eq!(camera["time"], json!(frame.t / 40.0));

        let splats = &scene.splats;
        let half = |v: f64, w: f64| (v - w).abs() <= v.abs() / 2048.0 + 1e-7;
        let drawn = texture(&bytes[8 + length..]);
        assert!(
            drawn[splats.n()..].iter().all(|words| *words == [0; 16]),
            "the tail is zeros"
        );
        for (i, words) in drawn.iter().take(splats.n()).enumerate() {
            let row = Row::of(splats, i);
            let mean = [words[0], words[1], words[2]].map(f32::from_bits);
            let ([w, x], [y, z]) = (halves(words[3]), halves(words[4]));
            assert!(
                Vector4::from(row.quat.map(f64::from))
                    .dot(&Vector4::new(w, x, y, z))
                    .abs()
                    > 1.0 - 1e-3
            );
            let ([sx, sy], [sz, _]) = (halves(words[5]), halves(words[6]));
            for (k, scale) in [sx, sy, sz].into_iter().enumerate() {
                let want = f64::from(row.log_scale[k]).exp();
                assert!(half(want, scale), "scale {k} of {i}: {want} {scale}");
            }
            let [r, g, b, a] = words[7].to_le_bytes().map(|v| f64::from(v) / 255.0);
            for (k, value) in [r, g, b].into_iter().enumerate() {
                let want =
                    f64::from(splats.column(Column::Colour, k)[i]) * 0.282_094_791_773_878_14 + 0.5;
                assert!((want.clamp(0.0, 1.0) - value).abs() < 0.501 / 255.0);
            }
            assert!((sigmoid(row.opacity) - a).abs() < 0.501 / 255.0);
            let ([vx, vy], [vz, _], [middle, length]) =
                (halves(words[8]), halves(words[9]), halves(words[15]));
            let Some(life) = Life::of(splats, i) else {
                assert_eq!(
                    (mean, [vx, vy, vz]),
                    (row.mean, [0.0; 3]),
                    "static means are exact"
                );
                assert!(length > 50_000.0);
                continue;
            };
            // exp(-(dt / s)^2) = exp(-dt^2 / 2 sd^2), in clips of 40 frames
            assert!(half(
                2f64.sqrt() * f64::from(life.log_time_sd).exp() / 40.0,
                length
            ));
            let dt = 40.0 * middle - f64::from(life.time_mean);
            assert!(dt.abs() <= 40.0 / 4096.0 + 1e-5);
            for (k, velocity) in [vx, vy, vz].into_iter().enumerate() {
                let want = f64::from(life.velocity[k]);
                assert!(half(40.0 * want, velocity));
                // the mean went along with the middle
                assert!((f64::from(row.mean[k]) + want * dt - f64::from(mean[k])).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn values_out_of_range_of_f16_are_refused() {
        let mut scene = scene();
        scene.splats.column_mut(Column::Velocity, 0)[3] = 5000.0;
        let dir = tempfile::tempdir().unwrap();
        let error = write(&dir.path().join("a.splatv"), &scene).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::BadData);
        assert!(error.to_string().contains("motion of splat 303"), "{error}");
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 1,
            time_degree: 1,
        };
        scene.splats = Splats::zeros(layout, 1, 1);
        let losses = write(&dir.path().join("a.splatv"), &scene).unwrap().losses;
        assert!(
            matches!(losses[..2], [Loss::Baked(_), Loss::Dropped(_)]),
            "{losses:?}"
        );
    }
}
