//! The kernels alone.

use super::runs::{Input, Runs};
use anyhow::Result;

/// The first table that `minute4d-lab bench` prints.
pub(super) fn table(runs: &mut Runs, machine: &[Input]) -> Result<String> {
    let mut tables = String::new();
    for machine in machine {
        let value = runs.of(machine, "kernels", "bench", |program| {
            let printed = program.lab(|c| c.arg("bench"))?;
            let table = printed
                .lines()
                .skip_while(|line| !line.starts_with('|'))
                .take_while(|line| line.starts_with('|'));
            Ok(table.collect::<Vec<_>>().join("\n").into())
        })?;
        tables += value.as_str().unwrap_or_default();
    }
    Ok(tables)
}
