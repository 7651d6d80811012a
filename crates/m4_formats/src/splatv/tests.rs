//! A scene to a file and back, and bytes as the player reads them.

use super::{ReadSplatvError, WriteSplatvError, parse, read, write};
use crate::Loss;
use crate::row::{Row, sigmoid};
use half::f16;
use m4_math::nalgebra::Vector4;
use m4_scene::{Column, Scene, SplatLayout, Splats};
use m4_testkit::{SceneSpec, random_scene};
use std::path::Path;

fn scene() -> Scene {
    random_scene(&SceneSpec {
        n_static: 300,
        n_dynamic: 900,
        time_frames: 41,
        ..SceneSpec::default()
    })
}

#[test]
fn every_parameter_comes_back_to_eleven_bits() {
    let scene = scene();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.splatv");
    let written = write(&path, &scene).unwrap();
    // two rows of 1024 splats
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(written.bytes, bytes.len() as u64);
    let json = u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
    assert_eq!(bytes.len(), 8 + json + 2 * 4096 * 16);
    let found = read(&path).unwrap();
    assert!(found.losses.is_empty(), "{:?}", found.losses);
    let back = found.scene;
    assert_eq!(
        (back.background, back.time_frames, back.duration_s, back.mip, back.near),
        (scene.background, 41, Some(1.25), true, 0.02)
    );
    for (a, b) in scene.source.iter().zip(&back.source) {
        assert_eq!(
            (a.camera, a.exposure),
            (b.camera, b.exposure),
            "poses come back bit by bit"
        );
        assert!((a.t - b.t).abs() < 1e-12);
    }
    let (a, b) = (&scene.splats, &back.splats);
    assert_eq!((a.n_static(), a.n_dynamic()), (b.n_static(), b.n_dynamic()));
    let half = |v: f64, w: f64| (v - w).abs() <= v.abs() / 2048.0 + 1e-7;
    for i in 0..a.n() {
        let (old, new) = (Row::of(a, i), Row::of(b, i));
        for k in 0..3 {
            let [p, q] = [&old, &new].map(|r| f64::from(r.log_scale[k]).exp());
            assert!(half(p, q), "scale {k} of {i}: {p} {q}");
            let [p, q] = [a, b].map(|s| f64::from(s.column(Column::Colour, k)[i]) * 0.282_094_791_773_878_14 + 0.5);
            assert!((p.clamp(0.0, 1.0) - q).abs() < 0.501 / 255.0);
        }
        let [p, q] = [old.quat, new.quat].map(|q| Vector4::from(q.map(f64::from)));
        assert!(p.dot(&q).abs() > 1.0 - 1e-6);
        assert!((sigmoid(old.opacity) - sigmoid(new.opacity)).abs() < 0.501 / 255.0);
        let Some(d) = i.checked_sub(a.n_static()) else {
            assert_eq!(old.mean, new.mean, "static means are exact");
            continue;
        };
        let at = |s: &Splats, column, k: usize| f64::from(s.column(column, k)[d]);
        let dt = at(b, Column::TimeMean, 0) - at(a, Column::TimeMean, 0);
        assert!(dt.abs() <= 40.0 / 4096.0 + 1e-5);
        let [p, q] = [a, b].map(|s| at(s, Column::LogTimeSd, 0).exp());
        assert!(half(p, q));
        for k in 0..3 {
            let (v, w) = (at(a, Column::Velocity, k), at(b, Column::Velocity, k));
            assert!(half(v, w));
            // the mean went along with the middle
            let moved = f64::from(old.mean[k]) + v * dt;
            assert!((moved - f64::from(new.mean[k])).abs() < 1e-5);
        }
    }
}

/// A splat as the shader of the player reads it, by hand.
fn words(change: impl FnOnce(&mut [u32; 16])) -> Vec<u8> {
    let h = |v: f32| u32::from(f16::from_f32(v).to_bits());
    let mut words = [0u32; 16];
    for (k, v) in [1.0f32, 2.0, 3.0].into_iter().enumerate() {
        words[k] = v.to_bits();
    }
    words[3] = h(0.0) | h(1.0) << 16; // half a turn about x: (w, x, y, z) = (0, 1, 0, 0)
    words[5] = h(0.5) | h(0.25) << 16;
    words[6] = h(0.125);
    words[7] = u32::from_le_bytes([255, 0, 51, 204]);
    words[8] = h(10.0) | h(-20.0) << 16;
    words[9] = h(30.0);
    words[15] = h(0.5) | h(0.1) << 16;
    change(&mut words);
    let mut texture = vec![0u8; 4096 * 16];
    for (word, bytes) in words.iter().zip(texture.as_chunks_mut::<4>().0) {
        *bytes = word.to_le_bytes();
    }
    file(
        r#"[{"type":"splat","size":65536,"texwidth":4096,"texheight":1,"cameras":[{"id":0,"img_name":"a",
            "width":640,"height":480,"position":[1,2,3],"rotation":[[1,0,0],[0,1,0],[0,0,1]],"fy":500,"fx":510}]}]"#,
        &texture,
    )
}

