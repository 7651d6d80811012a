//! `minute4d bench`: milliseconds a kernel.

use crate::args::Bench;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::bench::BenchRow;

/// Its name, and what it says of a row.
type Column = (&'static str, fn(&BenchRow) -> String);

pub fn run(args: &Bench, output: &Output) -> Result<(), Failure> {
    let splats: Vec<usize> = args.splats.iter().map(|&n| n as usize).collect();
    let report = minute4d::bench::run(&splats, args.steps as usize, output)?;
    let mut text = format!(
        "{} x {} pixels, {} threads, {}; fastest of {} steps, milliseconds\n",
        report.width, report.height, report.threads, report.simd, report.steps
    );
    let columns: [Column; 10] = [
        ("splats", |r| r.splats.to_string()),
        ("visible", |r| r.visible.to_string()),
        ("project", |r| ms(r.project_ms)),
        ("bin", |r| ms(r.bin_ms)),
        ("blend", |r| ms(r.blend_ms)),
        ("photo", |r| ms(r.photo_ms)),
        ("blend back", |r| ms(r.blend_backward_ms)),
        ("project back", |r| ms(r.project_backward_ms)),
        ("adam", |r| ms(r.adam_ms)),
        ("step", |r| ms(r.step_ms)),
    ];
    for (name, _) in columns {
        text += &format!("{name:>13}");
    }
    for row in &report.rows {
        text.push('\n');
        for (_, cell) in columns {
            text += &format!("{:>13}", cell(row));
        }
    }
    output.result(&text, minute4d::plain_json(&report)?);
    Ok(())
}

fn ms(value: f64) -> String {
    format!("{value:.2}")
}
