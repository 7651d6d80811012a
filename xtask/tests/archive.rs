//! Archives are the same bytes for the same files, and licences are complete.

use std::io::Read;
use xtask::archive::{Date, Item, names, sum_line, tar_gz, zip};
use xtask::licences::{Linked, document};

const DATE: Date = Date {
    unix_s: 1_700_000_000,
    parts: [2023, 11, 14, 22, 13, 20],
};

fn items() -> Vec<Item> {
    [("minute4d", true), ("manual/man1/minute4d.1", false)]
        .map(|(name, program)| Item {
            name: name.to_owned(),
            bytes: name.repeat(1000).into_bytes(),
            program,
        })
        .to_vec()
}

#[test]
fn tar_file_has_the_files_and_nothing_of_this_machine() {
    let bytes = tar_gz("minute4d-1", &items(), DATE).unwrap();
    let mut archive = tar::Archive::new(flate2::read::GzDecoder::new(&bytes[..]));
    let entries = archive.entries().unwrap().map(|entry| {
        let mut entry = entry.unwrap();
        let path = entry.path().unwrap().display().to_string();
        let mut contents = String::new();
        entry.read_to_string(&mut contents).unwrap();
        let header = entry.header();
        assert_eq!(header.mtime().unwrap(), DATE.unix_s);
        assert_eq!((header.uid().unwrap(), header.gid().unwrap()), (0, 0));
        (path, header.mode().unwrap(), contents)
    });
    let want = [
        ("minute4d-1/minute4d", 0o755, "minute4d"),
        (
            "minute4d-1/manual/man1/minute4d.1",
            0o644,
            "manual/man1/minute4d.1",
        ),
    ];
    let want = want.map(|(path, mode, word)| (path.to_owned(), mode, word.repeat(1000)));
    assert_eq!(entries.collect::<Vec<_>>(), want);
}

#[test]
fn zip_file_has_the_files_and_their_date() {
    let bytes = zip("minute4d-1", &items(), DATE).unwrap();
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap();
    assert_eq!(archive.len(), 2);
    let mut program = archive.by_name("minute4d-1/minute4d").unwrap();
    let date = program.last_modified().unwrap();
    assert_eq!((date.year(), date.month(), date.second()), (2023, 11, 20));
    let mut contents = String::new();
    program.read_to_string(&mut contents).unwrap();
    assert_eq!(contents, "minute4d".repeat(1000));
}

#[test]
fn sums_are_those_of_sha256sum() {
    // FIPS 180-2, B.1
    assert_eq!(
        sum_line("a", b"abc"),
        "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad  a\n"
    );
}

#[test]
fn binstall_asks_for_the_archives() {
    let metadata = xtask::command::metadata(&m4_testkit::repository()).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    let package = packages.iter().find(|p| p["name"] == "minute4d_cli");
    let places = &package.unwrap()["metadata"]["binstall"];
    let windows = "x86_64-pc-windows-msvc";
    for (target, own) in [
        ("x86_64-unknown-linux-gnu", places),
        (windows, &places["overrides"][windows]),
    ] {
        let (folder, file) = names("1.2.3", target);
        let of = |text: &serde_json::Value| {
            let text = text.as_str().unwrap();
            let text = text.replace("{ version }", "1.2.3");
            text.replace("{ target }", target)
        };
        let url = of(&own["pkg-url"]);
        assert_eq!(url, format!("{{ repo }}/releases/download/v1.2.3/{file}"));
        let inside = of(&places["bin-dir"]);
        assert_eq!(inside, format!("{folder}/{{ bin }}{{ binary-ext }}"));
    }
}

fn linked(name: &str, licence: &str, texts: &[&str]) -> Linked {
    Linked {
        name: format!("{name} 1.0.0"),
        licence: licence.to_owned(),
        repository: None,
        authors: vec![format!("Author of {name}")],
        texts: texts.iter().map(|&text| text.to_owned()).collect(),
    }
}

#[test]
fn every_package_has_a_text_and_every_text_is_there_once() {
    let packages = [
        linked("one", "BSD-2-Clause", &["the BSD terms"]),
        linked(
            "two",
            "MIT OR Apache-2.0",
            &["the Apache terms", "the MIT terms of two"],
        ),
        linked("three", "MIT OR Apache-2.0", &[]),
        linked("four", "BSD-2-Clause", &[]),
    ];
    let own = [("Apache-2.0", "the Apache terms")];
    let text = document(&packages, &own).unwrap();
    for terms in ["the BSD terms", "the Apache terms", "the MIT terms of two"] {
        assert_eq!(text.matches(terms).count(), 1, "{text}");
    }
    let apache = text
        .split("====\n")
        .find(|s| s.contains("the Apache terms"))
        .unwrap();
    assert!(
        apache.contains("two 1.0.0") && apache.contains("copyright Author of three"),
        "{apache}"
    );
    let bsd = text
        .split("====\n")
        .find(|s| s.contains("the BSD terms"))
        .unwrap();
    assert!(
        bsd.contains("one 1.0.0") && bsd.contains("copyright Author of four"),
        "{bsd}"
    );

    let alone = [linked("five", "ISC", &[])];
    let error = document(&alone, &own).unwrap_err().to_string();
    assert!(error.contains("five") && error.contains("ISC"), "{error}");
}
