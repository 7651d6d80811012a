//! Formats the tables.

use super::ablation;
use super::report::{ReproduceReport, TableReport};
use crate::bench::aligned;

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
        out += &ablation::markdown(&table.ablations);
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
    out += if counted == all && table.rows.len() == all {
        ".\n\n"
    } else {
        ": the two do not compare yet.\n\n"
    };
    out += &aligned(&beside(table));
    out += &format!("\n{}\n\n![{}]({})\n", table.caveat, table.protocol, table.plot_file());
    out
}

fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters
        .next()
        .map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

fn ours(table: &TableReport) -> Vec<Vec<String>> {
    let has = |name: &str| table.rows.iter().any(|row| row.others.contains_key(name));
    let scores: Vec<_> = SCORES.into_iter().filter(|(name, ..)| has(name)).collect();
    let mut head: Vec<String> = ["scene", "views", "PSNR dB", "SSIM"].map(String::from).to_vec();
    head.extend(scores.iter().map(|(_, title, _)| (*title).to_owned()));
    head.extend(["poses", "training s", "steps", "splats", "images/s", "device"].map(String::from));
    let mut lines = vec![head];
    for row in &table.rows {
        let mut line = vec![
            row.scene.clone(),
            row.views.to_string(),
            number(Some(row.psnr_db), 2),
            number(Some(row.ssim), 4),
        ];
        line.extend(
            scores
                .iter()
                .map(|&(name, _, digits)| number(row.others.get(name).copied(), digits)),
        );
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
    let head = [
        "method",
        "PSNR dB",
        "SSIM",
        "LPIPS Alex",
        "poses",
        "training",
        "images/s",
        "scenes",
        "source",
    ];
    let mean = |name: &str| table.mean.get(name).copied();
    let first = |names: &[&str]| names.iter().find_map(|name| mean(name));
    let mut lines = vec![head.map(String::from).to_vec()];
    let poses: std::collections::BTreeSet<&str> = table.rows.iter().map(|r| r.poses.as_str()).collect();
    lines.push(vec![
        "this run".to_owned(),
        number(mean("headline"), 2),
        number(
            first(&[
                "ssim_dycheck_masked_masked",
                "ssim_skimage_uniform",
                "ssim_gaussian_zero_padded",
                "ssim",
            ]),
            3,
        ),
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
            number(
                p.frames_per_s,
                if p.frames_per_s.is_some_and(|f| f < 10.0) { 2 } else { 0 },
            ),
            p.scenes.map_or("-".to_owned(), |n| n.to_string()),
            p.source.to_owned(),
        ]);
    }
    lines
}
