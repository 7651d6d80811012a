//! Reproduces published tables: imports, splits, trains and scores every available scene of a data
//! set.
//!
//! ```text
//! folder of a data set --Suite--> scenes --import, or geometry of a video--> capture --split--> capture of the protocol
//!   --train--> scene --evaluate by the protocol--> eval.json --> a table per protocol, beside published numbers of the same task
//!   --without each part--> the ablations
//! ```
//!
//! Finished scenes are not run again: a scene is skipped if its record has the key of its data, its
//! settings and its device. The two tasks have separate tables ([`minute4d_eval::Task`]), and our
//! results are separate from published ones, which were measured on other machines, most with other
//! poses.

mod plot;
mod published;
mod report;
mod scene;
mod suite;

pub use report::{MissingScene, ReproduceReport, SceneAblation, TableReport, UsedSettings};
pub use suite::Suite;

use crate::ablate::{self, AblateOptions, Row};
use crate::bench::today;
use m4_io::atomic;
use m4_io::results::Kind;
use minute4d::json::write_json;
use minute4d::{Category, Refusal};
use minute4d_cli::run::Job;
use minute4d_eval::Error;
use minute4d_eval::Protocol;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Name of the report in numbers.
pub const REPORT_FILE: &str = "reproduce.json";
/// Name of the tables.
pub const TABLE_FILE: &str = "reproduce.md";

/// Pixels by which masks of dynamic regions are grown before they are scored, in ablations.
const GROW_MASK: usize = 2;

/// Whose poses and depth a scene is trained with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum GeometrySource {
    /// Those that the data set brings; of a data set without any, as [`Self::Own`].
    #[default]
    Given,
    /// Those of [`minute4d::geometry`], from the training images alone.
    Own,
}

/// The options of a reproduction.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ReproduceOptions {
    /// Which protocols; those of the data set where empty.
    pub protocols: Vec<Protocol>,
    /// Which scenes; those of the published tables where empty.
    pub scenes: Vec<String>,
    /// By how much the images of a data set are shrunk; `None` for what published numbers use.
    pub factor: Option<u32>,
    /// Refine the poses of test images where peers do.
    pub refine_poses: bool,
    /// The source of poses and depth.
    pub geometry: GeometrySource,
    /// The program itself, to make every scene again without each part of the method
    /// ([`mod@crate::ablate`]); `None` to leave that out.
    pub ablations: Option<PathBuf>,
}

/// Makes the tables of a data set in the folder `out` with the settings of `job`
/// ([`Suite::settings`]): `reproduce.md`, `reproduce.json`, and an image a table. Scenes that are
/// finished are not made again; [`Job::existing`] is of no meaning.
///
/// # Errors
///
/// [`minute4d::Error::Refused`] where no scene of the data set is in `data`, with where people get
/// them; [`Error`] of the scene that failed, when those before it are kept.
pub fn reproduce(
    suite: Suite,
    data: &Path,
    out: &Path,
    options: &ReproduceOptions,
    job: &Job<'_>,
) -> Result<ReproduceReport, Error> {
    if !data.is_dir() {
        return Err(minute4d::Error::missing("folder of the data set", data).into());
    }
    job.check()?;
    let protocols = suite.protocols_of(&options.protocols)?;
    let (scenes, missing) = suite.find(data, &options.scenes);
    if scenes.is_empty() {
        let missing: Vec<String> = missing
            .iter()
            .map(|m| format!("{} ({})", m.scene, m.why))
            .collect();
        let message = format!(
            "no scene of {suite} is in {}: {}. {}",
            data.display(),
            missing.join(", "),
            suite.facts().source
        );
        return Err(Refusal::new(Category::NoInput, message).into());
    }
    for scene in &missing {
        job.observer.warn(&format!(
            "{}: {}; {}",
            scene.scene,
            scene.why,
            suite.facts().source
        ));
    }
    let total = scenes.len() * protocols.len();
    let mut done = 0;
    let mut tables: Vec<TableReport> = Vec::new();
    for &protocol in &protocols {
        let (mut rows, mut ablations) = (Vec::new(), Vec::new());
        for scene in &scenes {
            job.observer
                .update("scenes", done, total, &format!("{protocol} {}", scene.name));
            let result = scene::make(suite, scene, protocol, out, options, job)?;
            if let Some(program) = &options.ablations {
                let options = AblateOptions {
                    program: program.clone(),
                    rows: Row::ALL.to_vec(),
                    data: Some(result.views),
                    grow_mask: GROW_MASK,
                };
                let report = ablate::ablate(
                    &result.capture,
                    &result.folder.join("ablation"),
                    &options,
                    job,
                )?;
                ablations.push(SceneAblation {
                    scene: result.row.scene.clone(),
                    report,
                });
            }
            rows.push(result.row);
            done += 1;
            job.observer.update("scenes", done, total, "");
        }
        tables.push(TableReport::new(suite, protocol, rows, ablations));
    }
    let report = ReproduceReport {
        format: "minute4d-reproduce".to_owned(),
        version: 1,
        minute4d: env!("CARGO_PKG_VERSION").to_owned(),
        date: today(),
        suite,
        data: data.to_path_buf(),
        profile: job.settings.profile,
        settings: UsedSettings::of(&job.settings),
        threads: minute4d_cli::run::threads(),
        tables,
        missing,
    };
    let plots: Vec<String> = report.tables.iter().map(TableReport::plot_file).collect();
    let files = [REPORT_FILE, TABLE_FILE]
        .into_iter()
        .chain(plots.iter().map(String::as_str));
    minute4d::layout::claim(out, Kind::Report, &files.collect::<Vec<_>>())?;
    for table in &report.tables {
        plot::write_plot(&out.join(table.plot_file()), table)?;
    }
    write_json(&out.join(REPORT_FILE), &report)?;
    let path = out.join(TABLE_FILE);
    atomic::write(&path, report.to_markdown().as_bytes())
        .map_err(|source| minute4d::Error::Write { path, source })?;
    Ok(report)
}
