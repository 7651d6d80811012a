//! Markdown tables whose columns also line up in a terminal, and reports saved as `DATE-MACHINE.json` and `.md`.

use super::Machine;
use crate::Error;
use crate::record::write_json;
use m4_io::atomic;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{SystemTime, UNIX_EPOCH};

/// A cell with this many digits, or a dash.
pub(crate) fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// A Markdown table whose cells are padded to the width of their column; the first row is the head.
pub(crate) fn aligned(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, c: usize| row.get(c).cloned().unwrap_or_default();
    let width = |c: usize| rows.iter().map(|row| cell(row, c).chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let line = |row: &Vec<String>| -> String {
        let cells = widths.iter().enumerate().map(|(c, &width)| format!(" {:>width$} |", cell(row, c)));
        format!("|{}\n", cells.collect::<String>())
    };
    let mut lines: Vec<String> = rows.iter().map(line).collect();
    let rule: String = widths.iter().map(|width| format!("{}:|", "-".repeat(width + 1))).collect();
    lines.insert(lines.len().min(1), format!("|{rule}\n"));
    lines.concat()
}

/// Writes a report of `subject` as JSON and as Markdown into `folder`, named by `date` and machine; returns the path of the JSON file.
/// A report of the same day and machine is replaced.
pub(super) fn save(
    folder: &Path,
    (date, subject): (&str, &str),
    machine: &Machine,
    report: &impl Serialize,
    markdown: &str,
) -> Result<PathBuf, Error> {
    let name = format!("{date}-{}{subject}", slug(machine));
    let json = folder.join(format!("{name}.json"));
    write_json(&json, report)?;
    let path = folder.join(format!("{name}.md"));
    atomic::write(&path, markdown.as_bytes()).map_err(|source| Error::Write { path, source })?;
    Ok(json)
}

/// GPU, or processor, cores and instructions, in characters that every file system accepts.
fn slug(m: &Machine) -> String {
    let name = match &m.gpu {
        Some(gpu) => format!("{} {}", gpu.name, gpu.api),
        None => format!("{} {} cores {}", m.cpu.as_deref().unwrap_or(&m.platform), m.cores, m.simd),
    };
    let letters: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { ' ' }).collect();
    letters.split_whitespace().collect::<Vec<_>>().join("-")
}

/// The day, UTC.
pub(crate) fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (year, month, day) = civil(seconds / 86_400);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Year, month and day of this many days after 1970-01-01, Gregorian calendar (years from March on, so
/// that the leap day is the last: 146,097 days in 400 years).
fn civil(days: u64) -> (u64, u64, u64) {
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    (era * 400 + year + u64::from(month <= 2), month, day)
}

/// The commit, when the program was started in its own source folder.
pub(super) fn commit() -> Option<String> {
    if !Path::new("crates/m4_kernels").is_dir() {
        return None;
    }
    let output = Command::new("git")
        .args(["describe", "--always", "--dirty", "--abbrev=12"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let text = text.trim();
    (output.status.success() && !text.is_empty()).then(|| text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::{aligned, civil};

    #[test]
    fn columns_line_up() {
        let row = |cells: &[&str]| cells.iter().map(|&c| c.to_owned()).collect::<Vec<_>>();
        let text = aligned(&[row(&["a", "kernel"]), row(&["1000", "x"])]);
        assert_eq!(text, "|    a | kernel |\n|-----:|-------:|\n| 1000 |      x |\n");
    }

    #[test]
    fn days_have_dates() {
        let days = [
            (0, (1970, 1, 1)),
            (59, (1970, 3, 1)),
            (10_956, (1999, 12, 31)),
            (11_016, (2000, 2, 29)),
            (20_777, (2026, 11, 20)),
        ];
        for (day, date) in days {
            assert_eq!(civil(day), date);
        }
    }
}
