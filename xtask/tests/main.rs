//! The integration tests of this crate, in one program: what is made of the lines that skipped tests leave, and whether the page that
//! is kept is the one that its sources build to.

mod arrows;
mod paper;

use m4_testkit::{Need, find_chromium, skip};
use std::collections::BTreeSet;
use xtask::page::{Outcome, compare};
use xtask::tests::{Tests, lacking, parse, summary};

const LINES: &str = "ffmpeg\tinstall ffmpeg\tvideo::plays\tcrates/m4_io/tests/video.rs:7\tit is not on the PATH\n\
                     vulkan\tinstall a driver\tgpu::draws\tcrates/m4_kernels/tests/gpu/main.rs:3\tno adapter\n\
                     ffmpeg\tinstall ffmpeg\tvideo::plays\tcrates/m4_io/tests/video.rs:7\tit is not on the PATH\n";

#[test]
fn skipped_tests_are_listed_once_with_a_hint() {
    let skipped = parse(LINES).unwrap();
    assert_eq!(skipped.len(), 2);
    let words = summary(&skipped);
    for part in ["2 tests", "for want of ffmpeg: install ffmpeg", "gpu::draws", "video.rs:7", "no adapter"] {
        assert!(words.contains(part), "{part}: {words}");
    }
    assert!(summary(&[]).contains("Every test could run"));
    assert!(parse("ffmpeg\tinstall it\n").is_err());
}

#[test]
fn missing_requirements_fail_the_run() {
    let skipped = parse(LINES).unwrap();
    let required = |names: &[&str]| names.iter().map(|&n| n.to_owned()).collect::<BTreeSet<_>>();
    assert!(lacking(&skipped, &required(&[])).is_ok());
    assert!(lacking(&skipped, &required(&["chromium"])).is_ok());
    let error = lacking(&skipped, &required(&["chromium", "vulkan"])).unwrap_err();
    assert!(error.to_string().contains("vulkan"), "{error}");
}

#[test]
fn arguments_are_read() {
    let tests = Tests::of_arguments(&["--full", "--require", "ffmpeg,vulkan", "--", "--test", "it"]).unwrap();
    assert!(tests.full && tests.required.contains("vulkan") && tests.required.len() == 2);
    assert_eq!(tests.more, ["--test", "it"]);
    assert!(Tests::of_arguments(&["--fast"]).is_err() && Tests::of_arguments(&["--require"]).is_err());
}

#[test]
fn committed_page_matches_its_sources() {
    // Without one nothing is clicked: listed, and the rest continues.
    let _ = find_chromium();
    let root = xtask::root();
    let work = root.join("target/page");
    match compare(&root, &work).unwrap() {
        Outcome::Same => {}
        Outcome::Skipped { reason } => skip(Need::Npm, &reason),
        differs @ Outcome::Differs { .. } => panic!("{differs:?}: run `cargo xtask page` and commit what it writes"),
    }
}
