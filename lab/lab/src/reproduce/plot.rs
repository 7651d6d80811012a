//! The plot of a table: bars of its scenes, its mean and the published means of the same task.

use super::TableReport;
use minute4d::{Category, Refusal};
use plotters::prelude::*;
use std::path::Path;

const WIDTH: i32 = 860;
const ROW: i32 = 26;
/// The first and last column of the bars.
const FROM: i32 = 330;
const TO: i32 = 790;
const TOP: i32 = 64;
const OURS: RGBColor = RGBColor(214, 96, 36);
const THEIRS: RGBColor = RGBColor(126, 142, 166);

/// A bar.
struct Bar {
    name: String,
    psnr_db: f64,
    colour: RGBColor,
}

/// Draws the scenes of a table, its mean and the published means of the same task into an SVG file.
pub(super) fn write_plot(path: &Path, table: &TableReport) -> Result<(), Refusal> {
    let mut bars: Vec<Bar> = Vec::new();
    let mut ours = |name: String, value: Option<f64>| {
        bars.extend(value.filter(|v| v.is_finite()).map(|psnr_db| Bar {
            name,
            psnr_db,
            colour: OURS,
        }));
    };
    ours(table.ours(), table.mean.get("headline").copied());
    for row in &table.rows {
        ours(format!("   {}", row.scene), row.headline);
    }
    bars.extend(table.published.iter().map(|p| Bar {
        name: match p.poses {
            Some(poses) => format!("{} (poses {poses})", p.method),
            None => p.method.to_owned(),
        },
        psnr_db: p.psnr_db,
        colour: THEIRS,
    }));
    draw(path, table, &bars).map_err(|what| {
        Refusal::new(
            Category::CannotWrite,
            format!("cannot write {}: {what}", path.display()),
        )
    })
}

fn draw(path: &Path, table: &TableReport, bars: &[Bar]) -> Result<(), Box<dyn std::error::Error>> {
    let height = TOP + ROW * bars.len() as i32 + 24;
    let root = SVGBackend::new(path, (WIDTH as u32, height as u32)).into_drawing_area();
    let text = |words: String, at: (i32, i32), size: i32| {
        Text::new(words, at, ("sans-serif", size).into_font())
    };
    root.fill(&WHITE)?;
    root.draw(&text(
        format!(
            "{}: {}",
            table.suite.facts().title,
            table.protocol.rules().title
        ),
        (16, 12),
        18,
    ))?;
    let unit = format!(
        "{} of {}, dB; bars begin at 10 dB",
        table.headline,
        table.task.title()
    );
    root.draw(&text(unit, (16, 36), 14))?;
    let most = bars.iter().map(|b| b.psnr_db).fold(20.0, f64::max);
    for (i, bar) in bars.iter().enumerate() {
        let top = TOP + ROW * i as i32;
        let share = ((bar.psnr_db - 10.0) / (most - 10.0)).clamp(0.0, 1.0);
        let end = FROM + (share * f64::from(TO - FROM)).round() as i32;
        root.draw(&text(bar.name.clone(), (16, top + 4), 15))?;
        root.draw(&Rectangle::new(
            [(FROM, top + 3), (end, top + ROW - 5)],
            bar.colour.filled(),
        ))?;
        root.draw(&text(format!("{:.2}", bar.psnr_db), (end + 6, top + 4), 15))?;
    }
    Ok(root.present()?)
}
