//! The report of a reproduction: its numbers, its tables as Markdown, and its plots.

use super::Suite;
use super::published::{Published, caveat, published};
use crate::ablate::AblationReport;
use crate::bench::{aligned, number};
use minute4d::settings::{Profile, Settings};
use minute4d_eval::{Protocol, Task};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// `reproduce.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReproduceReport {
    pub(super) format: String,
    pub(super) version: u32,
    pub(super) minute4d: String,
    pub(super) date: String,
    pub(super) suite: Suite,
    pub(super) data: PathBuf,
    pub(super) profile: Profile,
    pub(super) settings: UsedSettings,
    pub(super) threads: usize,
    pub(super) tables: Vec<TableReport>,
    /// Scenes that are missing, and what they lack.
    pub(super) missing: Vec<MissingScene>,
}

/// The settings that the paper states for each data set, as they were here ([`Suite::settings`]).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UsedSettings {
    /// Steps, where `budget_s` is 0.
    iterations: usize,
    /// Seconds of optimisation that the steps were chosen for.
    budget_s: f64,
    /// Frames between two searches for new objects.
    instance_interval: usize,
    /// Frames between two frames in which points of TAPIP3D start.
    track_stride: usize,
    /// Probability of motion above which a pixel is dynamic.
    motion_threshold: f32,
}

impl UsedSettings {
    pub(super) fn of(settings: &Settings) -> Self {
        let (train, enhance) = (&settings.train, &settings.enhance);
        Self {
            iterations: train.iterations,
            budget_s: train.budget_s,
            instance_interval: enhance.masks.every_frames,
            track_stride: enhance.tapip3d.every,
            motion_threshold: enhance.masks.tau,
        }
    }
}

impl std::fmt::Display for UsedSettings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.budget_s > 0.0 {
            true => write!(f, "{} s of training", self.budget_s)?,
            false => write!(f, "{} iterations", self.iterations)?,
        }
        let Self {
            instance_interval,
            track_stride,
            motion_threshold,
            ..
        } = self;
        write!(
            f,
            ", instance interval {instance_interval}, tracking stride {track_stride}, motion threshold {motion_threshold}"
        )
    }
}

/// A scene that is missing.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MissingScene {
    pub(super) scene: String,
    pub(super) why: String,
}

/// One table: scenes of one data set by one protocol.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TableReport {
    pub(super) suite: Suite,
    pub(super) protocol: Protocol,
    pub(super) task: Task,
    /// Name of the score that stands for it.
    pub(super) headline: String,
    pub(super) rows: Vec<SceneRow>,
    /// Means over them, by name: `headline`, `psnr_db`, `ssim`, the other scores, `train_s`,
    /// `frames_per_s`.
    pub(super) mean: BTreeMap<String, f64>,
    /// Over how many of the scenes of the published mean ours is.
    pub(super) scenes_of_published: [usize; 2],
    /// The scenes again without each part of the method, where that was asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) ablations: Vec<SceneAblation>,
    /// Published numbers of the same task.
    pub(super) published: Vec<Published>,
    pub(super) caveat: &'static str,
}

/// A scene by a protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneRow {
    pub(super) scene: String,
    /// Views scored.
    pub(super) views: usize,
    /// The score that stands for the protocol, mean over views; absent where no view has it.
    pub(super) headline: Option<f64>,
    /// PSNR of whole images, joint over channels, clamped, dB.
    pub(super) psnr_db: f64,
    pub(super) ssim: f64,
    /// Means of the other scores.
    pub(super) others: BTreeMap<String, f64>,
    /// Whose poses the scene was trained with (`own`: found from the images), and how test images
    /// got theirs.
    pub(super) poses: String,
    /// Where scores count, in words.
    pub(super) mask: String,
    pub(super) size_px: [usize; 2],
    /// Wall-clock seconds of the first splats and their optimisation.
    pub(super) train_s: Option<f64>,
    /// Wall-clock seconds of the geometry, where it was estimated here.
    pub(super) geometry_s: Option<f64>,
    /// Steps of optimisation.
    pub(super) iterations: Option<usize>,
    pub(super) splats: usize,
    /// Images a second while judging, each copied to the host.
    pub(super) frames_per_s: Option<f64>,
    pub(super) device: String,
}

impl TableReport {
    pub(super) fn new(
        suite: Suite,
        protocol: Protocol,
        rows: Vec<SceneRow>,
        ablations: Vec<SceneAblation>,
    ) -> Self {
        let rules = protocol.rules();
        let published_scenes = suite.scenes(protocol);
        let counted = rows
            .iter()
            .filter(|r| published_scenes.contains(&r.scene.as_str()))
            .count();
        let mut sums: BTreeMap<String, (f64, usize)> = BTreeMap::new();
        for row in &rows {
            let own = [
                ("headline", row.headline),
                ("psnr_db", Some(row.psnr_db)),
                ("ssim", Some(row.ssim)),
                ("train_s", row.train_s),
                ("frames_per_s", row.frames_per_s),
            ];
            let own = own
                .into_iter()
                .filter_map(|(name, v)| Some((name.to_owned(), v?)));
            for (name, value) in own.chain(row.others.clone()) {
                let sum = sums.entry(name).or_default();
                *sum = (sum.0 + value, sum.1 + 1);
            }
        }
        // a mean over some of the rows would stand beside means over all
        let whole = sums.into_iter().filter(|(_, (_, n))| *n == rows.len());
        let mean = whole
            .map(|(name, (sum, n))| (name, sum / n as f64))
            .collect();
        Self {
            suite,
            protocol,
            task: rules.task,
            headline: rules.headline.unwrap_or("psnr_db").to_owned(),
            rows,
            mean,
            scenes_of_published: [counted, published_scenes.len()],
            ablations,
            published: published(protocol).to_vec(),
            caveat: caveat(protocol),
        }
    }

