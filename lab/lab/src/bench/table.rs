//! Markdown tables whose columns also line up in a terminal, and the date of a report.

use std::time::{SystemTime, UNIX_EPOCH};

/// A cell with this many digits, or a dash.
pub fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// A Markdown table whose cells are padded to the width of their column; the first row is the head.
pub fn aligned(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, c: usize| row.get(c).cloned().unwrap_or_default();
    let width = |c: usize| {
        rows.iter()
            .map(|row| cell(row, c).chars().count())
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let line = |row: &Vec<String>| -> String {
        let cells = widths
            .iter()
            .enumerate()
            .map(|(c, &width)| format!(" {:>width$} |", cell(row, c)));
        format!("|{}\n", cells.collect::<String>())
    };
    let mut lines: Vec<String> = rows.iter().map(line).collect();
    let rule: String = widths
        .iter()
        .map(|width| format!("{}:|", "-".repeat(width + 1)))
        .collect();
    lines.insert(lines.len().min(1), format!("|{rule}\n"));
    lines.concat()
}

/// The day, UTC.
pub fn today() -> String {
    let seconds = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |d| d.as_secs());
    let (year, month, day) = civil(seconds / 86_400);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Year, month and day of this many days after 1970-01-01, Gregorian calendar (years from March on,
/// so that the leap day is the last: 146,097 days in 400 years).
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

#[cfg(test)]
mod tests {
    use super::{aligned, civil};

    #[test]
    fn columns_line_up() {
        let row = |cells: &[&str]| cells.iter().map(|&c| c.to_owned()).collect::<Vec<_>>();
        let text = aligned(&[row(&["a", "kernel"]), row(&["1000", "x"])]);
        assert_eq!(
            text,
            "|    a | kernel |\n|-----:|-------:|\n| 1000 |      x |\n"
        );
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
