//! Formats reports as Markdown whose columns also line up in a terminal, and saves them: `DATE-MACHINE.json` and `.md`.

use super::{BenchReport, Case, GpuCase, KernelRow, Machine, MemoryReport};
use crate::Error;
use crate::record::write_json;
use m4_io::atomic;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{SystemTime, UNIX_EPOCH};

impl BenchReport {
    /// The whole report: the machine, one row a case, then one table a case.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut text = format!(
            "# Bench, {}\n\n{}; fastest of {} steps a view{}\n\n",
            self.date,
            self.machine.line(),
            self.steps,
            if self.machine.gpu.is_some() { "; whole steps and frames without waiting between them" } else { "" },
        );
        text += &self.overview();
        for case in &self.cases {
            text += "\n";
            text += &case.to_markdown();
        }
        text
    }

    /// One row a case: milliseconds per kernel and a step.
    fn overview(&self) -> String {
        let mut rows = vec![vec!["scene", "splats", "size", "threads"]];
        let names: Vec<&str> = match self.cases.iter().max_by_key(|c| c.kernels.len()) {
            Some(case) => case.kernels.iter().map(|k| k.kernel.as_str()).collect(),
            None => Vec::new(),
        };
        rows[0].extend(names);
        rows[0].extend(["step ms", "steps/s", "busy", "frames/s"]);
        let mut table: Vec<Vec<String>> = vec![rows.remove(0).into_iter().map(str::to_owned).collect()];
        for case in &self.cases {
            let mut row = vec![
                case.scene.clone(),
                case.splats.to_string(),
                format!("{}x{}", case.width, case.height),
                match case.gpu {
                    Some(_) => "GPU".to_owned(),
                    None => case.threads.to_string(),
                },
            ];
            row.extend(case.kernels.iter().map(|k| millis(k.ms)));
            let step = case.step.map(|s| [millis(s.ms), format!("{:.1}", s.per_s), format!("{:.0} %", 100.0 * s.busy)]);
            row.extend(step.unwrap_or_else(|| std::array::from_fn(|_| "-".to_owned())));
            row.push(format!("{:.0}", case.frames_per_s));
            table.push(row);
        }
        aligned(&table)
    }
}

impl Case {
    fn to_markdown(&self) -> String {
        let place = match (&self.gpu, self.threads) {
            (Some(_), _) => "GPU".to_owned(),
            (None, 1) => "1 thread".to_owned(),
            (None, threads) => format!("{threads} threads"),
        };
        let mut text =
            format!("## {} splats, {} x {}, {}, {place}\n\n", self.splats, self.width, self.height, self.scene,);
        text += &format!(
            "{:.0} alive, {:.0} in the image, {:.0} touched, {:.0} pairs; {:.1} blends a pixel, {:.0} % of the lanes \
             useful; memory {:.1} GB/s, multiply-adds {:.1} G/s\n\n",
            self.alive,
            self.visible,
            self.touched,
            self.pairs,
            self.blends_per_pixel,
            100.0 * self.useful_share,
            self.stream_gb_per_s,
            self.multiply_add_g_per_s,
        );
        let head = ["kernel", "ms", "ns/item", "item", "Geval/s", "MB", "GB/s", "bound ms", "bound by", "x bound"];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        table.extend(self.kernels.iter().map(kernel_row));
        if let Some(step) = &self.step {
            let dash = || "-".to_owned();
            table.push(vec![
                "step".to_owned(),
                millis(step.ms),
                dash(),
                dash(),
                dash(),
                format!("{:.1}", self.kernels.iter().map(|k| k.bytes).sum::<f64>() / 1e6),
                dash(),
                millis(step.bound_ms),
                "all".to_owned(),
                format!("{:.1}", step.ms / step.bound_ms.max(1e-9)),
            ]);
        }
        text += &aligned(&table);
        if let Some(gpu) = &self.gpu {
            text += &gpu.to_markdown();
        }
        text
    }
}

