//! The integration tests of this crate, in one program: the tables of ARCHITECTURE.md and the
//! citations of docs/spec are true and the checks that say so can fail; cycles among modules; what
//! is made of the lines that skipped tests leave; whether the page that is kept is the one that its
//! sources build to.

mod archive;
mod modules;

use m4_testkit::{Need, find_chromium, skip};
use std::collections::{BTreeMap, BTreeSet};
use xtask::arrows::{Actual, Arrows, allowed, violations};
use xtask::page::{Outcome, compare};
use xtask::paper::{self, ITEMS, Row, Sources, dangling, headings, markers, rows};
use xtask::tests::{Tests, lacking, parse, summary};

const LINES: &str = "ffmpeg\tinstall ffmpeg\tvideo::plays\tcrates/m4_io/tests/video.rs:7\tit is not on the PATH\n\
                     vulkan\tinstall a driver\tgpu::draws\tcrates/m4_kernels/tests/gpu/main.rs:3\tno adapter\n\
                     ffmpeg\tinstall ffmpeg\tvideo::plays\tcrates/m4_io/tests/video.rs:7\tit is not on the PATH\n";

#[test]
fn skipped_tests_are_listed_once_with_a_hint() {
    let skipped = parse(LINES).unwrap();
    assert_eq!(skipped.len(), 2);
    let words = summary(&skipped);
    for part in [
        "2 tests",
        "for want of ffmpeg: install ffmpeg",
        "gpu::draws",
        "video.rs:7",
        "no adapter",
    ] {
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
    let tests =
        Tests::of_arguments(&["--full", "--require", "ffmpeg,vulkan", "--", "--test", "it"])
            .unwrap();
    assert!(tests.full && tests.required.contains("vulkan") && tests.required.len() == 2);
    assert_eq!(tests.more, ["--test", "it"]);
    assert!(
        Tests::of_arguments(&["--fast"]).is_err() && Tests::of_arguments(&["--require"]).is_err()
    );
}

#[test]
fn committed_page_matches_its_sources() {
    // Without one nothing is clicked: listed, and the rest continues.
    let chromium = find_chromium();
    let root = xtask::root();
    let work = root.join("target/page");
    match compare(&root, &work, chromium.as_deref()).unwrap() {
        Outcome::Same => {}
        Outcome::Skipped { reason } => skip(Need::Npm, &reason),
        Outcome::Differs => panic!("it does not: run `cargo xtask page` and commit what it writes"),
    }
}

fn set(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|&n| n.to_owned()).collect()
}

fn arrows_of(rows: &[(&str, &[&str])]) -> Arrows {
    rows.iter()
        .map(|&(from, to)| (from.to_owned(), set(to)))
        .collect()
}

const CRATES: &str = "
| crate | what it is |
|---|---|
| `m4_core` | Knows no kernel and no io. |

| crate | may depend on |
|---|---|
| `m4_core` | |
| `m4_kernels` | `m4_core` |
| `m4_io` | `m4_core`, `m4_kernels` |
";

#[test]
fn this_workspace_keeps_to_its_table() {
    xtask::arrows::check(&xtask::root()).unwrap();
}

#[test]
fn nothing_comes_from_git() {
    xtask::arrows::check_lock(&xtask::root()).unwrap();
    let lock = "[[package]]\nname = \"a\"\nsource = \"git+https://example.org/a#1\"\n";
    assert_eq!(
        xtask::arrows::git_sources(lock),
        ["a: git+https://example.org/a#1"]
    );
}

#[test]
fn the_table_is_read() {
    let want = arrows_of(&[
        ("m4_core", &[]),
        ("m4_kernels", &["m4_core"]),
        ("m4_io", &["m4_core", "m4_kernels"]),
    ]);
    assert_eq!(allowed(CRATES), want);
}

