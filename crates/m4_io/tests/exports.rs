//! glTF and SPZ: bytes worked out by hand, and files taken apart.

use crate::common::{says, temporary};
use m4_core::nalgebra::{Matrix3, Vector3, Vector4};
use m4_core::{
    Camera, Column, Exposure, Intrinsics, Scene, Se3, SourceFrame, SplatLayout, Splats, quat,
};
use m4_io::scene::{fourdgs, gltf, splatv, spz};
use m4_testkit::SceneSpec;
use serde_json::Value;
use std::io::Read;

/// One static and one dynamic splat, nothing symmetric, numbers that are easy by hand:
///
/// ```text
/// still   mean (1, 2, 6), ln scales -1 -2 -3, a quarter of a turn about y, opacity 0.8, c = (1, 0, -1)
/// moving  mean (-1, 0.5, 3) at frame 2, velocity (0.25, 0, -0.5), ln scales -4, no rotation,
///         opacity 0.5, sd in time 2 frames, c = (0, 2, 0.5)
/// ```
///
/// 9 frames in 2 seconds; the camera of frame i stands at (i, 0, 0) and looks along z.
fn asymmetric_scene(sh_degree: usize) -> Scene {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree,
        time_degree: 0,
    };
    let mut splats = Splats::zeros(layout, 1, 1);
    let mut put = |column, offset, values: [f32; 2]| {
        splats.column_mut(column, offset).copy_from_slice(&values)
    };
    for (k, values) in [[1.0, -1.0], [2.0, 0.5], [6.0, 3.0]]
        .into_iter()
        .enumerate()
    {
        put(Column::Mean, k, values);
    }
    for (k, values) in [[-1.0, -4.0], [-2.0, -4.0], [-3.0, -4.0]]
        .into_iter()
        .enumerate()
    {
        put(Column::LogScale, k, values);
    }
    let h = std::f32::consts::FRAC_1_SQRT_2;
    // y a little more than w, so that which is the largest does not hang on rounding
    for (k, values) in [[h, 1.0], [0.0, 0.0], [h * 1.0001, 0.0], [0.0, 0.0]]
        .into_iter()
        .enumerate()
    {
        put(Column::Quat, k, values);
    }
    put(Column::Opacity, 0, [4f32.ln(), 0.0]);
    for (k, values) in [[1.0, 0.0], [0.0, 2.0], [-1.0, 0.5]]
        .into_iter()
        .enumerate()
    {
        put(Column::Colour, k, values);
    }
    splats.column_mut(Column::TimeMean, 0)[0] = 2.0;
    splats.column_mut(Column::LogTimeSd, 0)[0] = 2f32.ln();
    splats.column_mut(Column::Velocity, 0)[0] = 0.25;
    splats.column_mut(Column::Velocity, 2)[0] = -0.5;
    let source = (0..9)
        .map(|i| SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics {
                    width: 64,
                    height: 48,
                    fx: 80.0,
                    fy: 75.0,
                    cx: 30.0,
                    cy: 25.0,
                },
                c2w: Se3 {
                    rotation: Matrix3::identity(),
                    translation: Vector3::new(f64::from(i), 0.0, 0.0),
                },
            },
            t: f64::from(i),
            exposure: Exposure::IDENTITY,
            distance_sigma: None,
        })
        .collect();
    Scene {
        splats,
        background: [0.0; 3],
        time_frames: 9,
        duration_s: Some(2.0),
        mip: true,
        near: 0.25,
        source,
    }
}

/// Any numbers, the same on every run; 16 frames, and colours that no format clips.
fn random_scene() -> Scene {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 3,
        time_degree: 0,
    };
    let spec = SceneSpec {
        layout,
        n_static: 200,
        n_dynamic: 300,
        time_frames: 16,
        ..SceneSpec::default()
    };
    let mut scene = m4_testkit::random_scene(&spec);
    let colours = layout.range(Column::Colour);
    for column in scene
        .splats
        .columns_mut()
        .skip(colours.start)
        .take(colours.len())
    {
        column.iter_mut().for_each(|v| *v = v.clamp(-0.9, 0.9));
    }
    scene
}

/// Every value of a parameter within a tolerance.
fn assert_columns(got: &Splats, expected: &Splats, column: Column, tolerance: f32) {
    for c in 0..expected.layout().range(column).len() {
        for (i, (a, b)) in got
            .column(column, c)
            .iter()
            .zip(expected.column(column, c))
            .enumerate()
        {
            assert!(
                (a - b).abs() <= tolerance,
                "{column:?} {c} of splat {i}: {a} and {b}"
            );
        }
    }
}

