//! Held-out views of scenes that are trained on given geometry, or from their images alone, and of
//! baselines.

use super::geometry;
use super::machine::output;
use super::page::{list, mean, table};
use super::runs::{Input, Runs, continuing, read};
use anyhow::Result;
use serde_json::{Value, json};
use std::path::Path;

const SCORES: [&str; 2] = [
    "scene | trained on, or baseline | far: whole / dynamic / static | far: SSIM | near: whole / dynamic | between: whole / dynamic \
     | splats | seconds",
    "{/scene} | {/what} | {/far/psnr_db 2} / {/far/masked_psnr_db 2} / {/far/static_psnr_db 2} | {/far/ssim 3} \
     | {/near/psnr_db 2} / {/near/masked_psnr_db 2} | {/between/psnr_db 2} / {/between/masked_psnr_db 2} \
     | {/splats 0} | {/seconds 0}",
];

const AGAINST: [&str; 2] = [
    "scene | trained on | far: whole | far: dynamic | near: whole | near: dynamic | between: whole | between: dynamic",
    "{/scene} | {/what} | {/far/psnr_db} | {/far/masked_psnr_db} | {/near/psnr_db} | {/near/masked_psnr_db} \
     | {/between/psnr_db} | {/between/masked_psnr_db}",
];

const DETAILS: [&str; 2] = [
    "scene | trained on | far to 8 degrees | 8 to 20 degrees | over 20 degrees \
     | far: shift / swim, px | near: shift / swim, px | between: shift / swim, px | far: LPIPS",
    "{/scene} | {/what} | {/far to 8 degrees/psnr_db 2} / {/far to 8 degrees/masked_psnr_db 2} \
     | {/far to 20 degrees/psnr_db 2} / {/far to 20 degrees/masked_psnr_db 2} \
     | {/far over 20 degrees/psnr_db 2} / {/far over 20 degrees/masked_psnr_db 2} \
     | {/shift_px/far 1} / {/swim_px/far 1} | {/shift_px/near 1} / {/swim_px/near 1} \
     | {/shift_px/between 1} / {/swim_px/between 1} | {/lpips 3}",
];

/// Trains `input` into `folder` of the scene and scores the held-out views.
fn trained(
    runs: &mut Runs,
    scene: &Input,
    what: &str,
    input: &Path,
    folder: &str,
    options: &[&str],
) -> Result<Value> {
    runs.of(scene, &format!("training, {what}"), folder, |program| {
        let out = scene.dir.join(folder);
        let record = out.join("run.json");
        program.run(|c| {
            c.arg("train").arg(input).arg("-o").arg(&out).args(options);
            c.args(["--no-viewer", "--quiet", continuing(&record)])
        })?;
        if input != scene.path {
            // as `run` leaves it: where `eval` looks for the geometry that a scene was trained on
            output(
                Path::new("."),
                "cp",
                &["-r", &input.to_string_lossy(), &out.to_string_lossy()],
            )?;
        }
        program.run(|c| {
            c.arg("eval")
                .arg(&out)
                .arg("--data")
                .arg(&scene.path)
                .arg("--quiet")
        })?;
        Ok(row(
            &scene.name,
            what,
            &read(&record)?,
            &read(&out.join("eval.json"))?,
        ))
    })
}

/// What the tables have of `run.json` and `eval.json`: means by set of views, and rows of
/// baselines.
fn row(scene: &str, what: &str, run: &Value, eval: &Value) -> Value {
    let seconds = &run["stages"]["train"]["seconds"];
    let mut row =
        json!({"scene": scene, "what": what, "splats": eval["splats"], "seconds": seconds});
    for key in ["shift_px", "swim_px"] {
        let of = |set| {
            (
                set,
                mean(
                    list(&eval["aligned"]).filter(|object| object["set"] == set),
                    key,
                ),
            )
        };
        row[key] = ["far", "near", "between"].map(of).into_iter().collect();
    }
    for set in list(&eval["sets"]) {
        let name = set["set"].as_str().unwrap_or_default();
        row[name] = set["mean"].clone();
        if name == "far" {
            row["lpips"] = set["lpips_alex"].clone();
        }
    }
    let mut baselines = Vec::<Value>::new();
    for score in list(&eval["baselines"]) {
        let set = score["set"].as_str().unwrap_or_default();
        match baselines
            .iter_mut()
            .find(|entry| entry["what"] == score["name"])
        {
            Some(entry) => entry[set] = score["mean"].clone(),
            None => {
                baselines.push(json!({"scene": scene, "what": score["name"], set: score["mean"]}))
            }
        }
    }
    row["baselines"] = baselines.into();
    row
}

/// What begins the names of baselines that know the true depth.
const KNOWS_DEPTH: &str = "given depth";

