//! `docs/settings.md` has a row for every key: its words are written by hand, its ranges and
//! defaults by `cargo xtask settings`. The tests here fail where a key has no row, a row no key, or
//! a range or a default is not that of the code.

use super::ranges::{get, range_of};
use super::{Layers, Settings, SettingsError};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// More keys than this are no interface.
const MOST_KEYS: usize = 80;

/// Set by `cargo xtask settings`: write the page in place of comparing it.
const WRITE: &str = "MINUTE4D_WRITE_SETTINGS";

fn path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/settings.md")
}

fn toml(settings: &Settings) -> Table {
    settings.to_toml().unwrap().parse().unwrap()
}

/// The key of a row such as "| `video.size` | px | `640` | What it does. |".
fn key(line: &str) -> Option<&str> {
    line.strip_prefix("| `")?
        .split_once("` |")
        .map(|(key, _)| key)
}

/// The page with the ranges and defaults of the code.
fn page(written: &str) -> String {
    let (fast, faithful) = (toml(&Settings::fast()), toml(&Settings::faithful()));
    let shown = |table: &Table, key: &str| {
        get(table, key).map_or("not set".to_owned(), |v| format!("`{v}`"))
    };
    let line = |line: &str| {
        let Some(key) = key(line) else {
            return format!("{line}\n");
        };
        let cells: Vec<&str> = line.split(" | ").collect();
        let [first, unit, _, _, about] = cells[..] else {
            panic!("not five cells: {line}");
        };
        let range = range_of(key).unwrap_or_else(|| "-".to_owned());
        let (default, other) = (shown(&fast, key), shown(&faithful, key));
        let default = match default == other {
            true => default,
            false => format!("{default}; {other}"),
        };
        format!("{first} | {unit} | {range} | {default} | {about}\n")
    };
    written.lines().map(line).collect()
}

/// Every key that files and `--set` may name, those without a default included: a key that does not
/// exist is refused with those that do.
fn keys(path: &str, table: &Table) -> Vec<String> {
    let under = |name: &str| match path {
        "" => name.to_owned(),
        path => format!("{path}.{name}"),
    };
    let names = match Layers::default().set(&format!("{}=0", under("?"))) {
        Err(SettingsError::UnknownKey { known, .. }) => known,
        other => panic!("a key that does not exist: {other:?}"),
    };
    let inner = |name: &String| match table.get(name) {
        Some(Value::Table(inner)) => keys(&under(name), inner),
        _ => vec![under(name)],
    };
    names.iter().flat_map(inner).collect()
}

#[test]
fn every_key_has_a_row_and_every_row_a_key() {
    let keys: BTreeSet<String> = keys("", &toml(&Settings::fast())).into_iter().collect();
    let written = std::fs::read_to_string(path()).unwrap();
    let listed: Vec<String> = written.lines().filter_map(key).map(str::to_owned).collect();
    let rows: BTreeSet<String> = listed.iter().cloned().collect();
    let undocumented: Vec<_> = keys.difference(&rows).collect();
    let gone: Vec<_> = rows.difference(&keys).collect();
    assert!(
        undocumented.is_empty() && gone.is_empty(),
        "without a row in docs/settings.md: {undocumented:?}; rows without a key: {gone:?}"
    );
    assert_eq!(listed.len(), rows.len(), "a key has two rows");
    assert!(
        keys.len() <= MOST_KEYS,
        "{} keys; {MOST_KEYS} are allowed",
        keys.len()
    );
}

#[test]
fn the_page_has_the_defaults_of_the_code() {
    let written = std::fs::read_to_string(path()).unwrap();
    let page = page(&written);
    if std::env::var_os(WRITE).is_some() {
        std::fs::write(path(), page).unwrap();
        return;
    }
    assert!(
        written == page,
        "docs/settings.md has other ranges or defaults than the code; run `cargo xtask settings`"
    );
}
