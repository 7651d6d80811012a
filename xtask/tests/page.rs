//! The page that is kept is the one that its sources build to.

use m4_testkit::{Need, find_chromium, skip};
use xtask::page::{Outcome, compare};

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
