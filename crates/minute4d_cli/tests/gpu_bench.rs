//! `minute4d bench --device gpu:N`, on a software Vulkan driver (lavapipe) where there is nothing better.
#![cfg(feature = "gpu")]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{Scratch, refused, succeed};
use m4_testkit::{Need, skip};
use std::fs;

const SMALL: [&str; 8] = [
    "bench", "--device", "gpu:0", "--splats", "500", "--size", "64x48", "--steps",
];

#[track_caller]
fn is_there() -> bool {
    let gpus = succeed(&["doctor", "--json"]).result()["gpus"]
        .as_array()
        .unwrap()
        .len();
    if gpus == 0 {
        skip(Need::Vulkan, "there is no GPU, nor software that plays one");
    }
    gpus > 0
}

#[test]
fn gpu_bench_reports_the_same_columns() {
    if !is_there() {
        return;
    }
    let dir = Scratch::new();
    let runs = dir.at("runs");
    let more = ["1", "--scene", "static", "--json", "--save", &runs];
    let report = succeed(&[&SMALL[..], &more[..]].concat()).result();
    assert!(!report["machine"]["gpu"]["name"].as_str().unwrap().is_empty());
    let case = &report["cases"][0];
    assert_eq!(case["kernels"].as_array().unwrap().len(), 7);
    for kernel in case["kernels"].as_array().unwrap() {
        assert!(kernel["ms"].as_f64().unwrap() > 0.0, "{kernel}");
    }
    let [first, last] = [0, 1].map(|i| case["step"]["loss"][i].as_f64().unwrap());
    assert!(last < first, "{case}");
    let bytes = |name: &str| case["gpu"][name].as_f64().unwrap();
    assert!(bytes("reserved_bytes") >= bytes("in_use_bytes"), "{case}");
    // the rest is what density control would take
    assert!(
        (0.7..1.1).contains(&(bytes("in_use_bytes") / bytes("planned_bytes"))),
        "{case}"
    );
    let names: Vec<_> = fs::read_dir(dir.path("runs"))
        .unwrap()
        .map(|e| e.unwrap().file_name())
        .collect();
    assert_eq!(names.len(), 2, "{names:?}");
}

#[test]
fn oversized_gpu_bench_is_rejected_with_its_parts() {
    if !is_there() {
        return;
    }
    let parts = ["splats", "moments", "tile lists", "frames", "--max-vram"];
    refused(&[&SMALL[..], &["1", "--max-vram", "1"]].concat(), 69, &parts);
}

#[test]
fn a_gpu_memory_limit_does_not_apply_to_the_cpu() {
    let dir = Scratch::new();
    let out = dir.at("out");
    for command in [
        vec!["bench", "--quick", "--max-vram", "100"],
        vec!["train", "capture", "-o", &out, "--max-vram", "100"],
        vec!["run", "clip.mp4", "-o", &out, "--device", "cpu", "--max-vram", "100"],
    ] {
        refused(&command, 2, &["--max-vram", "--device gpu"]);
    }
    assert!(!dir.path("out").exists(), "nothing was begun");
}