fn file(json: &str, texture: &[u8]) -> Vec<u8> {
    let mut bytes = 0x674bu32.to_le_bytes().to_vec();
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(json.as_bytes());
    bytes.extend(texture);
    bytes
}

#[test]
fn a_file_of_another_program_is_read_as_its_player_draws_it() {
    let found = parse(Path::new("a.splatv"), &words(|_| {})).unwrap();
    let (scene, splats) = (&found.scene, &found.scene.splats);
    // the tail of the texture is no splats; without a word on time there are 61 frames
    assert_eq!((splats.n_static(), splats.n_dynamic(), scene.time_frames), (0, 1, 61));
    let row = Row::of(splats, 0);
    assert_eq!((row.mean, row.quat), ([1.0, 2.0, 3.0], [0.0, 1.0, 0.0, 0.0]));
    assert_eq!(row.log_scale.map(f32::exp), [0.5, 0.25, 0.125]);
    assert!((sigmoid(row.opacity) - 0.8).abs() < 1e-6);
    let red = splats.column(Column::Colour, 0)[0];
    assert!((red - 0.5 / 0.282_094_8).abs() < 1e-5);
    assert_eq!(splats.column(Column::TimeMean, 0), &[30.0]);
    // exp(-(dt / s)^2) = exp(-dt^2 / 2 sd^2) with s = 0.1 clips = 6 frames
    let sd = splats.column(Column::LogTimeSd, 0)[0].exp();
    assert!((sd - 6.0 / 2f32.sqrt()).abs() < 3e-3);
    assert!((splats.column(Column::Velocity, 1)[0] + 20.0 / 60.0).abs() < 1e-6);
    let camera = scene.source[0].camera;
    assert_eq!((camera.intrinsics.fx, camera.intrinsics.cx), (510.0, 320.0));
    assert!(found.losses.is_empty());

    let curved = parse(
        Path::new("a.splatv"),
        &words(|w| {
            w[9] |= 0x3c00 << 16;
            w[13] = 0x3c00;
        }),
    )
    .unwrap();
    let all: Vec<String> = curved.losses.iter().map(Loss::to_string).collect();
    assert!(all[0].contains("bends") && all[1].contains("turning"), "{all:?}");

    let still = parse(
        Path::new("a.splatv"),
        &words(|w| {
            w[8] = 0;
            w[9] = 0;
            w[15] = 0x7000 << 16;
        }),
    )
    .unwrap();
    assert_eq!(still.scene.splats.n_static(), 1);
}

#[test]
fn nonsense_is_named() {
    let at = Path::new("a.splatv");
    let damaged = |bytes: &[u8]| parse(at, bytes).unwrap_err().to_string();
    assert!(matches!(parse(at, b"no"), Err(ReadSplatvError::NotSplatv { .. })));
    assert!(matches!(parse(at, &[7; 100]), Err(ReadSplatvError::NotSplatv { .. })));
    let good = words(|_| {});
    assert!(damaged(&good[..200]).contains("header says"));
    assert!(damaged(&good[..5000]).contains("65536 bytes in 4096 x 1 texels"));
    assert!(damaged(&file("[]", &[])).contains("lists no splats"));
    assert!(
        damaged(&file(
            r#"[{"type":"splat","size":18446744073709551615,"texwidth":4294967296,"texheight":4294967296}]"#,
            &[]
        ))
        .contains("texels")
    );
    let nan = parse(at, &words(|w| w[1] = f32::NAN.to_bits())).unwrap_err();
    assert!(
        matches!(
            nan,
            ReadSplatvError::BadValue {
                splat: 0,
                field: "the position",
                ..
            }
        ),
        "{nan}"
    );
}

#[test]
fn what_a_half_cannot_hold_is_refused() {
    let mut scene = scene();
    scene.splats.column_mut(Column::Velocity, 0)[3] = 5000.0;
    let dir = tempfile::tempdir().unwrap();
    let error = write(&dir.path().join("a.splatv"), &scene).unwrap_err();
    assert!(matches!(error, WriteSplatvError::BadScene { .. }));
    assert!(error.to_string().contains("motion of splat 303"), "{error}");
    let layout = SplatLayout {
        isotropic: true,
        sh_degree: 1,
        time_degree: 1,
    };
    scene.splats = Splats::zeros(layout, 1, 1);
    let losses = write(&dir.path().join("a.splatv"), &scene).unwrap().losses;
    assert!(matches!(losses[..2], [Loss::Baked(_), Loss::Dropped(_)]), "{losses:?}");
}