/// Every rotation matrix within a tolerance: `q` and `-q` are one.
fn assert_rotations(got: &Splats, expected: &Splats, tolerance: f64) {
    let rotation = |s: &Splats, i: usize| {
        quat::rotation(
            &Vector4::from_fn(|k, _| f64::from(s.column(Column::Quat, k)[i])).normalize(),
        )
    };
    for i in 0..expected.n() {
        let off = (rotation(got, i) - rotation(expected, i)).amax();
        assert!(off <= tolerance, "rotation of splat {i} is off by {off}");
    }
}

/// The JSON and the binary chunk.
fn parts(bytes: &[u8]) -> (Value, &[u8]) {
    let len = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (
        serde_json::from_slice(&bytes[20..20 + len]).unwrap(),
        &bytes[28 + len..],
    )
}

/// An attribute by what the JSON says of it, `width` numbers per splat.
fn attribute(json: &Value, bin: &[u8], name: &str, width: usize) -> Vec<Vec<f32>> {
    let accessor = &json["meshes"][0]["primitives"][0]["attributes"][name];
    let accessor = &json["accessors"][accessor.as_u64().unwrap() as usize];
    assert_eq!(accessor["componentType"], 5126);
    let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let start = view["byteOffset"].as_u64().unwrap() as usize;
    let rows = accessor["count"].as_u64().unwrap() as usize;
    let number = |i: usize| f32::from_le_bytes(bin[start + 4 * i..][..4].try_into().unwrap());
    (0..rows)
        .map(|r| (0..width).map(|k| number(width * r + k)).collect())
        .collect()
}

#[test]
fn the_numbers_of_two_splats() {
    let (_dir, path) = temporary("two.glb");
    let written = gltf::write(&path, &asymmetric_scene(1), 4.0).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!((written.splats, written.bytes), (2, bytes.len() as u64));
    let (json, bin) = parts(&bytes);
    assert_eq!(json["extensionsUsed"][0], "KHR_gaussian_splatting");
    assert_eq!(json["meshes"][0]["primitives"][0]["mode"], 0);
    assert_eq!(
        json["asset"]["extras"]["time_s"], 1.0,
        "frame 4 of 9 in 2 seconds"
    );
    let status = json["asset"]["extras"]["extension_status"]
        .as_str()
        .unwrap();
    assert!(status.contains("ratified by Khronos"), "{status}");
    let of =
        |name: &str, width| attribute(&json, bin, &format!("KHR_gaussian_splatting:{name}"), width);
    // y up and z back; the second moved for two frames
    let position = attribute(&json, bin, "POSITION", 3);
    assert_eq!(position, [[1.0, -2.0, -6.0], [-0.5, -0.5, -2.0]]);
    let bounds = &json["accessors"][0];
    assert_eq!(bounds["min"], serde_json::json!([-0.5, -2.0, -6.0]));
    assert_eq!(bounds["max"], serde_json::json!([1.0, -0.5, -2.0]));
    let close = |got: f32, expected: f32| (got - expected).abs() < 1e-4;
    // a quarter of a turn about y becomes one about -y: (x, y, z, w) = (0, -1, 0, 1)/sqrt(2)
    let h = std::f32::consts::FRAC_1_SQRT_2;
    let rotation = &of("ROTATION", 4)[0];
    assert!(
        [0.0, -h, 0.0, h]
            .iter()
            .zip(rotation)
            .all(|(a, b)| close(*a, *b)),
        "{rotation:?}"
    );
    let scale = &of("SCALE", 3)[0];
    assert!(
        [0.36788, 0.13534, 0.04979]
            .iter()
            .zip(scale)
            .all(|(a, b)| close(*a, *b)),
        "{scale:?}"
    );
    let opacity = of("OPACITY", 1);
    assert!(close(opacity[0][0], 0.8) && close(opacity[1][0], 0.5 * (-0.5f32).exp()));
    assert_eq!(
        of("SH_DEGREE_0_COEF_0", 3),
        [[1.0, 0.0, -1.0], [0.0, 2.0, 0.5]]
    );
    // of degree 1 the coefficients of y and z change their sign, that of x does not
    let mut scene = asymmetric_scene(1);
    for (term, value) in [(1, 0.1), (2, 0.2), (3, 0.3)] {
        scene.splats.column_mut(Column::Colour, 3 * term)[0] = value;
    }
    gltf::write(&path, &scene, 4.0).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let (json, bin) = parts(&bytes);
    for (n, expected) in [-0.1, -0.2, 0.3].into_iter().enumerate() {
        let name = format!("KHR_gaussian_splatting:SH_DEGREE_1_COEF_{n}");
        assert_eq!(attribute(&json, bin, &name, 3)[0], [expected, 0.0, 0.0]);
    }
    // the fallback: 0.5 + 0.2821 (1, 0, -1) and 0.8, times 255
    assert_eq!(&bin[bin.len() - 8..bin.len() - 4], &[199, 128, 56, 204]);
}

