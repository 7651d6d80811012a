//! The tables of `docs/results.md`, measured again.
//!
//! Everything goes through the program as a user would run it; rows are read from the files it leaves
//! (`run.json`, `eval.json`) or prints (`eval-geometry`).

mod ablation;
mod raw;

pub use ablation::ablation;
pub use raw::raw;

use crate::plot::{self, Curve};
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A training that one row of the held-out table shows.
struct Variant {
    name: &'static str,
    args: &'static [&'static str],
}

const VARIANTS: [Variant; 4] = [
    Variant { name: "fast", args: &["--profile", "fast"] },
    Variant { name: "fast, no density control", args: &["--profile", "fast", "--set", "train.density.enabled=false"] },
    Variant { name: "faithful", args: &["--profile", "faithful"] },
    Variant {
        name: "faithful, no density control",
        args: &["--profile", "faithful", "--set", "train.density.enabled=false"],
    },
];

/// Trains each scene in every variant with its own geometry and scores the held-out views: one Markdown
/// row each, returned together.
///
/// # Errors
///
/// If the program cannot be built or started, ends with an error, or leaves a file that cannot be read.
pub fn held_out(root: &Path, scenes: &[&str], work: &Path) -> Result<String> {
    let program = program(root)?;
    let mut table = String::from(
        "| scene | profile | splats | seconds | PSNR | SSIM | PSNR moving | SSIM moving |\n|---|---|---|---|---|---|---|---|\n",
    );
    for scene in scenes {
        let name = stem(scene);
        for variant in &VARIANTS {
            let out = work.join(format!("{name}-{}", variant.name.replace([',', ' '], "")));
            let out_text = out.to_string_lossy().into_owned();
            let mut train = vec!["train", scene, "-o", &out_text, "--force", "--quiet"];
            train.extend(variant.args);
            run(&program, &train)?;
            run(&program, &["eval", &out_text, "--data", scene, "--quiet"])?;
            let (record, eval) = (json(&out.join("run.json"))?, json(&out.join("eval.json"))?);
            let mean = &eval["mean"];
            table += &format!(
                "| {name} | {} | {} | {:.0} | {:.2} | {:.3} | {:.2} | {:.3} |\n",
                variant.name,
                eval["splats"],
                number(&record["stages"]["train"]["seconds"]),
                number(&mean["psnr_db"]),
                number(&mean["ssim"]),
                number(&mean["masked_psnr_db"]),
                number(&mean["masked_ssim"]),
            );
        }
    }
    Ok(table)
}

/// The last line of the metrics of a run.
fn last_metrics(run: &Path) -> Result<Value> {
    let path = run.join("metrics.jsonl");
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let last = text.lines().last().with_context(|| format!("{} is empty", path.display()))?;
    serde_json::from_str(last).with_context(|| format!("{}: the last line is not JSON", path.display()))
}

/// Trains each scene in both profiles for this many seconds of optimisation and scores the held-out views: one Markdown
/// row each, returned together, and `time-to-quality.svg` in `work`.
///
/// # Errors
///
/// As [`held_out`].
pub fn time_to_quality(root: &Path, seconds: &[f64], scenes: &[&str], work: &Path) -> Result<String> {
    let program = program(root)?;
    let mut curves = Vec::new();
    let mut table = String::from(
        "| scene | profile | seconds asked | iterations | PSNR | SSIM | PSNR moving | seconds taken |\n|---|---|---|---|---|---|---|---|\n",
    );
    for scene in scenes {
        let name = stem(scene);
        for profile in ["fast", "faithful"] {
            let mut curve = Curve { name: format!("{name}, {profile}"), points: Vec::new() };
            for &s in seconds {
                let out = work.join(format!("{name}-{profile}-{s}s"));
                let out_text = out.to_string_lossy().into_owned();
                let budget = format!("train.budget_s={s:?}");
                let train = ["train", scene, "-o", &out_text, "--force", "--quiet", "--profile", profile];
                run(&program, &[&train[..], &["--set", &budget]].concat())?;
                run(&program, &["eval", &out_text, "--data", scene, "--quiet"])?;
                let (record, eval) = (json(&out.join("run.json"))?, json(&out.join("eval.json"))?);
                let mean = &eval["mean"];
                let psnr = number(&mean["psnr_db"]);
                curve.points.push((s, psnr));
                table += &format!(
                    "| {name} | {profile} | {s} | {} | {psnr:.2} | {:.3} | {:.2} | {:.0} |\n",
                    record["iterations"],
                    number(&mean["ssim"]),
                    number(&mean["masked_psnr_db"]),
                    number(&last_metrics(&out)?["seconds"]),
                );
            }
            curves.push(curve);
        }
    }
    plot::time_to_quality(&work.join("time-to-quality.svg"), &curves)?;
    Ok(table)
}

