//! `docs/settings.md`: a row for every key. `cargo xtask settings` writes it; the test here fails where it is not up to date.

mod rows;

use super::{Layers, Settings, SettingsError};
use rows::SECTIONS;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;
use toml::{Table, Value};

/// More keys than this are no interface.
const MOST_KEYS: usize = 80;

/// Set by `cargo xtask settings`: write the page in place of comparing it.
const WRITE: &str = "MINUTE4D_WRITE_SETTINGS";

const INTRO: &str = "<!-- Written by `cargo xtask settings` from crates/minute4d/src/settings/page/rows.rs. -->
# Settings

Settings come in layers, each over the one before:

1. A **profile**, `--profile fast` (the default: minutes on a plain CPU) or `--profile faithful` (the paper to the letter, with
   documented choices where it is silent). It gives every key its default and decides what has no key.
2. A **preset** of the fast profile: `--preset default` trains for 60 seconds on this machine, `--preset draft` for 10 seconds with a
   third of the splats.
3. A **file**, `--config file.toml`, whose tables are the parts of the keys below:

   ```toml
   profile = \"fast\"

   [train]
   iterations = 2000

   [train.density]
   enabled = false
   ```
4. **Single keys**, `--set train.density.enabled=false`, any number of them.
5. **Options with a name of their own**, such as `--iterations 2000`.

A number of steps (`--iterations`, or `train.iterations` in a file or `--set`) takes the place of the seconds of a preset.
`--print-config` prints the settings that a command would use, as a file for `--config`; `run.json` keeps those of a run, and `--resume`
does again what a changed key changes. An unknown key is refused with the nearest one that exists.

*Default* is that of the profile `fast`, with that of `faithful` where it differs.
";

fn toml(settings: &Settings) -> Table {
    settings.to_toml().unwrap().parse().unwrap()
}

fn get(table: &Table, key: &str) -> Option<Value> {
    let mut parts = key.split('.');
    let first = table.get(parts.next()?)?;
    parts.try_fold(first, |at, part| at.get(part)).cloned()
}

fn page() -> String {
    let (fast, faithful) = (toml(&Settings::fast()), toml(&Settings::faithful()));
    let shown = |table: &Table, key: &str| get(table, key).map_or("not set".to_owned(), |v| format!("`{v}`"));
    let mut out = INTRO.to_owned();
    for section in SECTIONS {
        write!(out, "\n## {}\n\n", section.title).unwrap();
        if !section.about.is_empty() {
            write!(out, "{}\n\n", section.about).unwrap();
        }
        out += "| key | type or unit | default | meaning |\n|---|---|---|---|\n";
        for (key, unit, about) in section.rows {
            let (default, other) = (shown(&fast, key), shown(&faithful, key));
            let default = match default == other {
                true => default,
                false => format!("{default}; {other}"),
            };
            writeln!(out, "| `{key}` | {unit} | {default} | {about} |").unwrap();
        }
    }
    out
}

/// Every key that files and `--set` may name, those without a default included: a key that does not exist is refused with those
/// that do.
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
    let rows = SECTIONS.iter().flat_map(|section| section.rows);
    let rows: BTreeSet<String> = rows.map(|row| row.0.to_owned()).collect();
    let undocumented: Vec<_> = keys.difference(&rows).collect();
    let gone: Vec<_> = rows.difference(&keys).collect();
    assert!(
        undocumented.is_empty() && gone.is_empty(),
        "without a row in settings/page/rows.rs: {undocumented:?}; rows without a key: {gone:?}"
    );
    let listed: usize = SECTIONS.iter().map(|section| section.rows.len()).sum();
    assert_eq!(listed, rows.len(), "a key has two rows");
    assert!(keys.len() <= MOST_KEYS, "{} keys; {MOST_KEYS} are allowed", keys.len());
}

#[test]
fn the_page_is_up_to_date() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/settings.md");
    if std::env::var_os(WRITE).is_some() {
        std::fs::write(&path, page()).unwrap();
        return;
    }
    let written = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        written == page(),
        "docs/settings.md is not what settings/page/rows.rs makes; run `cargo xtask settings`"
    );
}
