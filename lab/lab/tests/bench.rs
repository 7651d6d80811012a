//! Benchmarks, on a software Vulkan driver (lavapipe) where there is nothing better.

use crate::common::Scratch;
#[cfg(feature = "gpu")]
use m4_testkit::{Need, skip};

#[test]
fn every_case_has_its_kernels() {
    let dir = Scratch::new();
    let line = "bench --splats 500,1000 --size 96x72 --steps 1 --threads 1 --json";
    let bench = dir.succeed(line).result();
    let cases = bench["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 4, "two sizes, two scenes: {bench}");
    for case in cases {
        assert!(
            case["step"]["ms"].as_f64().unwrap() > 0.0
                && case["frames_per_s"].as_f64().unwrap() > 0.0
        );
        assert!(
            (0.0..1.0).contains(&case["useful_share"].as_f64().unwrap()),
            "{case}"
        );
        assert_eq!(case["kernels"].as_array().unwrap().len(), 7);
    }
}

#[test]
fn a_gpu_is_needed_for_its_options() {
    let dir = Scratch::new();
    let line = "bench --quick --max-vram 100";
    dir.refused(line, 2, &["--max-vram", "--device gpu"]);
    #[cfg(not(feature = "gpu"))]
    dir.refused("bench --quick --device gpu:0", 69, &["without GPU support"]);
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