impl GpuCase {
    fn to_markdown(self) -> String {
        let mb = |bytes: u64| bytes as f64 / 1e6;
        format!(
            "\nkernels timed by {}; {} behind one another; memory {:.0} MB planned, {:.0} MB in use, {:.0} MB taken from \
             the driver; {:.0} frames/s where each is copied to the host\n",
            if self.own_clock { "the GPU's own clock" } else { "waiting for the GPU after each" },
            self.behind_one_another,
            mb(self.planned_bytes),
            mb(self.in_use_bytes),
            mb(self.reserved_bytes),
            self.read_frames_per_s,
        )
    }
}

fn kernel_row(k: &KernelRow) -> Vec<String> {
    vec![
        k.kernel.clone(),
        millis(k.ms),
        format!("{:.1}", k.ns_per_item),
        k.item.clone(),
        k.evaluations_g_per_s.map_or_else(|| "-".to_owned(), |v| format!("{v:.2}")),
        format!("{:.1}", k.bytes / 1e6),
        format!("{:.1}", k.gb_per_s),
        format!("{:.3}", k.bound_ms),
        k.bound.name().to_owned(),
        format!("{:.1}", k.times_bound),
    ]
}

/// To a hundredth, below a millisecond to a thousandth.
fn millis(ms: f64) -> String {
    if ms < 1.0 { format!("{ms:.3}") } else { format!("{ms:.2}") }
}

/// A Markdown table whose cells are padded to the width of their column; the first row is the head.
pub(crate) fn aligned(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, c: usize| row.get(c).cloned().unwrap_or_default();
    let widths: Vec<usize> =
        (0..columns).map(|c| rows.iter().map(|row| cell(row, c).chars().count()).max().unwrap_or(0)).collect();
    let mut text = String::new();
    for (r, row) in rows.iter().enumerate() {
        text.push('|');
        for (c, &width) in widths.iter().enumerate() {
            text += &format!(" {:>width$} |", cell(row, c));
        }
        text.push('\n');
        if r == 0 {
            text.push('|');
            for width in &widths {
                text += &format!("{}:|", "-".repeat(width + 1));
            }
            text.push('\n');
        }
    }
    text
}

/// A report that can be saved.
pub trait SavedReport: Serialize {
    /// Part of the file's name that says what was measured; may be empty.
    fn subject(&self) -> &'static str;
    /// The day, `YYYY-MM-DD`.
    fn date(&self) -> &str;
    /// Where it was measured.
    fn machine(&self) -> &Machine;
    /// The report for people.
    fn markdown(&self) -> String;
}

impl SavedReport for BenchReport {
    fn subject(&self) -> &'static str {
        ""
    }

    fn date(&self) -> &str {
        &self.date
    }

    fn machine(&self) -> &Machine {
        &self.machine
    }

    fn markdown(&self) -> String {
        self.to_markdown()
    }
}

impl SavedReport for MemoryReport {
    fn subject(&self) -> &'static str {
        "-memory"
    }

    fn date(&self) -> &str {
        &self.date
    }

    fn machine(&self) -> &Machine {
        &self.machine
    }

    fn markdown(&self) -> String {
        self.to_markdown()
    }
}

/// Writes the report as JSON and as Markdown into `folder`; returns the name of the JSON file. A
/// report of the same day and machine is replaced.
///
/// # Errors
///
/// [`Error::Write`].
pub fn save(folder: &Path, report: &impl SavedReport) -> Result<PathBuf, Error> {
    let name = format!("{}-{}{}", report.date(), slug(report.machine()), report.subject());
    let json = folder.join(format!("{name}.json"));
    write_json(&json, report)?;
    let path = folder.join(format!("{name}.md"));
    atomic::write(&path, report.markdown().as_bytes()).map_err(|source| Error::Write { path, source })?;
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
