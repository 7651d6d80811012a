//! Density control against what it is measured by (table 3 of the paper): the same first splats
//! with none, with that of 3DGS, with the letter of the paper and with ours, on the frames that the
//! protocol `instant4d` holds out of the training camera, and on far views.

use super::page::{list, mean, table};
use super::runs::{Input, Program, Runs, continuing, read};
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const TABLE: [&str; 2] = [
    "scene | profile, density control | first splats | splats | loop, s | processor, s | peak MB | held-out frames: whole / dynamic | SSIM \
     | far: whole / dynamic | SSIM",
    "{/scene} | {/what} | {/first 0} | {/splats 0} | {/loop_s 0} | {/processor_s 0} | {/peak_mb 0} \
     | {/held/psnr_db 2} / {/held/masked_psnr_db 2} | {/held/ssim 3} | {/far/psnr_db 2} / {/far/masked_psnr_db 2} | {/far/ssim 3}",
];

/// What rows are means of, where there are several scenes.
const FIGURES: [&str; 11] = [
    "/first",
    "/splats",
    "/loop_s",
    "/processor_s",
    "/peak_mb",
    "/held/psnr_db",
    "/held/masked_psnr_db",
    "/held/ssim",
    "/far/psnr_db",
    "/far/masked_psnr_db",
    "/far/ssim",
];

const RULES: [(&str, &str); 4] = [
    ("none", "enabled=false"),
    ("gradients (3DGS)", "rule=gradient"),
    ("the paper's letter", "rule=literal"),
    (OURS, "rule=loss-guided"),
];
/// Iterations of `fast`, about those of its minute on two cores: its own number follows from the
/// seconds that a machine has left.
const FAST_ITERATIONS: &str = "1500";
/// `init.voxel_px` of the profile.
const FIRST_EDGE_PX: f64 = 6.0;
const OURS: &str = "loss-guided";
const NINTH: &str = "loss-guided, a ninth of the splats of 3DGS";

/// `faithful` by each rule, and `fast` with density control and without.
pub(super) fn ablation(runs: &mut Runs, scenes: &[Input]) -> Result<String> {
    let mut rows = Vec::new();
    for scene in scenes {
        let mut of_scene = Vec::new();
        for (what, setting) in RULES {
            of_scene.push(row(
                runs,
                scene,
                "faithful",
                what,
                &[format!("train.density.{setting}")],
            )?);
        }
        let fewer = fewer_splats(&of_scene[1]);
        of_scene.push(row(runs, scene, "faithful", NINTH, &fewer)?);
        for (what, enabled) in [(RULES[0].0, false), (OURS, true)] {
            of_scene.push(row(
                runs,
                scene,
                "fast",
                what,
                &[format!("train.density.enabled={enabled}")],
            )?);
        }
        rows.extend(of_scene);
    }
    if scenes.len() > 1 {
        rows.extend(means(&rows));
    }
    Ok(table(TABLE[0], TABLE[1], &rows))
}

/// Settings of first splats that become about a ninth of those of `vanilla`: they may grow by a
/// half. Some 15 % of first splats are static.
fn fewer_splats(vanilla: &Value) -> [String; 2] {
    let [first, splats] = ["first", "splats"].map(|key| vanilla[key].as_f64().unwrap_or(1.0));
    let wanted = splats / 9.0 / 1.5;
    let edge_px = FIRST_EDGE_PX * (first / wanted).sqrt();
    [
        format!("init.max_dynamic={:.0}", 0.85 * wanted),
        format!("init.voxel_px={edge_px:.2}"),
    ]
}

