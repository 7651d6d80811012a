//! The tables of `docs/results.md`, measured again.
//!
//! Everything goes through the program as a user would run it; rows are read from the files it leaves
//! (`run.json`, `eval.json`) or prints (`eval-geometry`).

use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

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
pub fn held_out(root: &Path, scenes: &[&str], work: &Path) -> Result<String> {
    let program = program(root)?;
    let mut table = String::from(
        "| scene | profile | splats | seconds | PSNR | SSIM | PSNR moving | SSIM moving |\n|---|---|---|---|---|---|---|---|\n",
    );
    for scene in scenes {
        let name = stem(scene);
        for variant in &VARIANTS {
            let out = work.join(format!("{name}-{}", variant.name.replace([',', ' '], "")));
            let [record, eval] = train_and_score(&program, scene, scene, &out, variant.args)?;
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

/// Trains `input` into `out`, replacing what is there unless `--resume` is an option, and scores the held-out views of `scene`: `run.json`
/// and `eval.json`.
fn train_and_score(program: &Path, input: &str, scene: &str, out: &Path, options: &[&str]) -> Result<[Value; 2]> {
    let text = out.to_string_lossy().into_owned();
    let existing: &[&str] = if options.contains(&"--resume") { &[] } else { &["--force"] };
    run(program, &[&["train", input, "-o", &text, "--quiet"], existing, options].concat())?;
    run(program, &["eval", &text, "--data", scene, "--quiet"])?;
    Ok([json(&out.join("run.json"))?, json(&out.join("eval.json"))?])
}

/// Recovers the geometry of each input from its images alone and compares it with the truth, pairs
/// `input=truth`: one Markdown row each, returned together. Options of `minute4d geometry`, each with its value, may come
/// before the pairs (`--frontend raft`).
pub fn geometry(root: &Path, args: &[&str], work: &Path) -> Result<String> {
    let program = program(root)?;
    let (options, pairs) = options(args)?;
    let mut table = String::from(
        "| input | seconds | trajectory, % of path | rotation, mean deg | focal, % | depth AbsRel static | moving | mask IoU | precision | recall |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for pair in pairs {
        let (input, truth) = pair.split_once('=').with_context(|| format!("{pair}: expected INPUT=TRUTH"))?;
        let name = stem(truth.strip_suffix("/transforms.json").unwrap_or(truth));
        let out = work.join(format!("{name}-capture"));
        let out_text = out.to_string_lossy().into_owned();
        let start = std::time::Instant::now();
        let all = ["geometry", input, "-o", &out_text, "--force", "--quiet"];
        run(&program, &[&all, options].concat())?;
        let seconds = start.elapsed().as_secs_f64();
        let report = result(&run(&program, &["eval-geometry", &out_text, "--truth", truth, "--json"])?)?;
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

/// The result among the events that `--json` prints.
fn result(lines: &str) -> Result<Value> {
    let mut events = lines.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let event = events.find(|event| event["event"] == "result").context("the program printed no result")?;
    Ok(event["result"].clone())
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

/// For each scene (`args`, after options of `minute4d geometry`) with truth and held-out views: recovers the geometry of its training images, trains both that and the
/// scene as given, and scores the same held-out views. One Markdown row each; the last columns are the difference.
pub fn raw(root: &Path, args: &[&str], work: &Path) -> Result<String> {
    let program = program(root)?;
    let (options, scenes) = options(args)?;
    let mut table = String::from(
        "| scene | geometry, s | PSNR from frames | moving | PSNR, given geometry | moving | cost, dB | moving |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for scene in scenes {
        let name = stem(scene);
        let images = format!("{scene}/train");
        let place = |what: &str| work.join(format!("{name}-{what}"));
        let capture = place("raw-capture").to_string_lossy().into_owned();
        let all = ["geometry", &images, "-o", &capture, "--force", "--quiet"];
        run(&program, &[&all, options].concat())?;
        let seconds = number(&json(&Path::new(&capture).join("geometry.json"))?["seconds"]);
        let score = |input: &str, what: &str| -> Result<[f64; 2]> {
            let [_, eval] = train_and_score(&program, input, scene, &place(what), &["--no-viewer"])?;
            Ok(["psnr_db", "masked_psnr_db"].map(|metric| number(&eval["mean"][metric])))
        };
        let found = score(&capture, "raw")?;
        let given = score(scene, "given")?;
        table += &format!(
            "| {name} | {seconds:.0} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |\n",
            found[0],
            found[1],
            given[0],
            given[1],
            given[0] - found[0],
            given[1] - found[1],
        );
    }
    Ok(table)
}