/// Recovers the geometry of each input from its images alone and compares it with the truth, pairs
/// `input=truth`: one Markdown row each, returned together. Options of `minute4d geometry`, each with its value, may come
/// before the pairs (`--frontend raft`).
///
/// # Errors
///
/// As [`held_out`], or if a pair has no `=`, or there is none.
pub fn geometry(root: &Path, args: &[&str], work: &Path) -> Result<String> {
    let program = program(root)?;
    let (options, pairs) = options(args)?;
    let mut table = String::from(
        "| input | seconds | trajectory, % of path | rotation, mean deg | focal, % | depth AbsRel static | moving | mask IoU | precision | recall |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for pair in pairs {
        let (input, truth) = pair.split_once('=').with_context(|| format!("{pair}: expected INPUT=TRUTH"))?;
        let name = stem(truth.strip_suffix("/precomputed.json").unwrap_or(truth));
        let out = work.join(format!("{name}-capture"));
        let out_text = out.to_string_lossy().into_owned();
        let start = std::time::Instant::now();
        let all = ["geometry", input, "-o", &out_text, "--force", "--quiet"];
        run(&program, &[&all, options].concat())?;
        let seconds = start.elapsed().as_secs_f64();
        let text = run(&program, &["eval-geometry", &out_text, "--truth", truth, "--quiet"])?;
        let report: Value = serde_json::from_str(&text).context("eval-geometry printed no JSON")?;
        let cell = |value: &Value, digits: usize| match value.as_f64() {
            Some(v) => format!("{v:.digits$}"),
            None => "-".to_owned(),
        };
        table += &format!(
            "| {name} | {seconds:.0} | {} | {} | {} | {} | {} | {} | {} | {} |\n",
            cell(&report["trajectory"]["rmse_percent"], 2),
            cell(&report["rotation"]["mean_deg"], 2),
            cell(&report["focal_error_percent"], 1),
            cell(&report["depth"]["static_abs_rel"], 3),
            cell(&report["depth"]["moving_abs_rel"], 3),
            cell(&report["mask"]["iou"], 2),
            cell(&report["mask"]["precision"], 2),
            cell(&report["mask"]["recall"], 2),
        );
    }
    Ok(table)
}

/// What comes before the inputs: options of `minute4d geometry`, each with its value.
fn options<'a, 'b>(args: &'b [&'a str]) -> Result<(&'b [&'a str], &'b [&'a str])> {
    let mut at = 0;
    while args.get(at).is_some_and(|a| a.starts_with("--")) {
        at += 2;
    }
    if at >= args.len() {
        bail!("no input after the options");
    }
    Ok(args.split_at(at))
}

/// Builds the program and says where it is.
fn program(root: &Path) -> Result<PathBuf> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["build", "--release", "--package", "minute4d_cli", "--message-format=json"])
        .current_dir(root)
        .output()
        .context("cannot start cargo")?;
    if !output.status.success() {
        bail!("the program does not build:\n{}", String::from_utf8_lossy(&output.stderr));
    }
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
        .context("cargo named no program")
}

/// Runs the program and returns what it printed.
fn run(program: &Path, args: &[&str]) -> Result<String> {
    let output =
        Command::new(program).args(args).output().with_context(|| format!("cannot start {}", program.display()))?;
    if !output.status.success() {
        bail!("minute4d {} failed:\n{}", args.join(" "), String::from_utf8_lossy(&output.stderr));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

fn json(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{} is not JSON", path.display()))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn stem(path: &str) -> String {
    Path::new(path).file_stem().map_or_else(|| path.to_owned(), |s| s.to_string_lossy().into_owned())
}
