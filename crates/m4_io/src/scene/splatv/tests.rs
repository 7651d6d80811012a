//! Bytes of a scene as the player reads them.

use super::write;
use crate::ErrorKind;
use crate::scene::Loss;
use crate::scene::splats::{Life, Row, sigmoid};
use half::f16;
use m4_core::{Column, Scene, SplatLayout, Splats, nalgebra::Vector4};
use m4_testkit::{SceneSpec, random_scene};
use serde_json::{Value, json};

fn scene() -> Scene {
    random_scene(&SceneSpec { n_static: 300, n_dynamic: 900, time_frames: 41, ..SceneSpec::default() })
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
    assert_eq!((&part["type"], &part["size"]), (&json!("splat"), &json!(2 * 4096 * 16)));
    assert_eq!((&part["texwidth"], &part["texheight"]), (&json!(4096), &json!(2)));
    let facts = &part["minute4d"];
    assert_eq!((&facts["time_frames"], &facts["mip"]), (&json!(41), &json!(true)));
    assert_eq!(part["cameras"].as_array().unwrap().len(), scene.source.len());
    let (camera, frame) = (&part["cameras"][1], &scene.source[1]);
    assert_eq!(camera["fx"], json!(frame.camera.intrinsics.fx));
    assert_eq!(camera["rotation"][0][2], json!(frame.camera.c2w.rotation[(0, 2)]));
    assert_eq!(camera["time"], json!(frame.t / 40.0));

    let splats = &scene.splats;
    let half = |v: f64, w: f64| (v - w).abs() <= v.abs() / 2048.0 + 1e-7;
    let drawn = texture(&bytes[8 + length..]);
    assert!(drawn[splats.n()..].iter().all(|words| *words == [0; 16]), "the tail is zeros");
    for (i, words) in drawn.iter().take(splats.n()).enumerate() {
        let row = Row::of(splats, i);
        let mean = [words[0], words[1], words[2]].map(f32::from_bits);
        let ([w, x], [y, z]) = (halves(words[3]), halves(words[4]));
        assert!(Vector4::from(row.quat.map(f64::from)).dot(&Vector4::new(w, x, y, z)).abs() > 1.0 - 1e-3);
        let ([sx, sy], [sz, _]) = (halves(words[5]), halves(words[6]));
        for (k, scale) in [sx, sy, sz].into_iter().enumerate() {
            let want = f64::from(row.log_scale[k]).exp();
            assert!(half(want, scale), "scale {k} of {i}: {want} {scale}");
        }
        let [r, g, b, a] = words[7].to_le_bytes().map(|v| f64::from(v) / 255.0);
        for (k, value) in [r, g, b].into_iter().enumerate() {
            let want = f64::from(splats.column(Column::Colour, k)[i]) * 0.282_094_791_773_878_14 + 0.5;
            assert!((want.clamp(0.0, 1.0) - value).abs() < 0.501 / 255.0);
        }
        assert!((sigmoid(row.opacity) - a).abs() < 0.501 / 255.0);
        let ([vx, vy], [vz, _], [middle, length]) = (halves(words[8]), halves(words[9]), halves(words[15]));
        let Some(life) = Life::of(splats, i) else {
            assert_eq!((mean, [vx, vy, vz]), (row.mean, [0.0; 3]), "static means are exact");
            assert!(length > 50_000.0);
            continue;
        };
        // exp(-(dt / s)^2) = exp(-dt^2 / 2 sd^2), in clips of 40 frames
        assert!(half(2f64.sqrt() * f64::from(life.log_time_sd).exp() / 40.0, length));
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
    let layout = SplatLayout { isotropic: true, sh_degree: 1, time_degree: 1 };
    scene.splats = Splats::zeros(layout, 1, 1);
    let losses = write(&dir.path().join("a.splatv"), &scene).unwrap().losses;
    assert!(matches!(losses[..2], [Loss::Baked(_), Loss::Dropped(_)]), "{losses:?}");
}
