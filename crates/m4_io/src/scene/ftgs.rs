//! `.ftgs.ply` (version 1): splats on straight lines with a Gaussian in time, as FreeTimeGS has
//! them, 88 bytes per splat.
//!
//! The PLY of 3DGS ([`super::ply`]) with five properties more, and facts in comments of the form
//! `KEY VALUE`:
//!
//! ```text
//! x y z           mean at the middle of the life, world units
//! time            middle of the life; the clip is 0..1, frame i is i / (n_frames - 1)
//! log_duration    logarithm of the standard deviation in time, clips
//! velocity_0..2   world units per clip
//! ftgs_version 1, time_units normalized, sh_degree 0..3, use_velocity 1, n_frames
//! min_duration    durations are at least this
//! opacity_floor   a player draws no splat with less opacity: 0 here
//! ```
//!
//! A static splat has no velocity and a duration of a thousand clips. The file has neither cameras
//! nor a frame rate.
//!
//! Source: `FORMAT.md` of `OpsiClear-4DGS/ftgs-player`, and the exporter of
//! `OpsiClear-4DGS/FreeTimeGsVanilla`.

use super::splats::{FOREVER_CLIPS, Life};
use super::{Loss, Written, at_peak, check_finite, check_unbound, ply, publish};
use crate::WriteError;
use m4_core::Scene;
use std::fmt::Write as _;
use std::path::Path;

/// Shortest duration that is written, clips.
const LEAST_DURATION: f64 = 1e-6;

/// Writes a scene, atomically. Colours become those in the middle of each splat's life. Fails when
/// the scene has values that are not finite, bound splats or no splats at all, or the file system
/// refuses.
pub fn write(path: &Path, scene: &Scene) -> Result<Written, WriteError> {
    check_finite(path, scene)?;
    check_unbound(path, &scene.splats)?;
    let splats = at_peak(&scene.splats);
    let n = splats.n();
    if n == 0 {
        return Err(WriteError::bad(
            path,
            "the scene has no splats, and this format has no empty files",
        ));
    }
    let frames = scene.time_frames.max(1);
    let last = frames.saturating_sub(1).max(1) as f64;
    let degree = splats.layout().sh_degree;
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    let comments = [
        concat!("minute4d ", env!("CARGO_PKG_VERSION")).to_owned(),
        "ftgs_version 1".to_owned(),
        "time_units normalized".to_owned(),
        format!("sh_degree {degree}"),
        "use_velocity 1".to_owned(),
        format!("min_duration {LEAST_DURATION}"),
        "opacity_floor 0".to_owned(),
        format!("n_frames {frames}"),
    ];
    // Writing to a string cannot fail.
    for comment in comments {
        let _ = writeln!(text, "comment {comment}");
    }
    if scene.mip {
        text.push_str(ply::MIP_COMMENT);
    }
    let _ = writeln!(text, "element vertex {n}");
    let names = [
        "time",
        "log_duration",
        "velocity_0",
        "velocity_1",
        "velocity_2",
    ]
    .map(str::to_owned);
    let names: Vec<String> = ply::properties(degree).chain(names).collect();
    for name in &names {
        let _ = writeln!(text, "property float {name}");
    }
    text.push_str("end_header\n");

    let mut bytes = text.into_bytes();
    bytes.reserve(4 * n * names.len());
    for i in 0..n {
        let life = Life::of(&splats, i);
        let (time, duration) = life.map_or((0.5, FOREVER_CLIPS), |life| {
            (
                f64::from(life.time_mean) / last,
                f64::from(life.log_time_sd).exp() / last,
            )
        });
        let velocity = life.map_or([0.0; 3], |life| {
            life.velocity.map(|v| (f64::from(v) * last) as f32)
        });
        let own = [time as f32, duration.max(LEAST_DURATION).ln() as f32];
        bytes.extend(
            ply::numbers(&splats, i)
                .chain(own)
                .chain(velocity)
                .flat_map(f32::to_le_bytes),
        );
    }
    publish(path, &bytes)?;
    Ok(Written {
        path: path.to_path_buf(),
        bytes: bytes.len() as u64,
        splats: n,
        losses: losses(scene),
    })
}