#[test]
fn gltf_refuses_instants_without_splats() {
    let (_dir, path) = temporary("nothing.glb");
    let mut scene = asymmetric_scene(0);
    scene.splats = scene.splats.gather(&[1]).unwrap();
    says(
        &gltf::write(&path, &scene, 900.0).unwrap_err(),
        &["no splat is seen at frame 900"],
    );
    scene.splats.column_mut(Column::Velocity, 1)[0] = f32::INFINITY;
    says(
        &gltf::write(&path, &scene, 4.0).unwrap_err(),
        &["splat 0 holds a NaN or infinite value"],
    );
    assert!(!path.exists());
}

fn unpacked(path: &std::path::Path) -> Vec<u8> {
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(std::fs::File::open(path).unwrap())
        .read_to_end(&mut bytes)
        .unwrap();
    bytes
}

#[test]
fn the_bytes_of_two_splats() {
    let (_dir, path) = temporary("two.spz");
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
    // colours 0.5 + 0.2821 c with c = (1, 0, -1): (0.15 c + 0.5) 255 = 166, 128 (127.5 away from
    // 0), 89
    assert_eq!(&bytes[36..39], &[166, 128, 89]);
    // ln scales -1, -2, -3: 9, 8, 7 times 16
    assert_eq!(&bytes[42..45], &[144, 128, 112]);
    // turned half about x after a quarter about y, see the scene: (w, x, y, z) = (1, 0, 1,
    // 0)/sqrt(2) becomes (1, 0, -1, 0)/sqrt(2); y is the largest (index 1) and negative, so all
    // signs turn
    let packed = u32::from_le_bytes([bytes[48], bytes[49], bytes[50], bytes[51]]);
    assert_eq!(packed >> 30, 1);
    assert_eq!(
        packed & 0x3ff,
        1 << 9 | 511,
        "w is -1/sqrt(2) when y is positive"
    );
    assert_eq!(bytes.len(), 16 + 2 * 20);
}

/// The splats of a file of degree 3, by the layout that the format's README gives; opacities from 0
/// to 1, in the axes of the scene but for harmonics.
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
    let [positions, alphas, colours, scales, rotations, harmonics] =
        [9, 1, 3, 3, 4, 45].map(|width| {
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
            splats.column_mut(Column::Colour, k)[i] =
                (f32::from(colours[3 * i + k]) / 255.0 - 0.5) / 0.15;
        }
        splats.column_mut(Column::Opacity, 0)[i] = f32::from(alphas[i]) / 255.0;
        for c in 0..45 {
            splats.column_mut(Column::Colour, 3 + c)[i] =
                (f32::from(harmonics[45 * i + c]) - 128.0) / 128.0;
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
    let (_dir, path) = temporary("scene.spz");
    let scene = random_scene();
    let written = spz::write(&path, &scene, 7.5).unwrap();
    let expected = m4_io::scene::instant(&scene.splats, 7.5, scene.time_frames as f64);
    let got = taken_apart(&path);
    assert_eq!((got.n(), written.splats), (expected.n(), expected.n()));
    let far = (0..3)
        .flat_map(|k| expected.column(Column::Mean, k))
        .fold(0f32, |a, v| a.max(v.abs()));
    assert_columns(&got, &expected, Column::Mean, far / 8_388_607.0);
    assert_columns(&got, &expected, Column::LogScale, 0.5 / 16.0 + 1e-6);
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
            assert!(
                (size(*a) - size(*b)).abs() <= tolerance,
                "colour {c}: {a} and {b}"
            );
        }
    }
    assert_rotations(&got, &expected, 0.003);
    // the same bytes for the same scene
    let first = std::fs::read(&path).unwrap();
    spz::write(&path, &scene, 7.5).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), first);
}

#[test]
fn bound_splats_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("x");
    let scene = m4_testkit::bound_scene(&SceneSpec::default());
    for error in [
        spz::write(&path, &scene, 1.0).unwrap_err(),
        gltf::write(&path, &scene, 1.0).unwrap_err(),
        splatv::write(&path, &scene).unwrap_err(),
        fourdgs::write(&path, &scene).unwrap_err(),
    ] {
        says(
            &error,
            &[
                "20 splats bound to nodes, which this format does not have",
                "pieces",
            ],
        );
    }
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn unwritable_scenes_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("x.spz");
    let mut scene = asymmetric_scene(0);
    says(
        &spz::write(&path, &scene, f64::NAN).unwrap_err(),
        &["t = NaN"],
    );
    scene.splats.column_mut(Column::Mean, 1)[0] = 1e7;
    says(
        &spz::write(&path, &scene, 0.0).unwrap_err(),
        &["splat 0", "axis 1"],
    );
    let left = std::fs::read_dir(dir.path()).unwrap().count();
    assert_eq!(left, 0, "nothing is left behind");
}
