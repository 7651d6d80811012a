//! The same bytes, read by Rust here and by the page's TypeScript in `page/tests/payload.test.ts`:
//! both are compared with the splats that went in, which stand in the fixture in words.

use crate::bound::carried;
use crate::turning::{DISTANCE, turning};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use m4_core::{Column, Exposure, Intrinsics, Scene, SourceFrame, SplatLayout, Splats};
use m4_testkit::{SceneSpec, camera_looking_at, random_splats};
use m4_viewer::payload::{decode, encode};
use serde_json::{Value, json};
use std::path::PathBuf;

const FRAMES: usize = 10;
const MEDIAN_DEPTH: f64 = 4.0;

fn scene(layout: SplatLayout) -> Scene {
    let camera = camera_looking_at(
        Intrinsics::centred(160, 120, 140.0),
        [0.3, 0.1, -0.5],
        [0.0, 0.0, 4.0],
    );
    let spec = SceneSpec {
        layout,
        n_static: 7,
        n_dynamic: 5,
        time_frames: FRAMES,
        ..SceneSpec::default()
    };
    Scene {
        splats: random_splats(21, &camera, &spec),
        background: [0.0; 3],
        time_frames: FRAMES,
        duration_s: None,
        mip: true,
        near: 0.05,
        source: vec![SourceFrame {
            camera,
            t: 0.0,
            exposure: Exposure::IDENTITY,
            distance_sigma: None,
        }],
    }
}

fn layouts() -> [(&'static str, SplatLayout); 3] {
    let layout = |isotropic, sh_degree, time_degree| SplatLayout {
        isotropic,
        sh_degree,
        time_degree,
    };
    [
        ("plain", layout(false, 0, 0)),
        ("isotropic", layout(true, 0, 0)),
        ("harmonics", layout(false, 2, 1)),
    ]
}

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/payload/{name}.json"))
}

/// Columns of one parameter, splat by splat, after a map.
fn values(splats: &Splats, column: Column, map: impl Fn(f64) -> f64) -> Vec<f64> {
    let columns: Vec<&[f32]> = (0..splats.layout().range(column).len())
        .map(|k| splats.column(column, k))
        .collect();
    let rows = columns.first().map_or(0, |c| c.len());
    (0..rows)
        .flat_map(|row| columns.iter().map(move |c| f64::from(c[row])))
        .map(map)
        .collect()
}

/// The splats in the page's units.
fn words(splats: &Splats) -> Value {
    let same = |v| v;
    let quat: Vec<f64> = values(splats, Column::Quat, same)
        .chunks(4)
        .flat_map(|q| {
            let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            q.iter().map(move |v| v / length).collect::<Vec<f64>>()
        })
        .collect();
    json!({
        "mean": values(splats, Column::Mean, same),
        "scale": values(splats, Column::LogScale, f64::exp),
        "quat": quat,
        "opacity": values(splats, Column::Opacity, |v| 1.0 / (1.0 + (-v).exp())),
        "colour": values(splats, Column::Colour, same),
        "time_mean": values(splats, Column::TimeMean, same),
        "time_sd": values(splats, Column::LogTimeSd, f64::exp),
        "velocity": values(splats, Column::Velocity, same),
    })
}

fn fixture(name: &str, layout: SplatLayout) -> Value {
    let scene = scene(layout);
    let payload = encode(&scene, MEDIAN_DEPTH);
    json!({
        "name": name,
        "splats": {
            "static": payload.n_static,
            "dynamic": payload.n_dynamic,
            "sh_degree": layout.sh_degree,
            "time_degree": layout.time_degree,
            "isotropic": layout.isotropic,
            "bytes": payload.bytes.len(),
        },
        "expected": words(&scene.splats),
        "payload": STANDARD.encode(&payload.bytes),
    })
}