    /// File name of its plot.
    pub fn plot_file(&self) -> String {
        format!("reproduce-{}.svg", self.protocol)
    }

    /// Returns the name of our mean.
    pub(super) fn ours(&self) -> String {
        let [counted, all] = self.scenes_of_published;
        format!(
            "this run ({counted} of {all} scenes, poses {})",
            self.poses(" and ")
        )
    }

    /// Where the poses of the rows come from.
    fn poses(&self, separator: &str) -> String {
        let poses: BTreeSet<&str> = self.rows.iter().map(|r| r.poses.as_str()).collect();
        Vec::from_iter(poses).join(separator)
    }
}

/// What each part of the method is worth on a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneAblation {
    pub(super) scene: String,
    /// The rows; PSNR and SSIM are of whole images (clamped, 8 bits), whatever the protocol's
    /// headline is.
    pub(super) report: AblationReport,
}

/// The part of the page on ablations; empty without any.
fn ablations(scenes: &[SceneAblation]) -> String {
    if scenes.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "\n### Without each part\n\nThe same steps for all rows; PSNR and SSIM of whole images in 8 bits. The paper's own (table 3, DyCheck by its split): \
         full 25.77 dB, 0.717, 29.2 s, 1088 MB; without segmentation and tracking 24.60 dB, 0.628, 31.8 s, 1064 MB; without loss-guided density \
         control 25.74 dB, 0.694, 397.7 s, 9406 MB.\n",
    );
    for scene in scenes {
        out += &format!("\n#### {}\n\n{}", scene.scene, scene.report.to_markdown());
    }
    out
}

impl ReproduceReport {
    /// The tables as Markdown.
    pub fn to_markdown(&self) -> String {
        let mut out = format!(
            "# {}\n\nminute4d {}, {}, profile {} ({}), {} threads.\n",
            self.suite.facts().title,
            self.minute4d,
            self.date,
            self.profile.name(),
            self.settings,
            self.threads
        );
        for table in &self.tables {
            out += &one(table);
            out += &ablations(&table.ablations);
        }
        if !self.missing.is_empty() {
            out += "\n## Scenes that are not here\n\n";
            for scene in &self.missing {
                out += &format!("- {}: {}\n", scene.scene, scene.why);
            }
            out += &format!("\n{}.\n", self.suite.facts().source);
        }
        out
    }
}

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
    let row = |r: &SceneRow| format!("{} {}x{}", r.mask, r.size_px[0], r.size_px[1]);
    let how: BTreeSet<String> = table.rows.iter().map(row).collect();
    for how in how {
        out += &format!("\nScored: {how} pixels.\n");
    }
    let [counted, all] = table.scenes_of_published;
    if table.published.is_empty() {
        out += &format!("\n{}\n", table.caveat);
        return out;
    }
    out += &format!(
        "\n### Published, the same task\n\nOur mean is over {counted} of the {all} scenes of published means"
    );
    out += if counted == all && table.rows.len() == all {
        ".\n\n"
    } else {
        ": the two do not compare yet.\n\n"
    };
    out += &aligned(&beside(table));
    out += &format!(
        "\n{}\n\n![{}]({})\n",
        table.caveat,
        table.protocol,
        table.plot_file()
    );
    out
}

fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

fn ours(table: &TableReport) -> Vec<Vec<String>> {
    let has = |name: &str| table.rows.iter().any(|row| row.others.contains_key(name));
    let scores: Vec<_> = SCORES.into_iter().filter(|(name, ..)| has(name)).collect();
    let mut head: Vec<String> = ["scene", "views", "PSNR dB", "SSIM"]
        .map(String::from)
        .to_vec();
    head.extend(scores.iter().map(|(_, title, _)| (*title).to_owned()));
    head.extend(
        [
            "poses",
            "training s",
            "steps",
            "splats",
            "images/s",
            "device",
        ]
        .map(String::from),
    );
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
            number(row.iterations.map(|n| n as f64), 0),
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
    line.extend(
        scores
            .iter()
            .map(|&(name, _, digits)| number(mean(name), digits)),
    );
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
    let mean = |name: &str| table.mean.get(name).copied();
    let first = |names: &[&str]| names.iter().find_map(|name| mean(name));
    let mut lines = published_lines(&table.published);
    let ours = vec![
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
        table.poses(", "),
        mean("train_s").map_or("-".to_owned(), |s| format!("{s:.1} s")),
        number(mean("frames_per_s"), 0),
        table.rows.len().to_string(),
        "measured".to_owned(),
    ];
    lines.insert(1, ours);
    lines
}

/// Published numbers under a head.
pub(super) fn published_lines(rows: &[Published]) -> Vec<Vec<String>> {
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
    let mut lines = vec![head.map(String::from).to_vec()];
    for p in rows {
        lines.push(vec![
            p.method.to_owned(),
            number(Some(p.psnr_db), 2),
            number(p.ssim, 3),
            number(p.lpips, 3),
            p.poses.unwrap_or("-").to_owned(),
            p.training.unwrap_or("-").to_owned(),
            number(
                p.frames_per_s,
                if p.frames_per_s.is_some_and(|f| f < 10.0) {
                    2
                } else {
                    0
                },
            ),
            number(p.scenes.map(|n| n as f64), 0),
            p.source.to_owned(),
        ]);
    }
    lines
}
