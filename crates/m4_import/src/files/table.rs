//! Lines of numbers.

use super::{first_bytes, text};
use crate::core::{ReadSourceError, SourceFault};
use std::path::Path;

/// A line: its number in the file, from 1, and its numbers.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Row {
    pub line: usize,
    pub values: Vec<f64>,
}

impl Row {
    /// Where it is, for messages.
    pub fn place(&self) -> String {
        format!("line {}", self.line)
    }
}

/// The lines of a file that are neither empty nor comments (`#`), with `fits(count)` numbers each; `expected` says how many.
/// Numbers are separated by spaces, tabs or commas.
pub(crate) fn read(path: &Path, fits: impl Fn(usize) -> bool, expected: &str) -> Result<Vec<Row>, ReadSourceError> {
    let text = text(path)?;
    let mut rows = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let line_text = line.trim();
        if line_text.is_empty() || line_text.starts_with('#') {
            continue;
        }
        let bad = |what: String| {
            SourceFault::bad(what, "give the file that the tool wrote").within(path, format!("line {}", i + 1))
        };
        let mut values = Vec::new();
        for word in words(line_text) {
            let value: f64 = word
                .parse()
                .map_err(|_| bad(format!("{word:?} is no number; {expected} were expected")))?;
            if !value.is_finite() {
                return Err(bad(format!("it holds {value}; {expected} were expected")));
            }
            values.push(value);
        }
        if !fits(values.len()) {
            return Err(bad(format!(
                "it has {} numbers; {expected} were expected",
                values.len()
            )));
        }
        rows.push(Row { line: i + 1, values });
    }
    if rows.is_empty() {
        return Err(SourceFault::missing("every line of numbers", format!("{expected} a line were expected")).at(path));
    }
    Ok(rows)
}

/// The words of a line.
pub(crate) fn words(line: &str) -> impl Iterator<Item = &str> {
    line.split([' ', '\t', ',']).filter(|word| !word.is_empty())
}

/// The first line that is neither empty nor a comment holds `count` numbers: for telling formats apart.
pub(crate) fn starts_with_numbers(path: &Path, count: usize) -> bool {
    let start = first_bytes::<8192>(path);
    let start = String::from_utf8_lossy(&start);
    let mut lines = start.lines().map(str::trim);
    lines
        .find(|line| !(line.is_empty() || line.starts_with('#')))
        .is_some_and(|line| {
            let numbers: Vec<_> = words(line).map(str::parse::<f64>).collect();
            numbers.len() == count && numbers.iter().all(Result::is_ok)
        })
}
