//! `odometry.csv` and `camera_matrix.csv`.

use crate::core::{ReadSourceError, SourceFault};
use crate::files::text;
use std::path::Path;

const REMEDY: &str = "export the recording again";

/// A line.
pub(super) struct Row {
    pub time_s: f64,
    pub frame: u64,
    pub place: [f64; 3],
    pub quaternion_xyzw: [f64; 4],
    /// `fx fy cx cy`, where the line has them.
    pub lens: Option<[f64; 4]>,
}

const NAMES: [&str; 9] = ["timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw"];
const LENS: [&str; 4] = ["fx", "fy", "cx", "cy"];

pub(super) fn read(path: &Path) -> Result<Vec<Row>, ReadSourceError> {
    let text = text(path)?;
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let head = lines.next().map(|(_, line)| line).unwrap_or_default();
    let names: Vec<String> = head.split(',').map(|n| n.trim().to_ascii_lowercase()).collect();
    let column = |name: &str| names.iter().position(|n| n == name);
    let Some(columns) = NAMES.iter().map(|n| column(n)).collect::<Option<Vec<usize>>>() else {
        let what = format!("its first line is {:?}; {} were expected", head, NAMES.join(", "));
        return Err(SourceFault::bad(what, REMEDY).at(path));
    };
    let lens: Option<Vec<usize>> = LENS.iter().map(|n| column(n)).collect();
    let mut rows: Vec<Row> = Vec::new();
    for (i, line) in lines {
        let bad = |what: String| SourceFault::bad(what, REMEDY).within(path, format!("line {}", i + 1));
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let number = |&c: &usize| {
            cells
                .get(c)
                .and_then(|cell| cell.parse::<f64>().ok())
                .filter(|v| v.is_finite())
        };
        let values: Option<Vec<f64>> = columns.iter().map(number).collect();
        let frame = cells.get(columns[1]).and_then(|cell| cell.parse::<u64>().ok());
        let (Some(values), Some(frame)) = (values, frame) else {
            return Err(bad(format!(
                "{:?} has not a number for each of {}",
                line,
                NAMES.join(", ")
            )));
        };
        if let Some(last) = rows.last().filter(|r| r.frame >= frame || r.time_s >= values[0]) {
            return Err(bad(format!(
                "frame {frame} comes after frame {} but is not later",
                last.frame
            )));
        }
        // empty cells stand for none
        let own: Option<Vec<f64>> = lens.as_ref().and_then(|lens| lens.iter().map(number).collect());
        rows.push(Row {
            time_s: values[0],
            frame,
            place: [values[2], values[3], values[4]],
            quaternion_xyzw: [values[5], values[6], values[7], values[8]],
            lens: own.and_then(|l| l.try_into().ok()),
        });
    }
    Ok(rows)
}

/// `fx fy cx cy` of a 3 x 3 matrix.
pub(super) fn matrix(path: &Path) -> Result<[f64; 4], ReadSourceError> {
    let text = text(path)?;
    let rows: Vec<Vec<f64>> = text
        .lines()
        .filter(|line| !line.trim().is_empty())
        .map(|line| line.split(',').filter_map(|c| c.trim().parse().ok()).collect())
        .collect();
    match rows.iter().map(Vec::as_slice).collect::<Vec<_>>()[..] {
        [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]] => Ok([*fx, *fy, *cx, *cy]),
        _ => {
            let what = "it is not fx, 0, cx / 0, fy, cy / 0, 0, 1";
            Err(SourceFault::bad(what, REMEDY).at(path))
        }
    }
}
