//! What each kind of error costs: one kind of estimate is replaced by the truth, and the capture is
//! warped into the held-out views, or trained and scored.

use m4_core::CaptureFrame;
use m4_eval::geometry::{Substitutes, Substitution};
use m4_eval::image::MeanScore;
use m4_eval::warp::Warp;
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::results::{Kind, ResultFolder};
use minute4d::Observer;
use minute4d_cli::run::Job;
use minute4d_eval::{
    Error, EvalOptions, SetScore, mean_of, no_test_list, read_truth, read_views, views,
};
use serde::Serialize;
use std::path::Path;

/// One substitution over one set of held-out views.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExplainRow {
    /// What was true.
    pub what: Substitution,
    /// Its name.
    pub name: &'static str,
    /// The set of views: far or near.
    pub set: String,
    /// Scores of the warped capture.
    pub warped: MeanScore,
    /// Scores of the scene trained on it, where that was asked for.
    pub trained: Option<MeanScore>,
}

/// Replaces each kind of estimate of `capture` by that of the scene `truth` and scores the far and
/// near views by warping; with a folder and a job, also trains each in a folder of its own
/// (finished ones are kept).
///
/// # Errors
///
/// What cannot be read or written; [`Error::ScoreGeometry`] if the two cannot be compared;
/// [`minute4d::Error::Refused`] without held-out views.
pub fn explain(
    capture: &Path,
    truth: &Path,
    options: &CaptureOptions,
    training: Option<(&Path, &Job<'_>)>,
    observer: &dyn Observer,
) -> Result<Vec<ExplainRow>, Error> {
    let estimate = capture::read(capture, Split::Train, options, observer)?;
    let ground_truth = read_truth(truth, options, observer)?;
    let mut lists = Vec::new();
    for (set, split) in [("far", Split::Test), ("near", Split::Near)] {
        lists.extend(read_views(truth, split, options, observer)?.map(|views| (set, views)));
    }
    if lists.is_empty() {
        return Err(no_test_list(truth).into());
    }
    let substitutes = Substitutes::new(&estimate, &ground_truth)?;
    let mut rows = Vec::new();
    for (i, (what, name)) in Substitution::ALL.into_iter().enumerate() {
        observer.update("explain", i, Substitution::ALL.len(), name);
        let replaced = substitutes.capture(what);
        let trained = training
            .map(|(folder, job)| {
                trained(
                    &folder.join(name.replace(' ', "-")),
                    job,
                    &replaced,
                    truth,
                    options,
                )
            })
            .transpose()?;
        let warp = Warp::new(&replaced);
        for (set, views) in &lists {
            let share = |view: &CaptureFrame| view.t / (views.time_frames.max(2) - 1) as f64;
            let warped = mean_of(&views.frames, &|view| warp.view(&view.camera, share(view)))?;
            let trained = trained
                .as_ref()
                .and_then(|t| t.iter().find(|row| row.set == *set))
                .map(|row| row.mean);
            rows.extend(warped.map(|warped| ExplainRow {
                what,
                name,
                set: (*set).to_owned(),
                warped,
                trained,
            }));
        }
    }
    observer.update(
        "explain",
        Substitution::ALL.len(),
        Substitution::ALL.len(),
        "done",
    );
    Ok(rows)
}

/// Trains a scene on a capture and scores it.
fn trained(
    folder: &Path,
    job: &Job<'_>,
    replaced: &m4_core::Capture,
    truth: &Path,
    options: &CaptureOptions,
) -> Result<Vec<SetScore>, Error> {
    let (data, out) = (
        folder.join(minute4d::layout::CAPTURE_FOLDER),
        folder.join("scene"),
    );
    let mut results = ResultFolder::open(&data, Kind::Capture)?;
    results.check_free(minute4d::layout::capture_names())?;
    capture::write(&results.begin()?, replaced, Split::Train, job.observer)?;
    results.commit(None)?;
    minute4d_cli::run::train::make(&data, &out, job, false)?;
    let options = EvalOptions {
        reach: options.reach,
        ..EvalOptions::default()
    };
    Ok(views(&out, truth, &options, job.observer)?.sets)
}

/// The rows as a table for people.
#[must_use]
pub fn explain_table(rows: &[ExplainRow]) -> String {
    let cell = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.2}"));
    let score = |m: &MeanScore| {
        format!(
            "{:.2} / {} / {}",
            m.psnr_db,
            cell(m.masked_psnr_db),
            cell(m.static_psnr_db)
        )
    };
    let mut out = format!(
        "{:<22} {:<5} {:<24} trained\n",
        "whole/dynamic/static", "set", "warped"
    );
    for r in rows {
        let trained = r.trained.as_ref().map_or("-".to_owned(), score);
        out += &format!(
            "{:<22} {:<5} {:<24} {trained}\n",
            r.name,
            r.set,
            score(&r.warped)
        );
    }
    out
}