fn losses(scene: &Scene) -> Vec<Loss> {
    let mut losses = Vec::new();
    if scene.splats.layout().time_degree > 0 {
        losses.push(Loss::Baked(
            "the harmonics of time: every colour is that in the middle of the splat's lifetime"
                .to_owned(),
        ));
    }
    losses.extend(ply::unheld(scene));
    if scene.duration_s.is_some() {
        losses.push(Loss::Dropped(
            "the length of the clip, seconds: players ask for a frame rate".to_owned(),
        ));
    }
    losses
}

#[cfg(test)]
mod tests {
    use super::write;
    use m4_core::{Column, Scene, SplatLayout};
    use m4_testkit::{SceneSpec, bound_scene, random_scene};
    use serde::Deserialize;
    use std::collections::HashMap;

    #[derive(Deserialize)]
    struct File {
        vertex: Vec<HashMap<String, f32>>,
    }

    fn scene(sh_degree: usize) -> Scene {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree,
            time_degree: 0,
        };
        random_scene(&SceneSpec {
            layout,
            n_static: 5,
            n_dynamic: 7,
            time_frames: 11,
            ..SceneSpec::default()
        })
    }

    #[test]
    fn properties_are_those_of_the_format() {
        let dir = tempfile::tempdir().unwrap();
        let (path, scene) = (dir.path().join("a.ftgs.ply"), scene(1));
        let written = write(&path, &scene).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!((written.splats, written.bytes), (12, bytes.len() as u64));
        let text = String::from_utf8_lossy(&bytes[..900]).into_owned();
        for line in [
            "comment ftgs_version 1\n",
            "comment time_units normalized\n",
            "comment sh_degree 1\n",
            "comment use_velocity 1\n",
            "comment min_duration 0.000001\n",
            "comment opacity_floor 0\n",
            "comment n_frames 11\n",
            "comment SplatRenderMode: mip\n",
        ] {
            assert!(text.contains(line), "{line}: {text}");
        }
        let file: File = serde_ply::from_reader(std::io::Cursor::new(&bytes)).unwrap();
        let splats = &scene.splats;
        for (i, vertex) in file.vertex.iter().enumerate() {
            assert_eq!(vertex.len(), 22 + 9);
            assert_eq!(vertex["x"], splats.column(Column::Mean, 0)[i]);
            assert_eq!(vertex["opacity"], splats.column(Column::Opacity, 0)[i]);
            let Some(d) = i.checked_sub(5) else {
                assert_eq!((vertex["velocity_0"], vertex["time"]), (0.0, 0.5));
                assert!((vertex["log_duration"] - 1000f32.ln()).abs() < 1e-6);
                continue;
            };
            let close = |a: f32, b: f32| {
                assert!(
                    (a - b).abs() < 1e-5 * b.abs().max(1.0),
                    "{a} and {b} of {i}"
                )
            };
            close(vertex["time"], splats.column(Column::TimeMean, 0)[d] / 10.0);
            close(
                vertex["log_duration"],
                splats.column(Column::LogTimeSd, 0)[d] - 10f32.ln(),
            );
            close(
                vertex["velocity_2"],
                splats.column(Column::Velocity, 2)[d] * 10.0,
            );
        }
    }

    #[test]
    fn what_the_format_cannot_hold_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.ftgs.ply");
        let mut empty = scene(0);
        empty.splats = empty.splats.gather(&[]).unwrap();
        assert!(
            write(&path, &empty)
                .unwrap_err()
                .to_string()
                .contains("no splats")
        );
        let bound = bound_scene(&SceneSpec::default());
        let error = write(&path, &bound).unwrap_err().to_string();
        assert!(
            error.contains("20 splats bound to nodes") && error.contains("pose::at"),
            "{error}"
        );
        assert!(!path.exists());
    }
}
