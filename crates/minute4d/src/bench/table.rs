//! Formats the report as Markdown whose columns also line up in a terminal.

use super::{BenchReport, Case, GpuCase, KernelRow};

impl BenchReport {
    /// The whole report: the machine, one row a case, then one table a case.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut text = format!(
            "# Bench, {}\n\n{}; fastest of {} steps a view{}\n\n",
            self.date,
            self.machine.line(),
            self.steps,
            if self.machine.gpu.is_some() {
                "; whole steps and frames without waiting between them"
            } else {
                ""
            },
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
            let step = case.step.map(|s| {
                [
                    millis(s.ms),
                    format!("{:.1}", s.per_s),
                    format!("{:.0} %", 100.0 * s.busy),
                ]
            });
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
        let mut text = format!(
            "## {} splats, {} x {}, {}, {place}\n\n",
            self.splats, self.width, self.height, self.scene,
        );
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
        let head = [
            "kernel", "ms", "ns/item", "item", "Geval/s", "MB", "GB/s", "bound ms", "bound by", "x bound",
        ];
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
            if self.own_clock {
                "the GPU's own clock"
            } else {
                "waiting for the GPU after each"
            },
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
        k.evaluations_g_per_s
            .map_or_else(|| "-".to_owned(), |v| format!("{v:.2}")),
        format!("{:.1}", k.bytes / 1e6),
        format!("{:.1}", k.gb_per_s),
        format!("{:.3}", k.bound_ms),
        k.bound.name().to_owned(),
        format!("{:.1}", k.times_bound),
    ]
}

/// To a hundredth, below a millisecond to a thousandth.
fn millis(ms: f64) -> String {
    if ms < 1.0 {
        format!("{ms:.3}")
    } else {
        format!("{ms:.2}")
    }
}

/// A Markdown table whose cells are padded to the width of their column; the first row is the head.
pub(crate) fn aligned(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, c: usize| row.get(c).cloned().unwrap_or_default();
    let widths: Vec<usize> = (0..columns)
        .map(|c| rows.iter().map(|row| cell(row, c).chars().count()).max().unwrap_or(0))
        .collect();
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

#[cfg(test)]
mod tests {
    use super::aligned;

    #[test]
    fn columns_line_up() {
        let row = |cells: &[&str]| cells.iter().map(|&c| c.to_owned()).collect::<Vec<_>>();
        let text = aligned(&[row(&["a", "kernel"]), row(&["1000", "x"])]);
        assert_eq!(text, "|    a | kernel |\n|-----:|-------:|\n| 1000 |      x |\n");
    }
}
