//! The tables of a reproduction, as Markdown and as images.

use super::report;
use super::report::{ReproduceReport, TableReport};
use crate::bench::aligned;
use crate::{Category, Refusal};
use plotters::prelude::*;
use std::path::Path;

/// Scores that have a column where a row has them: name, title, digits.
const SCORES: [(&str, &str, usize); 11] = [
    ("psnr_joint_masked", "mPSNR dB", 2),
    ("ssim_dycheck_masked", "mSSIM", 4),
    ("ssim_dycheck_masked_masked", "mSSIM", 4),
    ("lpips_alex_masked", "mLPIPS Alex", 4),
    ("psnr_eight_bit", "PSNR 8 bit dB", 2),
    ("ssim_skimage_uniform", "SSIM scikit-image", 4),
    ("psnr_per_channel", "PSNR per channel dB", 2),
    ("psnr_per_channel_unclamped", "the same, unclamped", 2),
    ("ssim_gaussian_zero_padded", "SSIM zero-padded", 4),
    ("lpips_alex", "LPIPS Alex", 4),
    ("lpips_vgg", "LPIPS VGG", 4),
];

pub(super) fn markdown(report: &ReproduceReport) -> String {
    let mut out = format!(
        "# {}\n\nminute4d {}, {}, profile {}, {} threads.\n",
        report.suite.title(),
        report.minute4d,
        report.date,
        report.profile.name(),
        report.threads
    );
    for table in &report.tables {
        out += &one(table);
        out += &report::markdown(&table.ablations);
    }
    if !report.missing.is_empty() {
        out += "\n## Scenes that are not here\n\n";
        for scene in &report.missing {
            out += &format!("- {}: {}\n", scene.scene, scene.why);
        }
        out += &format!("\n{}.\n", report.suite.source());
    }
    out
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |v| format!("{v:.digits$}"))
}

fn one(table: &TableReport) -> String {
    let rules = table.protocol.rules();
    let mut out = format!(
        "\n## {}: {}\n\nTask: {}. Held out: {}. {}.\n\n",
        table.protocol,
        rules.title,
        table.task.title(),
        rules.frames.description(),
        sentence(rules.note)
    );
    out += &aligned(&ours(table));
    let row = |r: &super::SceneRow| format!("{} {}x{}", r.mask, r.size_px[0], r.size_px[1]);
    let how: std::collections::BTreeSet<String> = table.rows.iter().map(row).collect();
    for how in how {
        out += &format!("\nScored: {how} pixels.\n");
    }
    let [counted, all] = table.scenes_of_published;
    if table.published.is_empty() {
        out += &format!("\n{}\n", table.caveat);
        return out;
    }
    out +=
        &format!("\n### Published, the same task\n\nOur mean is over {counted} of the {all} scenes of published means");
    out += if counted == all && table.rows.len() == all { ".\n\n" } else { ": the two do not compare yet.\n\n" };
    out += &aligned(&beside(table));
    out += &format!("\n{}\n\n![{}]({})\n", table.caveat, table.protocol, table.plot_file());
    out
}

fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

fn ours(table: &TableReport) -> Vec<Vec<String>> {
    let has = |name: &str| table.rows.iter().any(|row| row.others.contains_key(name));
    let scores: Vec<_> = SCORES.into_iter().filter(|(name, ..)| has(name)).collect();
    let mut head: Vec<String> = ["scene", "views", "PSNR dB", "SSIM"].map(String::from).to_vec();
    head.extend(scores.iter().map(|(_, title, _)| (*title).to_owned()));
    head.extend(["poses", "training s", "steps", "splats", "images/s", "device"].map(String::from));
    let mut lines = vec![head];
    for row in &table.rows {
        let mut line =
            vec![row.scene.clone(), row.views.to_string(), number(Some(row.psnr_db), 2), number(Some(row.ssim), 4)];
        line.extend(scores.iter().map(|&(name, _, digits)| number(row.others.get(name).copied(), digits)));
        line.extend([
            row.poses.clone(),
            number(row.train_s, 1),
            row.iterations.map_or("-".to_owned(), |n| n.to_string()),
            row.splats.to_string(),
            number(row.frames_per_s, 0),
            row.device.clone(),
        ]);
        lines.push(line);
    }
    let mean = |name: &str| table.mean.get(name).copied();
    let mut line = vec![
        format!("mean of {}", table.rows.len()),
        String::new(),
        number(mean("psnr_db"), 2),
        number(mean("ssim"), 4),
    ];
    line.extend(scores.iter().map(|&(name, _, digits)| number(mean(name), digits)));
    line.extend([
        String::new(),
        number(mean("train_s"), 1),
        String::new(),
        String::new(),
        number(mean("frames_per_s"), 0),
        String::new(),
    ]);
    lines.push(line);
    lines
}

