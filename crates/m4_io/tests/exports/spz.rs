//! SPZ: bytes worked out by hand, and files taken apart.

use super::common::{self, asymmetric_scene};
use m4_core::{Column, SplatLayout, Splats};
use m4_io::scene::spz;
use std::io::Read;

fn unpacked(path: &std::path::Path) -> Vec<u8> {
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(std::fs::File::open(path).unwrap())
        .read_to_end(&mut bytes)
        .unwrap();
    bytes
}

#[test]
fn the_bytes_of_two_splats() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("two.spz");
    let scene = asymmetric_scene(0);
    let written = spz::write(&path, &scene, 4.0).unwrap();
    assert_eq!(written.splats, 2);
    assert_eq!(written.bytes, std::fs::metadata(&path).unwrap().len());
    let bytes = unpacked(&path);
    assert_eq!(&bytes[..12], b"NGSP\x03\0\0\0\x02\0\0\0");
    // the farthest coordinate is 6: 2^20 * 6 < 2^23, 2^21 * 6 is not
    assert_eq!(&bytes[12..16], &[0, 20, 1, 0]);
    let at = |i: usize| i32::from_le_bytes([0, bytes[i], bytes[i + 1], bytes[i + 2]]) >> 8;
    let one = 1 << 20;
    // (1, 2, 6) with y down and z forward is (1, -2, -6) with y up and z back
    assert_eq!([at(16), at(19), at(22)], [one, -2 * one, -6 * one]);
    // moved from (-1, 0.5, 3) by (0.25, 0, -0.5) a frame for two frames: (-0.5, 0.5, 2)
    assert_eq!([at(25), at(28), at(31)], [-one / 2, -one / 2, -2 * one]);
    // opacity 0.8 = 204/255; 0.5 e^-0.5 = 0.3033 = 77/255
    assert_eq!(&bytes[34..36], &[204, 77]);
    // colours 0.5 + 0.2821 c with c = (1, 0, -1): (0.15 c + 0.5) 255 = 166, 128 (127.5 away from 0), 89
    assert_eq!(&bytes[36..39], &[166, 128, 89]);
    // ln scales -1, -2, -3: 9, 8, 7 times 16
    assert_eq!(&bytes[42..45], &[144, 128, 112]);
    // turned half about x after a quarter about y, see the scene: (w, x, y, z) = (1, 0, 1, 0)/sqrt(2)
    // becomes (1, 0, -1, 0)/sqrt(2); y is the largest (index 1) and negative, so all signs turn
    let packed = u32::from_le_bytes([bytes[48], bytes[49], bytes[50], bytes[51]]);
    assert_eq!(packed >> 30, 1);
    assert_eq!(packed & 0x3ff, 1 << 9 | 511, "w is -1/sqrt(2) when y is positive");
    assert_eq!(bytes.len(), 16 + 2 * 20);
}

