//! The table of ARCHITECTURE.md is true, and the check that says so can fail.

use std::collections::BTreeSet;
use xtask::arrows::{Actual, Arrows, allowed, violations};

fn set(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|&n| n.to_owned()).collect()
}

fn arrows(rows: &[(&str, &[&str])]) -> Arrows {
    rows.iter().map(|&(from, to)| (from.to_owned(), set(to))).collect()
}

const TABLE: &str = "
| crate | what it is |
|---|---|
| `m4_core` | Knows no kernel and no io. |

| crate | one sentence | depends on |
|---|---|---|
| `m4_core` | Vectors, or all of them. | nothing of ours |
| `m4_kernels` | What exists. | `m4_core` |
| `m4_io` | Bytes. | core, kernels |
| `m4_testkit` | Tests. | core, kernels |
| `minute4d` | The library. | all of the above but testkit |
| `minute4d_cli` | The program. | minute4d |
";

fn crates() -> BTreeSet<String> {
    set(&["m4_core", "m4_kernels", "m4_io", "m4_testkit", "minute4d", "minute4d_cli"])
}

#[test]
fn this_workspace_keeps_to_its_table() {
    xtask::arrows::check(&xtask::root()).unwrap();
}

#[test]
fn nothing_comes_from_git() {
    xtask::lock::check(&xtask::root()).unwrap();
    let lock = "[[package]]\nname = \"a\"\nsource = \"git+https://example.org/a#1\"\n";
    assert_eq!(xtask::lock::git_sources(lock), ["a: git+https://example.org/a#1"]);
}

#[test]
fn the_table_is_read_with_and_without_prefixes() {
    let want = arrows(&[
        ("m4_core", &[]),
        ("m4_kernels", &["m4_core"]),
        ("m4_io", &["m4_core", "m4_kernels"]),
        ("m4_testkit", &["m4_core", "m4_kernels"]),
        ("minute4d", &["m4_io", "m4_core", "m4_kernels"]),
        ("minute4d_cli", &["minute4d"]),
    ]);
    assert_eq!(allowed(TABLE, &crates()), want);
}

#[test]
fn an_arrow_that_points_back_is_found() {
    let may = allowed(TABLE, &crates());
    let mut actual = Actual { normal: may.clone(), dev: arrows(&[("m4_io", &["m4_testkit"])]) };
    assert_eq!(violations(&actual, &may), Vec::<String>::new(), "testkit is for the tests of every crate");

    actual.normal.insert("m4_kernels".to_owned(), set(&["m4_core", "m4_io"]));
    actual.dev.insert("m4_core".to_owned(), set(&["m4_kernels"]));
    let found = violations(&actual, &may);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].contains("m4_kernels has a dependency on m4_io"), "{found:?}");
    assert!(found[1].contains("m4_core has a dev-dependency on m4_kernels"), "{found:?}");
}

#[test]
fn only_tests_of_measuring_crates_may_read_data() {
    let may = arrows(&[("m4_train", &[]), ("m4_core", &[])]);
    let with = |normal: &[&str], dev: &[&str], from: &str| {
        let mut actual = Actual { normal: may.clone(), dev: Arrows::new() };
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
    let may = allowed(TABLE, &crates());
    let mut normal = may.clone();
    normal.remove("m4_io");
    normal.insert("m4_new".to_owned(), set(&[]));
    let found = violations(&Actual { normal, dev: Arrows::new() }, &may);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found.iter().any(|f| f.starts_with("m4_new has no row")), "{found:?}");
    assert!(found.iter().any(|f| f.contains("row for m4_io")), "{found:?}");
}
