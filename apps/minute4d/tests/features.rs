//! What needs a feature that is not built in says so, and how to build it in.

use crate::common::Scratch;
#[cfg(not(all(feature = "gpu", feature = "nets")))]
use minute4d_cli::BUILD_FULL;

#[cfg(not(all(feature = "gpu", feature = "nets")))]
const CLIP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/pinwheel.mp4");

#[cfg(not(feature = "gpu"))]
#[test]
fn gpu_request_without_the_feature_names_the_build_command() {
    let dir = Scratch::new();
    let words = ["without GPU support", BUILD_FULL, "--device cpu"];
    dir.refused(&format!("run '{CLIP}' -o out --device gpu"), 69, &words);
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

#[test]
fn a_gpu_memory_limit_does_not_apply_to_the_cpu() {
    let dir = Scratch::new();
    for line in [
        "train capture -o out --device cpu --max-vram 100",
        "run clip.mp4 -o out --device cpu --max-vram 100",
    ] {
        dir.refused(line, 2, &["--max-vram", "--device gpu"]);
    }
    assert!(!dir.path("out").exists(), "nothing was begun");
}