#[test]
fn an_arrow_that_points_back_is_found() {
    let may = allowed(CRATES);
    let mut actual = Actual {
        normal: may.clone(),
        dev: arrows_of(&[("m4_io", &["m4_testkit"])]),
    };
    assert_eq!(
        violations(&actual, &may),
        Vec::<String>::new(),
        "testkit is for the tests of every crate"
    );

    actual
        .normal
        .insert("m4_kernels".to_owned(), set(&["m4_core", "m4_io"]));
    actual
        .dev
        .insert("m4_core".to_owned(), set(&["m4_kernels"]));
    let faults = violations(&actual, &may);
    assert_eq!(faults.len(), 2, "{faults:?}");
    assert!(
        faults[0].contains("m4_kernels has a dependency on m4_io"),
        "{faults:?}"
    );
    assert!(
        faults[1].contains("m4_core has a dev-dependency on m4_kernels"),
        "{faults:?}"
    );
}

#[test]
fn only_tests_of_measuring_crates_may_read_data() {
    let may = arrows_of(&[("m4_train", &[]), ("m4_core", &[])]);
    let with = |normal: &[&str], dev: &[&str], from: &str| {
        let mut actual = Actual {
            normal: may.clone(),
            dev: Arrows::new(),
        };
        actual.normal.insert(from.to_owned(), set(normal));
        actual.dev.insert(from.to_owned(), set(dev));
        violations(&actual, &may).len()
    };
    assert_eq!(with(&[], &["m4_io"], "m4_train"), 0);
    assert_eq!(with(&["m4_io"], &[], "m4_train"), 1);
    assert_eq!(with(&[], &["m4_io"], "m4_core"), 1);
    assert_eq!(with(&[], &["m4_geometry"], "m4_train"), 1);
}

#[test]
fn a_crate_without_a_row_and_a_row_without_a_crate_are_found() {
    let may = allowed(CRATES);
    let mut normal = may.clone();
    normal.remove("m4_io");
    normal.insert("m4_new".to_owned(), set(&[]));
    let faults = violations(
        &Actual {
            normal,
            dev: Arrows::new(),
        },
        &may,
    );
    assert_eq!(faults.len(), 2, "{faults:?}");
    assert!(
        faults.iter().any(|f| f.starts_with("m4_new has no row")),
        "{faults:?}"
    );
    assert!(
        faults.iter().any(|f| f.contains("row for m4_io")),
        "{faults:?}"
    );
}

const EQUATIONS: &str = "
| crate | one sentence |
|---|---|
| `m4_core` | Vectors. |

| paper | what it is | computed in |
|---|---|---|
| Eq. 1 | Gaussian: of four dimensions | [reference](crates/a/src/one.rs), [gpu](crates/b/src/one.rs) |
| Eq. 10 | prune score | [ten.rs](crates/a/src/ten.rs) |

Text with a [link](docs/spec/optimiser.md).
";

fn row(item: &str, caption: &str, files: &[&str]) -> Row {
    Row {
        item: item.to_owned(),
        caption: caption.to_owned(),
        files: files.iter().map(|&n| n.to_owned()).collect(),
    }
}

/// A table with every row, each of a file of its own that carries its marker.
fn complete() -> (Vec<Row>, Sources) {
    let file = |item: &str| format!("crates/a/src/{}.rs", item.replace([' ', '.'], "_"));
    let rows = ITEMS
        .map(|(item, caption)| row(item, caption, &[&file(item)]))
        .to_vec();
    let sources = ITEMS.map(|(item, _)| {
        (
            file(item),
            format!("/// A sum (Minute4D {item}).\nfn f() {{}}\n"),
        )
    });
    (rows, BTreeMap::from(sources))
}

#[test]
fn table_and_citations_of_this_workspace_are_true() {
    paper::check(&xtask::root()).unwrap();
}

#[test]
fn prose_is_narrow_and_files_are_short() {
    xtask::text::check(&xtask::root()).unwrap();
}

