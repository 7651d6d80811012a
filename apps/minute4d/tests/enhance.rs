//! Enhancement from outside.

#[cfg(feature = "nets")]
use crate::common::{Ended, capture};
use crate::common::{Scratch, read_capture, write_capture};
use m4_io::capture::Split;
#[cfg(feature = "nets")]
use minute4d::Silent;
use minute4d_cli::BUILD_FULL;
#[cfg(feature = "nets")]
use std::fs;

#[test]
fn points_are_tracked_without_weights() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let line = "enhance capture -o better --segmenter none";
    let report = dir
        .succeed(&format!("{line} --tracker flow --json"))
        .result()["record"]
        .clone();
    assert_eq!(
        (&report["segmenter"], &report["tracker"]),
        (&"none".into(), &"flow".into())
    );
    let (before, after) = (
        read_capture(&dir.path("capture"), Split::Train),
        read_capture(&dir.path("better"), Split::Train),
    );
    assert_eq!(before.frames.len(), after.frames.len());
    let count = after.tracks.as_ref().map_or(0, |tracks| tracks.count());
    assert_eq!(report["tracks"], count);
    assert!(count > 0, "{report}");
    for (a, b) in before.frames.iter().zip(&after.frames) {
        assert_eq!((&a.rgb, &a.mask), (&b.rgb, &b.mask));
    }
    // another is not written over it
    dir.refused(line, 73, &["--force"]);
}

#[test]
fn impossible_enhancements_are_rejected_with_a_reason() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let without = ["without networks", BUILD_FULL];
    let of_networks = |line: &str, words: &[&str]| match cfg!(feature = "nets") {
        true => dir.refused(line, 66, words),
        false => dir.refused(line, 69, &without),
    };
    let line = "enhance capture -o out --segmenter none --tracker none";
    dir.refused(line, 2, &["nothing to do"]);
    of_networks(
        "enhance capture -o out --segmenter sam2",
        &["weights fetch sam2.1-large", "--segmenter none"],
    );
    of_networks(
        "enhance capture -o out --tracker tapip3d",
        &["weights fetch tapip3d", "--tracker flow"],
    );
    dir.refused("enhance nowhere -o out", 66, &["nowhere"]);
    assert!(!dir.path("out").exists());
}

/// Networks with synthetic weights: only that they run and return is tested.
#[cfg(feature = "nets")]
#[test]
fn networks_enhance_a_capture() {
    use m4_testkit::{FormulaWeights, write_formula_weights};
    let dir = Scratch::new();
    let store = dir.path("weights");
    for name in ["sam2.1-tiny", "tapip3d"] {
        fs::create_dir_all(store.join(name)).unwrap();
    }
    let tiny = include_str!("../../../fixtures/sam2/tiny.keys.txt");
    write_formula_weights(tiny, &store.join("sam2.1-tiny/sam2.1_hiera_tiny.pt"));
    let keys = include_str!("../../../fixtures/tapip3d/keys.txt");
    let config = include_str!("../../../fixtures/tapip3d/config.json");
    FormulaWeights::of_keys(keys)
        .scaled("point_updater.flow_head.weight", 0.005)
        .write_with(
            Some(("config", config)),
            &store.join("tapip3d/tapip3d_final.pth"),
        );
    m4_io::capture::write(
        &dir.path("capture"),
        &capture(3, false),
        Split::Train,
        &Silent,
    )
    .unwrap();
    let line = "enhance capture -o better --json --segmenter sam2 --tracker tapip3d --set enhance.tapip3d.size=1.0 \
                --set enhance.tapip3d.iterations=1 --set enhance.tapip3d.most=40 --set enhance.tapip3d.every=1";
    let mut command = dir.command(line);
    let ended = Ended::of(command.env("MINUTE4D_WEIGHTS", &store).output().unwrap());
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    let report = ended.result()["record"].clone();
    assert_eq!(
        (&report["segmenter"], &report["tracker"]),
        (&"sam2".into(), &"tapip3d".into())
    );
    let networks: Vec<&str> = report["networks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|n| n["weights"].as_str().unwrap())
        .collect();
    assert_eq!(networks, ["sam2.1-tiny", "tapip3d"]);
    assert_eq!(report["networks"][1]["commercial"], false);
    assert!(report["tracks"].as_u64().unwrap() > 0, "{report}");
    assert_eq!(
        dir.json("better/instances.json")["segmenter"],
        "sam2.1-tiny"
    );
    let better = read_capture(&dir.path("better"), Split::Train);
    assert!(
        better
            .frames
            .iter()
            .all(|frame| frame.instances.is_some() && frame.mask.is_some())
    );
}
