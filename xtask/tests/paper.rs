//! The table of equations of ARCHITECTURE.md and the citations of docs/spec are true, and the checks can fail.

use std::collections::{BTreeMap, BTreeSet};
use xtask::paper::{ITEMS, Rows, Sources, dangling, headings, markers, rows, violations};

const TABLE: &str = "
| crate | one sentence |
|---|---|
| `m4_core` | Vectors. |

| paper | what it is | computed in |
|---|---|---|
| Eq. 1 | A Gaussian. | [reference](crates/a/src/one.rs), [gpu](crates/b/src/one.rs) |
| Eq. 10 | A score. | [ten.rs](crates/a/src/ten.rs) |

Text with a [link](docs/spec/optimiser.md).
";

/// A table with every row, each of a file of its own that carries its marker.
fn complete() -> (Rows, Sources) {
    let file = |item: &str| format!("crates/a/src/{}.rs", item.replace([' ', '.'], "_"));
    let rows = ITEMS.map(|item| (item.to_owned(), vec![file(item)])).to_vec();
    let sources = ITEMS.map(|item| (file(item), format!("/// A sum (Minute4D {item}).\nfn f() {{}}\n")));
    (rows, BTreeMap::from(sources))
}

#[test]
fn table_and_citations_of_this_workspace_are_true() {
    xtask::paper::check(&xtask::root()).unwrap();
}

#[test]
fn rows_and_markers_are_read() {
    let files = |names: &[&str]| names.iter().map(|&n| n.to_owned()).collect::<Vec<_>>();
    let want = vec![
        ("Eq. 1".to_owned(), files(&["crates/a/src/one.rs", "crates/b/src/one.rs"])),
        ("Eq. 10".to_owned(), files(&["crates/a/src/ten.rs"])),
    ];
    assert_eq!(rows(TABLE), want);
    let found = markers(
        "//! Minute4D Eq. 1. Minute4D sec. 3.3, and Minute4D (Minute4D Eq. 10).\n//! Eq. 7 of another paper, Minute4D Eq. x",
    );
    let want = ["Eq. 1", "Eq. 10", "sec. 3.3"].map(str::to_owned);
    assert_eq!(found, BTreeSet::from(want));
}

#[test]
fn each_kind_of_mistake_in_the_table_is_found() {
    let (rows, sources) = complete();
    assert_eq!(violations(&rows, &sources), Vec::<String>::new());
    let one = |rows: &[(String, Vec<String>)], sources: &Sources, what: &str| {
        let found = violations(rows, sources);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].contains(what), "{found:?}");
    };

    let mut twice = rows.clone();
    twice.push(rows[3].clone());
    one(&twice, &sources, "2 rows for Eq. 4");

    let mut missing = sources.clone();
    missing.remove(&rows[0].1[0]);
    one(&rows, &missing, "which is no source file");

    let mut bare = rows.clone();
    bare[11].1.clear();
    let mut unmarked = sources.clone();
    unmarked.remove(&rows[11].1[0]);
    one(&bare, &unmarked, "the row for sec. 3.2 names no file");

    // Eq. 10 is no marker of Eq. 1
    let mut other = sources.clone();
    other.insert(rows[0].1[0].clone(), "Minute4D Eq. 10".to_owned());
    let found = violations(&rows, &other);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].contains("lacks the marker `Minute4D Eq. 1`"), "{found:?}");
    assert!(found[1].contains("no row for it names the file"), "{found:?}");

    let mut extra = sources;
    extra.insert("crates/b/src/new.rs".to_owned(), "Minute4D sec. 3.1".to_owned());
    one(&rows, &extra, "crates/b/src/new.rs has the marker `Minute4D sec. 3.1`");

    // a row that is missing leaves its marker without one
    let found = violations(&rows[1..], &complete().1);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].contains("0 rows for Eq. 1 "), "{found:?}");
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
    for bad in ["docs/spec/a.md 4.5", "docs/spec/a.md", "docs/spec/b.md 3", "docs/spec/a 3"] {
        let found = dangling(&source(bad), &specifications);
        assert_eq!(found.len(), 1, "{bad}: {found:?}");
    }
}