#[test]
fn rows_and_markers_are_read() {
    let want = [
        row(
            "Eq. 1",
            "Gaussian",
            &["crates/a/src/one.rs", "crates/b/src/one.rs"],
        ),
        row("Eq. 10", "prune score", &["crates/a/src/ten.rs"]),
    ];
    assert_eq!(rows(EQUATIONS), want);
    let actual = markers(
        "//! Minute4D Eq. 1. Minute4D sec. 3.3, and Minute4D (Minute4D Eq. 10).\n//! Eq. 7 of another paper, Minute4D Eq. x",
    );
    let want = ["Eq. 1", "Eq. 10", "sec. 3.3"].map(str::to_owned);
    assert_eq!(actual, BTreeSet::from(want));
}

#[test]
fn each_kind_of_mistake_in_the_table_is_found() {
    let (rows, sources) = complete();
    assert_eq!(paper::violations(&rows, &sources), Vec::<String>::new());
    let one = |rows: &[Row], sources: &Sources, what: &str| {
        let faults = paper::violations(rows, sources);
        assert_eq!(faults.len(), 1, "{faults:?}");
        assert!(faults[0].contains(what), "{faults:?}");
    };

    let mut twice = rows.clone();
    twice.push(rows[3].clone());
    one(&twice, &sources, "2 rows for Eq. 4");

    // what others call an equation is not what the paper has under the number
    let mut renamed = rows.clone();
    renamed[2].caption = "compositing".to_owned();
    one(
        &renamed,
        &sources,
        "the row for Eq. 3 has the caption `compositing` in place of `front end`",
    );

    let mut missing = sources.clone();
    missing.remove(&rows[0].files[0]);
    one(&rows, &missing, "which is no source file");

    let mut bare = rows.clone();
    bare[11].files.clear();
    let mut unmarked = sources.clone();
    unmarked.remove(&rows[11].files[0]);
    one(&bare, &unmarked, "the row for sec. 3.2 names no file");

    // Eq. 10 is no marker of Eq. 1
    let mut other = sources.clone();
    other.insert(rows[0].files[0].clone(), "Minute4D Eq. 10".to_owned());
    let faults = paper::violations(&rows, &other);
    assert_eq!(faults.len(), 2, "{faults:?}");
    assert!(
        faults[0].contains("lacks the marker `Minute4D Eq. 1`"),
        "{faults:?}"
    );
    assert!(
        faults[1].contains("no row for it names the file"),
        "{faults:?}"
    );

    let mut extra = sources;
    extra.insert(
        "crates/b/src/new.rs".to_owned(),
        "Minute4D sec. 3.1".to_owned(),
    );
    one(
        &rows,
        &extra,
        "crates/b/src/new.rs has the marker `Minute4D sec. 3.1`",
    );

    // a row that is missing leaves its marker without one
    let faults = paper::violations(&rows[1..], &complete().1);
    assert_eq!(faults.len(), 2, "{faults:?}");
    assert!(faults[0].contains("0 rows for Eq. 1 "), "{faults:?}");
}

#[test]
fn citations_of_missing_sections_are_found() {
    let text = "# Title\n\n## 3. Optimisation\n### 4.4 Reading\n## Notes\n";
    let sections = headings(text);
    assert_eq!(sections, BTreeSet::from(["3", "4.4"].map(str::to_owned)));
    let specifications = BTreeMap::from([("docs/spec/a.md".to_owned(), sections)]);
    let source = |text: &str| Sources::from([("crates/a/src/lib.rs".to_owned(), text.to_owned())]);
    let good = source("(docs/spec/a.md 4.4) and docs/spec/a.md 3; docs/spec/a.md\n3, too");
    assert_eq!(dangling(&good, &specifications), Vec::<String>::new());
    for bad in [
        "docs/spec/a.md 4.5",
        "docs/spec/a.md",
        "docs/spec/b.md 3",
        "docs/spec/a 3",
    ] {
        let faults = dangling(&source(bad), &specifications);
        assert_eq!(faults.len(), 1, "{bad}: {faults:?}");
    }
}
