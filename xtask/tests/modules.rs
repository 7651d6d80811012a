//! Cycles among the modules of a crate: of this workspace none but those that are known, and a
//! small crate that has one.

use std::collections::{BTreeMap, BTreeSet};
use xtask::modules::{Modules, check, cycles, modules, violations};
use xtask::paper::Sources;

#[test]
fn no_crate_of_this_workspace_has_a_new_cycle() {
    check(&xtask::root()).unwrap();
}

fn arrows(pairs: &[(&str, &str)]) -> Modules {
    let mut out = Modules::new();
    for &(from, to) in pairs {
        out.entry(from.to_owned())
            .or_default()
            .insert(to.to_owned(), format!("{to} in {from}.rs"));
        out.entry(to.to_owned()).or_default();
    }
    out
}

#[test]
fn circles_are_found_and_lines_are_not() {
    let set =
        |names: &[&'static str]| -> BTreeSet<&'static str> { names.iter().copied().collect() };
    assert!(cycles(&arrows(&[("a", "b"), ("b", "c"), ("a", "c"), ("d", "a")])).is_empty());
    let two = arrows(&[
        ("a", "b"),
        ("b", "a"),
        ("b", "c"),
        ("c", "d"),
        ("d", "e"),
        ("e", "c"),
        ("f", "c"),
    ]);
    assert_eq!(cycles(&two), [set(&["a", "b"]), set(&["c", "d", "e"])]);
    // two circles that share a module are one knot
    let knot = arrows(&[("a", "b"), ("b", "a"), ("b", "c"), ("c", "b")]);
    assert_eq!(cycles(&knot), [set(&["a", "b", "c"])]);
    let said = violations("m4_x", &two);
    assert_eq!(said.len(), 2);
    assert_eq!(
        said[0],
        "modules of m4_x use each other in a circle: a, b\n  a -> b: b in a.rs\n  b -> a: a in b.rs",
        "the arrow to c is part of no circle"
    );
}

/// The top modules of a crate of these files, and which each uses.
fn read(files: &[(&str, &str)]) -> anyhow::Result<BTreeMap<String, Vec<String>>> {
    let sources: Sources = files
        .iter()
        .map(|&(name, text)| (format!("crates/x/src/{name}"), text.to_owned()))
        .collect();
    let modules = modules("crates/x/src/", &sources)?;
    Ok(modules
        .into_iter()
        .map(|(from, to)| (from, to.into_keys().collect()))
        .collect())
}

const ROOT: &str = "
    //! Uses nothing: crate::low::Thing is a link.
    pub mod high;
    mod low;
    pub mod middle;
    #[cfg(test)]
    mod help;
    pub use low::{Thing, deep::Other as Renamed};
    pub use std::path::Path;
    pub fn of_the_root() -> usize { middle::size() }
";

#[test]
fn paths_of_all_kinds_are_arrows() {
    let with = |text: &str| {
        let files = [
            ("lib.rs", ROOT),
            (
                "low.rs",
                "pub struct Thing; pub mod deep { pub struct Other; }",
            ),
            (
                "middle/mod.rs",
                "mod inner; #[macro_export] macro_rules! twice { () => { 2 } } pub fn size() -> usize { 1 }",
            ),
            ("middle/inner.rs", ""),
            ("high.rs", text),
        ];
        read(&files).unwrap()["high"].clone()
    };
    for (text, want) in [
        ("use crate::low::deep::Other;", vec!["low"]),
        ("use super::middle;", vec!["middle"]),
        ("mod own { use super::super::low::deep; }", vec!["low"]),
        ("mod own { use super::Local; } pub struct Local;", vec![]),
        (
            "use crate::{Thing, middle::{self, size}};",
            vec!["low", "middle"],
        ),
        ("use crate::Renamed;", vec!["low"]),
        ("use crate::Path;", vec![]),
        ("use crate::twice;", vec!["middle"]),
        (
            "fn f(a: &crate::low::Thing) -> usize { crate::middle::size() }",
            vec!["low", "middle"],
        ),
        ("fn f() -> usize { crate::of_the_root() }", vec!["lib.rs"]),
        (
            "fn f() { println!(\"{}\", crate::middle::size()); }",
            vec!["middle"],
        ),
        (
            "macro_rules! m { () => { $crate::low::Thing } }",
            vec!["low"],
        ),
        ("#[serde(with = \"crate::low\")] struct A;", vec!["low"]),
        (
            "use crate::high::own; use self::own as other; mod own {}",
            vec![],
        ),
        ("fn f() -> impl Fn() + use<> { || () }", vec![]),
    ] {
        assert_eq!(with(text), want, "{text}");
    }
    for text in [
        "// use crate::low::Thing;\n/* crate::middle */ /// [`crate::low`]\nfn f() {}",
        "const A: &str = \"crate::low::Thing\";",
        "#[cfg(test)] mod tests { use crate::low::Thing; }",
        "#[cfg(test)] use crate::{low::Thing, middle};",
        "#[cfg(test)]\n#[must_use]\npub fn f<A, B>(a: A) -> [B; 2] { crate::middle::size() }",
        "#[cfg(test)] const A: crate::low::Thing = crate::low::Thing {};",
        "struct A { #[cfg(test)] a: crate::low::Thing, b: u8 }",
    ] {
        assert_eq!(with(text), Vec::<String>::new(), "{text}");
    }
}

#[test]
fn a_small_crate_with_a_cycle_is_refused() {
    let cyclic = [
        ("lib.rs", "mod a; mod b; mod c; pub use b::B;"),
        ("a.rs", "use crate::B; pub struct A(B);"),
        ("b/mod.rs", "mod inner; pub struct B;"),
        ("b/inner.rs", "use super::super::c::C; pub struct D(C);"),
        ("c.rs", "pub struct C; impl C { fn of(a: &crate::a::A) {} }"),
    ];
    let sources: Sources = cyclic
        .iter()
        .map(|&(name, text)| (format!("crates/x/src/{name}"), text.to_owned()))
        .collect();
    let faults = violations("x", &modules("crates/x/src/", &sources).unwrap());
    let want = "modules of x use each other in a circle: a, b, c\n  a -> b: B in crates/x/src/a.rs\n  \
                b -> c: c::C in crates/x/src/b/inner.rs\n  c -> a: a::A in crates/x/src/c.rs";
    assert_eq!(faults, [want]);
}

#[test]
fn the_code_of_the_root_has_a_place_of_its_own() {
    let files = |high: &'static str| {
        [
            (
                "main.rs",
                "mod high; use high::H; fn main() { let a = H; } fn help() {}",
            ),
            ("high.rs", high),
        ]
    };
    let actual = read(&files("pub struct H;")).unwrap();
    assert_eq!(actual["main.rs"], ["high"]);
    let actual = read(&files("pub struct H; fn f() { super::help(); }")).unwrap();
    assert_eq!(actual["high"], ["main.rs"]);
}

#[test]
fn what_hides_arrows_is_refused() {
    let refused = |root: &str, high: &str| {
        let error = read(&[("lib.rs", root), ("high.rs", high)]).unwrap_err();
        format!("{error:#}")
    };
    assert!(refused("mod high;", "use crate::*;").contains("glob"));
    assert!(refused("mod high; pub use high::*;", "").contains("hides"));
    assert!(refused("mod high;", "use crate::gone::A;").contains("no `gone`"));
    assert!(refused("mod high; mod gone;", "").contains("no file crates/x/src/gone/mod.rs"));
    assert!(refused("mod high;", "fn (").contains("high.rs"));
}

#[test]
fn a_root_that_uses_no_module_is_part_of_no_circle() {
    let sources: Sources = [
        ("c/src/lib.rs", "mod a;\nconst BUILD: &str = \"b\";"),
        (
            "c/src/a.rs",
            "pub fn build() -> &'static str { crate::BUILD }",
        ),
    ]
    .map(|(file, text)| (file.to_owned(), text.to_owned()))
    .into();
    let modules = modules("c/src/", &sources).unwrap();
    assert!(modules["a"].contains_key("lib.rs"));
    assert!(cycles(&modules).is_empty());
}
