//! Clips by the one command.

use super::page::{list, table as markdown};
use super::runs::{Input, Runs, continuing, read};
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const HEADINGS: &str = "clip | geometry + training + preview + viewer, s | iterations | peak MiB | splats, static + dynamic | PSNR dB | warnings";
const TEMPLATES: &str = "{/clip} | {/run/stages/geometry/seconds 0} + {/run/stages/train/seconds 0} \
    + {/run/stages/preview/seconds 0} + {/run/stages/viewer/seconds 0} | {/run/iterations 0} | {/peak_mib 0} \
    | {/run/splats/static 0} + {/run/splats/dynamic 0} | {/last/psnr 1} | {/warnings}";

/// The clip of the repository and those of a folder: videos, and folders of images.
pub(super) fn files(root: &Path, folder: Option<&Path>) -> Result<Vec<PathBuf>> {
    let is = |path: &Path, extensions: &[&str]| {
        path.extension()
            .is_some_and(|e| extensions.contains(&&*e.to_string_lossy().to_lowercase()))
    };
    let entries = |dir: &Path| -> Result<Vec<PathBuf>> {
        let entries =
            std::fs::read_dir(dir).and_then(|entries| entries.map(|e| Ok(e?.path())).collect());
        entries.with_context(|| format!("cannot list {}", dir.display()))
    };
    let mut paths = folder.map_or(Ok(Vec::new()), entries)?;
    paths.retain(|path| match path.is_dir() {
        true => entries(path)
            .is_ok_and(|files| files.iter().any(|file| is(file, &["png", "jpg", "jpeg"]))),
        false => is(path, &["mp4", "mov", "m4v", "mkv", "webm", "avi"]),
    });
    paths.sort();
    paths.insert(0, root.join("examples/pinwheel.mp4"));
    Ok(paths)
}

/// A row per clip.
pub(super) fn table(runs: &mut Runs, clips: &[Input]) -> Result<String> {
    let mut measure = |clip: &Input| {
        runs.of(clip, "clip to scene", "out", |program| {
            let out = clip.dir.join("out");
            let record = out.join("run.json");
            program.run(|c| {
                c.arg("run")
                    .arg(&clip.path)
                    .arg("-o")
                    .arg(&out)
                    .args(["--quiet", continuing(&record)])
            })?;
            let metrics = std::fs::read_to_string(out.join("metrics.jsonl"))
                .context("cannot read metrics.jsonl")?;
            Ok(row(
                clip,
                &read(&record)?,
                metrics.lines().last().unwrap_or_default(),
            ))
        })
    };
    let rows: Result<Vec<_>> = clips.iter().map(&mut measure).collect();
    Ok(markdown(HEADINGS, TEMPLATES, &rows?))
}

fn row(clip: &Input, run: &Value, last: &str) -> Value {
    let mut warnings = list(&run["warnings"])
        .filter_map(Value::as_str)
        .collect::<Vec<_>>()
        .join("<br>");
    if warnings.is_empty() {
        warnings = "none".to_owned();
    }
    let warnings = warnings.replace(&*clip.path.to_string_lossy(), &clip.name);
    let last: Value = serde_json::from_str(last).unwrap_or_default();
    let peak_mib = run["peak_memory_bytes"]
        .as_f64()
        .map(|bytes| bytes / 1_048_576.0);
    json!({"clip": clip.name, "run": run, "peak_mib": peak_mib, "last": last, "warnings": warnings})
}