/// A scene with bound splats as bytes, with poses of its nodes and what they make of splats at some
/// times, by the definition of the renderer.
fn turning_fixture() -> Value {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 1,
        time_degree: 0,
    };
    let payload = encode(&turning(layout, 60, 180, 40), DISTANCE);
    let back = decode(&payload.bytes).unwrap();
    let times = [0.0, 0.4, 3.0, 4.7, 6.5, 8.9];
    let mut poses = Vec::new();
    for (w, window) in back.windows().iter().enumerate() {
        for (node, t) in (0..window.anchors().len()).zip(times.iter().cycle()) {
            let pose = window.pose(node, *t as f32);
            poses
                .push(json!({"window": w, "node": node, "t": t, "position": pose.position, "rotation": pose.rotation}));
        }
    }
    let sigmoid = |v: f64| 1.0 / (1.0 + (-v).exp());
    let mut splats = Vec::new();
    for (i, t) in (0..payload.n_bound).step_by(4).zip(times.iter().cycle()) {
        splats.push(match carried(&back, i, *t) {
            None => json!({"splat": i, "t": t}),
            Some(c) => json!({
                "splat": i,
                "t": t,
                "mean": c.mean.as_slice(),
                "quat": c.quat.normalize().as_slice(),
                "opacity": sigmoid(c.logit),
                "colour": c.rgb.as_slice(),
            }),
        });
    }
    json!({
        "name": "turning",
        "splats": {
            "static": payload.n_static,
            "dynamic": payload.n_dynamic,
            "bound": payload.n_bound,
            "sh_degree": layout.sh_degree,
            "time_degree": layout.time_degree,
            "isotropic": layout.isotropic,
            "bytes": payload.bytes.len(),
        },
        "poses": poses,
        "carried": splats,
        "payload": STANDARD.encode(&payload.bytes),
    })
}

/// Writes the fixtures: `cargo test -p m4_viewer --test it payload_fixture -- --ignored`.
#[test]
#[ignore = "writes the fixtures that the other test and the page read"]
fn write_fixtures() {
    for (name, layout) in layouts() {
        let text = serde_json::to_string(&fixture(name, layout)).unwrap();
        std::fs::write(path(name), text + "\n").unwrap();
    }
    std::fs::write(
        path("turning"),
        serde_json::to_string(&turning_fixture()).unwrap() + "\n",
    )
    .unwrap();
}

#[test]
fn the_fixture_of_bound_splats_matches_the_writer() {
    let fixture: Value = serde_json::from_slice(&std::fs::read(path("turning")).unwrap()).unwrap();
    let written = turning_fixture();
    for part in ["splats", "payload"] {
        assert_eq!(
            fixture[part], written[part],
            "write the fixtures again if the layout was changed"
        );
    }
    let numbers = |list: &Value| -> Vec<f64> {
        let fields = |entry: &Value| {
            entry
                .as_object()
                .unwrap()
                .values()
                .cloned()
                .collect::<Vec<Value>>()
        };
        let flat = |v: Value| v.as_array().cloned().unwrap_or_else(|| vec![v]);
        list.as_array()
            .unwrap()
            .iter()
            .flat_map(fields)
            .flat_map(flat)
            .map(|v| v.as_f64().unwrap())
            .collect()
    };
    for part in ["poses", "carried"] {
        let (a, b) = (numbers(&fixture[part]), numbers(&written[part]));
        assert!(a.len() == b.len() && a.len() > 100, "{part}");
        // sines may differ in the last bit from machine to machine
        assert!(
            a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-5),
            "{part}"
        );
    }
}

#[test]
fn payload_fixtures_match_the_writer() {
    for (name, layout) in layouts() {
        let fixture: Value = serde_json::from_slice(&std::fs::read(path(name)).unwrap()).unwrap();
        let bytes = STANDARD
            .decode(fixture["payload"].as_str().unwrap())
            .unwrap();
        let written = encode(&scene(layout), MEDIAN_DEPTH);
        assert_eq!(
            bytes, written.bytes,
            "{name}: write the fixtures again if the layout was changed"
        );
        let back = words(&decode(&bytes).unwrap());
        // what half a step makes of each, see the tests of the payload
        let within = [
            ("mean", 1e-3, 0.0),
            ("scale", 0.0, 0.028),
            ("opacity", 0.00197, 0.0),
            ("colour", 0.007, 0.0),
            ("time_mean", 1e-3, 0.0),
            ("time_sd", 0.0, 0.01),
            ("velocity", 1e-4, 0.02),
        ];
        for (column, absolute, relative) in within {
            let list = |v: &Value| v[column].as_array().unwrap().clone();
            let (a, b) = (list(&fixture["expected"]), list(&back));
            assert!(a.len() == b.len() && !a.is_empty(), "{name}: {column}");
            for (a, b) in a.iter().zip(&b) {
                let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
                assert!(
                    (a - b).abs() <= absolute + relative * a.abs(),
                    "{name}: {column} {a} {b}"
                );
            }
        }
    }
}