/// Ours and the published numbers, one task.
fn beside(table: &TableReport) -> Vec<Vec<String>> {
    let head = ["method", "PSNR dB", "SSIM", "LPIPS Alex", "poses", "training", "images/s", "scenes", "source"];
    let mean = |name: &str| table.mean.get(name).copied();
    let first = |names: &[&str]| names.iter().find_map(|name| mean(name));
    let mut lines = vec![head.map(String::from).to_vec()];
    let poses: std::collections::BTreeSet<&str> = table.rows.iter().map(|r| r.poses.as_str()).collect();
    lines.push(vec![
        "this run".to_owned(),
        number(mean("headline"), 2),
        number(first(&["ssim_dycheck_masked_masked", "ssim_skimage_uniform", "ssim_gaussian_zero_padded", "ssim"]), 3),
        number(first(&["lpips_alex_masked", "lpips_alex"]), 3),
        poses.into_iter().collect::<Vec<_>>().join(", "),
        mean("train_s").map_or("-".to_owned(), |s| format!("{s:.1} s")),
        number(mean("frames_per_s"), 0),
        table.rows.len().to_string(),
        "measured".to_owned(),
    ]);
    for p in &table.published {
        lines.push(vec![
            p.method.to_owned(),
            number(Some(p.psnr_db), 2),
            number(p.ssim, 3),
            number(p.lpips, 3),
            p.poses.unwrap_or("-").to_owned(),
            p.training.unwrap_or("-").to_owned(),
            number(p.frames_per_s, if p.frames_per_s.is_some_and(|f| f < 10.0) { 2 } else { 0 }),
            p.scenes.map_or("-".to_owned(), |n| n.to_string()),
            p.source.to_owned(),
        ]);
    }
    lines
}

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
///
/// # Errors
///
/// A refusal if it cannot be written.
pub(super) fn write(path: &Path, table: &TableReport) -> Result<(), Refusal> {
    let mut bars: Vec<Bar> = Vec::new();
    let mut ours = |name: String, value: Option<f64>| {
        bars.extend(value.filter(|v| v.is_finite()).map(|psnr_db| Bar { name, psnr_db, colour: OURS }));
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
        let message = format!("cannot write {}: {what}", path.display());
        Refusal::new(Category::CannotWrite, message)
    })
}

fn draw(path: &Path, table: &TableReport, bars: &[Bar]) -> Result<(), String> {
    let message = |e: &dyn std::fmt::Display| e.to_string();
    let height = TOP + ROW * bars.len() as i32 + 24;
    let root = SVGBackend::new(path, (WIDTH as u32, height as u32)).into_drawing_area();
    root.fill(&WHITE).map_err(|e| message(&e))?;
    let text = |words: String, at: (i32, i32), size: i32| Text::new(words, at, ("sans-serif", size).into_font());
    let title = format!("{}: {}", table.suite.title(), table.protocol.rules().title);
    root.draw(&text(title, (16, 12), 18)).map_err(|e| message(&e))?;
    let unit = format!("{} of {}, dB; bars begin at 10 dB", table.headline, table.task.title());
    root.draw(&text(unit, (16, 36), 14)).map_err(|e| message(&e))?;
    let most = bars.iter().map(|b| b.psnr_db).fold(20.0, f64::max);
    for (i, bar) in bars.iter().enumerate() {
        let top = TOP + ROW * i as i32;
        let share = ((bar.psnr_db - 10.0) / (most - 10.0)).clamp(0.0, 1.0);
        let end = FROM + (share * f64::from(TO - FROM)).round() as i32;
        root.draw(&text(bar.name.clone(), (16, top + 4), 15)).map_err(|e| message(&e))?;
        let rectangle = Rectangle::new([(FROM, top + 3), (end, top + ROW - 5)], bar.colour.filled());
        root.draw(&rectangle).map_err(|e| message(&e))?;
        let value = format!("{:.2}", bar.psnr_db);
        root.draw(&text(value, (end + 6, top + 4), 15)).map_err(|e| message(&e))?;
    }
    root.present().map_err(|e| message(&e))
}