/// For each set of views and score, dB, of a trained scene: the difference to the best of the
/// baselines, which baseline that is and its score. Scores are rounded as in the table first, so
/// that the difference is that of the printed ones.
fn against(trained: &Value, baselines: &[Value]) -> Value {
    let mut row = json!({"scene": trained["scene"], "what": trained["what"]});
    for set in ["far", "near", "between"] {
        for key in ["psnr_db", "masked_psnr_db"] {
            let rounded = |row: &Value| {
                row[set][key]
                    .as_f64()
                    .map(|db| (100.0 * db).round() / 100.0)
            };
            let candidates = baselines
                .iter()
                .filter_map(|baseline| Some((rounded(baseline)?, &baseline["what"])));
            let best = candidates.max_by(|a, b| a.0.total_cmp(&b.0));
            if let (Some(ours), Some((db, name))) = (rounded(trained), best) {
                let name = name
                    .as_str()
                    .unwrap_or_default()
                    .split(" (")
                    .next()
                    .unwrap_or_default();
                row[set][key] = format!("{:+.2} ({name} {db:.2})", ours - db).into();
            }
        }
    }
    row
}

/// The scene at the default preset on its true geometry.
pub(super) fn given(runs: &mut Runs, scene: &Input) -> Result<Value> {
    trained(runs, scene, "geometry given", &scene.path, "given", &[])
}

/// Scores by set, with the baselines; differences to the best of these; and far views by angle,
/// with objects after their best shift.
pub(super) fn tables(runs: &mut Runs, scenes: &[Input]) -> Result<String> {
    let (mut scores, mut differences, mut details) = (Vec::new(), Vec::new(), Vec::new());
    for scene in scenes {
        geometry::measured(runs, scene)?;
        let capture = geometry::capture(scene);
        let rows = [
            given(runs, scene)?,
            trained(runs, scene, "from the images", &capture, "from-images", &[])?,
        ];
        let baselines: Vec<Value> = list(&rows[1]["baselines"]).cloned().collect();
        scores.extend(rows.iter().chain(&baselines).cloned());
        let knows = |baseline: &Value| {
            baseline["what"]
                .as_str()
                .is_some_and(|name| name.starts_with(KNOWS_DEPTH))
        };
        let own: Vec<Value> = baselines
            .iter()
            .filter(|baseline| !knows(baseline))
            .cloned()
            .collect();
        differences.extend([against(&rows[0], &baselines), against(&rows[1], &own)]);
        details.extend(rows);
    }
    let tables = [(SCORES, scores), (AGAINST, differences), (DETAILS, details)];
    Ok(tables
        .map(|([headings, templates], rows)| table(headings, templates, &rows))
        .join("\n"))
}

#[test]
fn the_best_baseline_is_named_with_the_difference_to_it() {
    let row = |what: &str, psnr_db: f64, masked_psnr_db: f64| json!({"scene": "a", "what": what, "far": {"psnr_db": psnr_db, "masked_psnr_db": masked_psnr_db}, "near": {"psnr_db": psnr_db}});
    let baselines = [
        row("flat (a bound)", 21.0, 18.424),
        row("one colour", 20.0, 19.446),
        json!({"what": "none"}),
    ];
    let rows = [
        against(&row("trained", 26.5, 16.906), &baselines),
        against(&row("alone", 26.5, 16.9), &[]),
    ];
    let lines = "| a | trained | +5.50 (flat 21.00) | -2.54 (one colour 19.45) | +5.50 (flat 21.00) | - | - | - |\n\
                 | a | alone | - | - | - | - | - | - |\n";
    let text = table(AGAINST[0], AGAINST[1], &rows);
    assert!(text.ends_with(lines), "{text}");
}

#[test]
fn rows_are_of_eval_json() {
    let mean =
        json!({"psnr_db": 25.218, "ssim": 0.7764, "masked_psnr_db": 17.2, "static_psnr_db": null});
    let eval = json!({
        "splats": 114382, "sets": [{"set": "far", "mean": mean, "lpips_alex": null}, {"set": "far to 8 degrees", "mean": mean}, {"set": "near"}],
        "aligned": [{"set": "far", "shift_px": 2.5, "swim_px": 3.0}, {"set": "far", "shift_px": 1.5, "swim_px": 2.0}],
        "baselines": [{"name": "flat", "set": "far", "mean": mean}, {"name": "flat", "set": "near", "mean": mean}],
    });
    let first = row(
        "a",
        "given",
        &json!({"stages": {"train": {"seconds": 60.4}}}),
        &eval,
    );
    let rows = [
        first.clone(),
        first["baselines"][0].clone(),
        row("b", "c", &json!(3), &json!([])),
    ];
    let lines = "| a | given | 25.22 / 17.20 / - | 0.776 | - | - | 114382 | 60 |\n\
                 | a | flat | 25.22 / 17.20 / - | 0.776 | 25.22 / 17.20 | - | - | - |\n| b | c | - | - | - | - | - | - |\n";
    assert!(table(SCORES[0], SCORES[1], &rows).ends_with(lines));
    let text = table(DETAILS[0], DETAILS[1], &[first]);
    assert!(
        text.ends_with("| a | given | 25.22 / 17.20 | - | - | 2.0 / 2.5 | - | - | - |\n"),
        "{text}"
    );
}
