//! The page and its tables: the text between the markers of a section is replaced, nothing else.
//!
//! A column is a heading and a template with JSON pointers and digits, such as
//! `{/far/psnr_db 2} / {/far/ssim 3}`; a number that is missing is `-`.

use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::path::Path;

/// The page at `path` with `text` between the markers of `section`, which it must have once.
pub(super) fn replaced(path: &Path, section: &str, text: &str) -> Result<String> {
    let page =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    between(&page, section, text)
}

fn between(page: &str, section: &str, text: &str) -> Result<String> {
    let (begin, end) = (format!("<!-- measured: {section} -->"), "<!-- end -->");
    let (before, rest) = page
        .split_once(&begin)
        .with_context(|| format!("the page has no line {begin}"))?;
    let (old, after) = rest
        .split_once(end)
        .with_context(|| format!("no {end} follows {begin}"))?;
    if old.contains("<!-- measured:") || after.contains(&begin) {
        bail!("{begin} stands twice or has no {end} of its own");
    }
    Ok(format!("{before}{begin}\n{}\n{end}{after}", text.trim()))
}

/// Writes a file whole: under another name in the same folder first.
pub(super) fn write(path: &Path, text: &str) -> Result<()> {
    let part = path.with_extension(format!("tmp-{}", std::process::id()));
    let written = std::fs::write(&part, text).and_then(|()| std::fs::rename(&part, path));
    written.with_context(|| format!("cannot write {}", path.display()))
}

/// A table of a row per value. `headings` and `templates` have ` | ` between columns.
pub(super) fn table(headings: &str, templates: &str, rows: &[Value]) -> String {
    let columns: Vec<&str> = templates.split(" | ").collect();
    let line = |row| {
        format!(
            "| {} |\n",
            columns
                .iter()
                .map(|column| fill(column, row))
                .collect::<Vec<_>>()
                .join(" | ")
        )
    };
    let rule = "|---".repeat(columns.len());
    format!(
        "| {headings} |\n{rule}|\n{}",
        rows.iter().map(line).collect::<String>()
    )
}

fn fill(template: &str, row: &Value) -> String {
    let (mut text, mut missing) = (String::new(), true);
    for part in template.split('{').skip(1) {
        let (field, rest) = part.split_once('}').unwrap_or((part, ""));
        let (pointer, digits) = field.rsplit_once(' ').unwrap_or((field, "0"));
        let cell = match row.pointer(pointer) {
            Some(Value::String(words)) => words.replace('\n', " ").replace('|', "\\|"),
            Some(Value::Number(number)) => {
                let digits = digits.parse().unwrap_or(0);
                let text = format!("{:.digits$}", number.as_f64().unwrap_or(f64::NAN));
                // a zero has no sign
                if text.parse() == Ok(0.0) {
                    text.replace('-', "")
                } else {
                    text
                }
            }
            _ => "-".to_owned(),
        };
        missing &= cell == "-";
        text += &(cell + rest);
    }
    if missing { "-".to_owned() } else { text }
}

/// The objects of a list; none if it is something else.
pub(super) fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

/// Mean of a figure over the objects that have it.
pub(super) fn mean<'a>(objects: impl Iterator<Item = &'a Value>, key: &str) -> Value {
    let values: Vec<f64> = objects.filter_map(|object| object[key].as_f64()).collect();
    if values.is_empty() {
        Value::Null
    } else {
        (values.iter().sum::<f64>() / values.len() as f64).into()
    }
}

#[test]
fn only_the_section_is_replaced() {
    let page = "# A\n<!-- measured: one -->\nold\n<!-- end -->\nprose\n<!-- measured: two -->\nkept\n<!-- end -->\n";
    assert_eq!(
        between(page, "one", "| table |\n").unwrap(),
        page.replace("old", "| table |")
    );
    assert!(between(page, "three", "x").is_err());
    for damaged in [
        page.replacen("<!-- end -->", "", 1),
        page.replace("<!-- end -->", ""),
        page.replace("two", "one"),
    ] {
        assert!(between(&damaged, "one", "x").is_err(), "{damaged}");
    }
}

#[test]
fn missing_numbers_are_dashes() {
    let row = serde_json::json!({"a b": {"x": 25.218, "y": null, "z": -0.02}, "name": "p|q", "list": [{"x": 2}, {}, {"x": 3}]});
    let templates = "{/name} | {/a b/x 2} / {/a b/y 2} | {/a b/y 2} + {/c 0} | {/a b/z 1}";
    let text = table("n | x / y | y | z", templates, &[row.clone(), Value::Null]);
    let rows = "| p\\|q | 25.22 / - | - | 0.0 |\n| - | - | - | - |\n";
    assert_eq!(
        text,
        format!("| n | x / y | y | z |\n|---|---|---|---|\n{rows}")
    );
    assert_eq!(
        [mean(list(&row["list"]), "x"), mean(list(&row["name"]), "x")],
        [2.5.into(), Value::Null]
    );
}