/// The splats of a file of degree 3, by the layout that the format's README gives; opacities from 0 to 1,
/// in the axes of the scene but for harmonics.
fn taken_apart(path: &std::path::Path) -> Splats {
    let bytes = unpacked(path);
    let n = u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
    let unit = (-f64::from(bytes[13])).exp2();
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 3,
        time_degree: 0,
    };
    let mut rest = &bytes[16..];
    let [positions, alphas, colours, scales, rotations, harmonics] = [9, 1, 3, 3, 4, 45].map(|width| {
        let (block, after) = rest.split_at(n * width);
        rest = after;
        block
    });
    assert!(rest.is_empty());
    let mut splats = Splats::zeros(layout, n, 0);
    for i in 0..n {
        for k in 0..3 {
            let p = &positions[9 * i + 3 * k..];
            let steps = i32::from_le_bytes([0, p[0], p[1], p[2]]) >> 8;
            let sign = if k == 0 { 1.0 } else { -1.0 };
            splats.column_mut(Column::Mean, k)[i] = (f64::from(steps) * unit * sign) as f32;
            splats.column_mut(Column::LogScale, k)[i] = f32::from(scales[3 * i + k]) / 16.0 - 10.0;
            splats.column_mut(Column::Colour, k)[i] = (f32::from(colours[3 * i + k]) / 255.0 - 0.5) / 0.15;
        }
        splats.column_mut(Column::Opacity, 0)[i] = f32::from(alphas[i]) / 255.0;
        for c in 0..45 {
            splats.column_mut(Column::Colour, 3 + c)[i] = (f32::from(harmonics[45 * i + c]) - 128.0) / 128.0;
        }
        let mut packed = u32::from_le_bytes(rotations[4 * i..4 * i + 4].try_into().unwrap());
        let largest = (packed >> 30) as usize;
        let mut q = [0f32; 4];
        for k in (0..4).rev().filter(|&k| k != largest) {
            let size = (packed & 0x1ff) as f32 * std::f32::consts::FRAC_1_SQRT_2 / 511.0;
            q[k] = if packed >> 9 & 1 == 1 { -size } else { size };
            packed >>= 10;
        }
        q[largest] = (1.0 - q.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
        // x y z w in the file, turned half about x
        [q[1], q[2]] = [-q[1], -q[2]];
        for (k, from) in [3, 0, 1, 2].into_iter().enumerate() {
            splats.column_mut(Column::Quat, k)[i] = q[from];
        }
    }
    splats
}

#[test]
fn spz_round_trips_within_half_a_quantisation_step() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.spz");
    let scene = common::random_scene(3, 200, 300);
    let written = spz::write(&path, &scene, 7.5).unwrap();
    let expected = m4_io::scene::instant(&scene.splats, 7.5, scene.time_frames as f64);
    let got = taken_apart(&path);
    assert_eq!((got.n(), written.splats), (expected.n(), expected.n()));
    let far = (0..3)
        .flat_map(|k| expected.column(Column::Mean, k))
        .fold(0f32, |a, v| a.max(v.abs()));
    common::assert_columns(&got, &expected, Column::Mean, far / 8_388_607.0);
    common::assert_columns(&got, &expected, Column::LogScale, 0.5 / 16.0 + 1e-6);
    let sigmoid = |v: f32| 1.0 / (1.0 + (-v).exp());
    let logits = expected.column(Column::Opacity, 0);
    for (opacity, logit) in got.column(Column::Opacity, 0).iter().zip(logits) {
        assert!((opacity - sigmoid(*logit)).abs() < 0.51 / 255.0);
    }
    for c in 0..48 {
        // 5 and 4 bits of harmonics are kept, whose signs are those of the turned axes
        let (tolerance, signed) = match c {
            0..3 => (0.51 / 255.0 / 0.15, true),
            3..12 => (4.51 / 128.0, false),
            _ => (8.51 / 128.0, false),
        };
        let size = |v: f32| if signed { v } else { v.abs() };
        let expected = expected.column(Column::Colour, c);
        for (a, b) in got.column(Column::Colour, c).iter().zip(expected) {
            assert!((size(*a) - size(*b)).abs() <= tolerance, "colour {c}: {a} and {b}");
        }
    }
    common::assert_rotations(&got, &expected, 0.003);
    // the same bytes for the same scene
    let first = std::fs::read(&path).unwrap();
    spz::write(&path, &scene, 7.5).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), first);
}

#[test]
fn unwritable_scenes_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("x.spz");
    let mut scene = asymmetric_scene(0);
    let error = spz::write(&path, &scene, f64::NAN).unwrap_err().to_string();
    assert!(error.contains("t = NaN"), "{error}");
    scene.splats.column_mut(Column::Mean, 1)[0] = 1e7;
    let error = spz::write(&path, &scene, 0.0).unwrap_err().to_string();
    assert!(error.contains("splat 0") && error.contains("axis 1"), "{error}");
    let left = std::fs::read_dir(dir.path()).unwrap().count();
    assert_eq!(left, 0, "nothing is left behind");
}