/// Trains a profile with these settings on all frames but those that the protocol holds out, and
/// scores these and the far views.
fn row(
    runs: &mut Runs,
    scene: &Input,
    profile: &str,
    what: &str,
    settings: &[String],
) -> Result<Value> {
    let name = format!("{profile}, {what}");
    let folder = name.replace([',', '(', ')', '\''], "").replace(' ', "-");
    runs.of(scene, &name, &folder, |program| {
        let (split, out) = (split(program, scene)?, scene.dir.join(&folder));
        let record = out.join("run.json");
        program.run(|c| {
            c.arg("train").arg(&split).arg("-o").arg(&out).args(["--profile", profile, "--no-viewer", "--quiet"]);
            if profile == "fast" {
                c.args(["--iterations", FAST_ITERATIONS]);
            }
            settings.iter().for_each(|setting| {
                c.args(["--set", setting]);
            });
            c.arg(continuing(&record))
        })?;
        let [held, far] = [&split, &scene.path].map(|data| scores(program, &out, data));
        let (first, last) = first_and_last(&out.join("metrics.jsonl"))?;
        let splats = |event: &Value| event["splats_static"].as_u64().zip(event["splats_dynamic"].as_u64()).map(|(a, b)| a + b);
        let peak = read(&record)?["stages"]["train"]["peak_memory_bytes"].as_f64();
        Ok(json!({
            "scene": scene.name, "what": name, "first": splats(&first), "splats": splats(&last),
            "loop_s": last["seconds"], "processor_s": last["processor_seconds"], "peak_mb": peak.map(|bytes| bytes / 1e6),
            "held": held?, "far": far?,
        }))
    })
}

/// The frames of a scene, but for those that the protocol `instant4d` holds out.
pub(super) fn split(program: &Program, scene: &Input) -> Result<PathBuf> {
    let split = scene.dir.join("instant4d");
    if !split.join("transforms_test.json").is_file() {
        program.run(|c| {
            c.arg("split").arg(&scene.path).arg("-o").arg(&split).args([
                "--protocol",
                "instant4d",
                "--quiet",
            ])
        })?;
    }
    Ok(split)
}

/// Means over the views that a capture lists; of several sets, those of the far views.
pub(super) fn scores(program: &Program, out: &Path, data: &Path) -> Result<Value> {
    program.run(|c| {
        c.arg("eval")
            .arg(out)
            .arg("--data")
            .arg(data)
            .arg("--quiet")
    })?;
    let eval = read(&out.join("eval.json"))?;
    let far = list(&eval["sets"])
        .find(|set| set["set"] == "far")
        .map(|set| set["mean"].clone());
    Ok(far.unwrap_or_else(|| eval["mean"].clone()))
}

/// The first and the last event of a training.
pub(super) fn first_and_last(path: &Path) -> Result<(Value, Value)> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let parse = |line: Option<&str>| {
        serde_json::from_str(line.unwrap_or_default()).context("a line of metrics is no JSON")
    };
    Ok((
        parse(text.lines().next())?,
        parse(text.lines().next_back())?,
    ))
}

/// The means of the rows of the same name, over the scenes.
fn means(rows: &[Value]) -> Vec<Value> {
    let mut names: Vec<&Value> = Vec::new();
    for row in rows.iter().filter(|row| !row["what"].is_null()) {
        if !names.contains(&&row["what"]) {
            names.push(&row["what"]);
        }
    }
    let of = |name: &&Value| {
        let mut out = json!({"scene": "mean", "what": name, "held": {}, "far": {}});
        for pointer in FIGURES {
            let values = rows
                .iter()
                .filter(|row| row["what"] == **name)
                .map(|row| json!({"x": row.pointer(pointer)}));
            let values: Vec<Value> = values.collect();
            let (parent, key) = pointer.rsplit_once('/').unwrap_or_default();
            if let Some(parent) = out.pointer_mut(parent) {
                parent[key] = mean(values.iter(), "x");
            }
        }
        out
    };
    names.iter().map(of).collect()
}

#[test]
fn means_are_over_the_scenes_and_by_name() {
    let row = |scene: &str, what: &str, psnr_db: f64| json!({"scene": scene, "what": what, "splats": 10, "held": {"psnr_db": psnr_db}});
    let rows = means(&[
        row("a", "x", 20.0),
        row("a", "y", 1.0),
        row("b", "x", 22.0),
        Value::Null,
    ]);
    let all: Vec<_> = rows
        .iter()
        .map(|row| {
            (
                &row["what"],
                row["held"]["psnr_db"].as_f64(),
                row["far"]["ssim"].as_f64(),
            )
        })
        .collect();
    assert_eq!(
        all,
        [
            (&json!("x"), Some(21.0), None),
            (&json!("y"), Some(1.0), None)
        ]
    );
    assert_eq!(
        fewer_splats(&json!({"first": 100, "splats": 1350})),
        ["init.max_dynamic=85", "init.voxel_px=6.00"]
    );
}
