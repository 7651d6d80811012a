//! What needs a feature that is not built in says so, and how to build it in; benchmarks with it,
//! on a software Vulkan driver (lavapipe) where there is nothing better.

use crate::common::Scratch;
#[cfg(feature = "gpu")]
use m4_testkit::{Need, skip};
#[cfg(not(all(feature = "gpu", feature = "nets")))]
use minute4d::BUILD_FULL;

#[cfg(not(all(feature = "gpu", feature = "nets")))]
const CLIP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/pinwheel.mp4");

#[cfg(not(feature = "gpu"))]
#[test]
fn gpu_request_without_the_feature_names_the_build_command() {
    let dir = Scratch::new();
    let words = ["without GPU support", BUILD_FULL, "--device cpu"];
    dir.refused(&format!("run '{CLIP}' -o out --device gpu"), 69, &words);
    dir.refused("bench --quick --device gpu:0", 69, &words);
}

#[cfg(not(feature = "nets"))]
#[test]
fn networks_without_the_feature_name_the_build_command() {
    let dir = Scratch::new();
    // a folder each: what one command leaves is not the next one's
    for (command, options, instead) in [
        (
            "geometry",
            "-o out0 --frontend megasam",
            "--frontend classical",
        ),
        ("run", "-o out1 --frontend raft", "--frontend classical"),
        ("geometry", "-o out2 --segmenter sam2", "--segmenter none"),
        ("geometry", "-o out3 --tracker tapip3d", "--tracker flow"),
    ] {
        let words = ["without networks", BUILD_FULL, instead];
        dir.refused(&format!("{command} '{CLIP}' {options}"), 69, &words);
    }
    // a command of its own, which has no events
    for line in ["weights list", "weights fetch mobile-sam --accept-license"] {
        let ended = dir.call(line);
        assert_eq!(ended.code, 69, "{line}: {}", ended.stderr);
        assert!(
            ended.stderr.contains("without networks") && ended.stderr.contains(BUILD_FULL),
            "{}",
            ended.stderr
        );
    }
}

#[cfg(feature = "gpu")]
const SMALL: &str = "bench --device gpu:0 --splats 500 --size 64x48 --steps 1";

#[cfg(feature = "gpu")]
#[track_caller]
fn is_there(dir: &Scratch) -> bool {
    let doctor = dir.succeed("doctor --json").result();
    let has_gpu = !doctor["gpus"][0].is_null();
    if !has_gpu {
        skip(Need::Vulkan, "there is no GPU, nor software that plays one");
    }
    has_gpu
}

#[cfg(feature = "gpu")]
#[test]
fn gpu_bench_reports_the_same_columns() {
    let dir = Scratch::new();
    if !is_there(&dir) {
        return;
    }
    let report = dir
        .succeed(&format!("{SMALL} --scene static --json"))
        .result();
    assert!(
        !report["machine"]["gpu"]["name"]
            .as_str()
            .unwrap()
            .is_empty()
    );
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
}

#[cfg(feature = "gpu")]
#[test]
fn oversized_gpu_bench_is_rejected_with_its_parts() {
    let dir = Scratch::new();
    if is_there(&dir) {
        let parts = ["splats", "moments", "tile lists", "frames", "--max-vram"];
        dir.refused(&format!("{SMALL} --max-vram 1"), 69, &parts);
    }
}

#[test]
fn a_gpu_memory_limit_does_not_apply_to_the_cpu() {
    let dir = Scratch::new();
    for line in [
        "bench --quick --max-vram 100",
        "train capture -o out --device cpu --max-vram 100",
        "run clip.mp4 -o out --device cpu --max-vram 100",
    ] {
        dir.refused(line, 2, &["--max-vram", "--device gpu"]);
    }
    assert!(!dir.path("out").exists(), "nothing was begun");
}
