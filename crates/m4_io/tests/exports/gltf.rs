//! glTF: bytes worked out by hand, and files taken apart.

use super::common::{self, asymmetric_scene};
use m4_core::Column;
use m4_io::scene::gltf;
use serde_json::Value;

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
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("two.glb");
    let written = gltf::write(&path, &asymmetric_scene(1), 4.0).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!((written.splats, written.bytes), (2, bytes.len() as u64));
    let (json, bin) = parts(&bytes);
    assert_eq!(json["extensionsUsed"][0], "KHR_gaussian_splatting");
    assert_eq!(json["meshes"][0]["primitives"][0]["mode"], 0);
    assert_eq!(json["asset"]["extras"]["time_s"], 1.0, "frame 4 of 9 in 2 seconds");
    let status = json["asset"]["extras"]["extension_status"].as_str().unwrap();
    assert!(status.contains("Release Candidate"), "{status}");
    let of = |name: &str, width| attribute(&json, bin, &format!("KHR_gaussian_splatting:{name}"), width);
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
        [0.0, -h, 0.0, h].iter().zip(rotation).all(|(a, b)| close(*a, *b)),
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
    assert_eq!(of("SH_DEGREE_0_COEF_0", 3), [[1.0, 0.0, -1.0], [0.0, 2.0, 0.5]]);
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
fn gltf_holds_the_parameters_of_the_scene() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.glb");
    for degree in 0..=3 {
        let scene = common::random_scene(degree, 100, 150);
        let written = gltf::write(&path, &scene, 7.5).unwrap();
        let expected = m4_io::scene::instant(&scene.splats, 7.5, scene.time_frames as f64);
        assert_eq!(written.splats, expected.n());
        let bytes = std::fs::read(&path).unwrap();
        let (json, bin) = parts(&bytes);
        let of = |name: &str, width| attribute(&json, bin, &format!("KHR_gaussian_splatting:{name}"), width);
        let (position, scale, opacity) = (attribute(&json, bin, "POSITION", 3), of("SCALE", 3), of("OPACITY", 1));
        let colour = of("SH_DEGREE_0_COEF_0", 3);
        assert_eq!(position.len(), expected.n());
        let at = |column, k, i: usize| expected.column(column, k)[i];
        for i in 0..expected.n() {
            for (k, sign) in [1.0, -1.0, -1.0].into_iter().enumerate() {
                assert_eq!(position[i][k], sign * at(Column::Mean, k, i));
                assert_eq!(colour[i][k], at(Column::Colour, k, i));
                let sd = at(Column::LogScale, k, i).exp();
                assert!((scale[i][k] - sd).abs() <= 1e-5 * sd);
            }
            let seen = 1.0 / (1.0 + (-at(Column::Opacity, 0, i)).exp());
            assert!((opacity[i][0] - seen).abs() < 1e-6);
        }
        let length = |q: &Vec<f32>| q.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!(of("ROTATION", 4).iter().all(|q| (length(q) - 1.0).abs() < 1e-5));
        // what the documentation says: 60 bytes per splat and 12 a harmonic, beside the JSON
        let harmonics = (degree + 1) * (degree + 1) - 1;
        assert_eq!(bin.len(), expected.n() * (60 + 12 * harmonics), "{json}");
    }
}

#[test]
fn gltf_refuses_instants_without_splats() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("nothing.glb");
    let mut scene = asymmetric_scene(0);
    scene.splats = scene.splats.gather(&[1]).unwrap();
    let error = gltf::write(&path, &scene, 900.0).unwrap_err().to_string();
    assert!(error.contains("no splat is seen at frame 900"), "{error}");
    scene.splats.column_mut(Column::Velocity, 1)[0] = f32::INFINITY;
    let error = gltf::write(&path, &scene, 4.0).unwrap_err().to_string();
    assert!(error.contains("splat 0 holds a NaN or infinite value"), "{error}");
    assert!(!path.exists());
}
