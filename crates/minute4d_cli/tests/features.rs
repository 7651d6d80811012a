//! What needs a feature that is not built in says so, and how to build it in.

#[cfg(not(all(feature = "gpu", feature = "nets")))]
use crate::common::refused;
#[cfg(not(all(feature = "gpu", feature = "nets")))]
use minute4d::BUILD_FULL;

#[cfg(not(feature = "gpu"))]
#[test]
fn gpu_request_without_the_feature_names_the_build_command() {
    let words = ["without GPU support", BUILD_FULL, "--device cpu"];
    let clip = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/pinwheel.mp4");
    let out = crate::common::Scratch::new().at("out");
    for command in [
        &["run", clip, "-o", &out, "--device", "gpu"][..],
        &["bench", "--quick", "--device", "gpu:0"],
    ] {
        refused(command, 69, &words);
    }
}

#[cfg(not(feature = "nets"))]
#[test]
fn networks_without_the_feature_name_the_build_command() {
    let clip = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/pinwheel.mp4");
    let dir = crate::common::Scratch::new();
    // a folder each: what one command leaves is not the next one's
    let outs: Vec<String> = (0..4).map(|k| dir.at(&format!("out{k}"))).collect();
    let cases = [
        (
            vec!["geometry", clip, "-o", &outs[0], "--frontend", "megasam"],
            "--frontend classical",
        ),
        (
            vec!["run", clip, "-o", &outs[1], "--frontend", "raft"],
            "--frontend classical",
        ),
        (
            vec!["geometry", clip, "-o", &outs[2], "--segmenter", "sam2"],
            "--segmenter none",
        ),
        (
            vec!["geometry", clip, "-o", &outs[3], "--tracker", "tapip3d"],
            "--tracker flow",
        ),
    ];
    for (command, instead) in cases {
        refused(&command, 69, &["without networks", BUILD_FULL, instead]);
    }
    // a command of its own, which has no events
    for command in [
        &["weights", "list"][..],
        &["weights", "fetch", "mobile-sam", "--accept-license"],
    ] {
        let ended = crate::common::call(command);
        assert_eq!(ended.code, 69, "{command:?}: {}", ended.stderr);
        assert!(
            ended.stderr.contains("without networks") && ended.stderr.contains(BUILD_FULL),
            "{}",
            ended.stderr
        );
    }
}
