//! Geometry from images alone against the truth, and what each kind of error costs.

use super::page::{list, mean, table as markdown};
use super::runs::{Input, Runs, continuing, read};
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::path::PathBuf;

const HEADINGS: &str = "scene | seconds | trajectory, % of path | rotation, mean deg | focal, % | static AbsRel / outside masks \
    | mask IoU / precision / recall | distance, % | drift, % | jitter, % | relief, % | missed, %";
const TEMPLATES: &str = "{/scene} | {/seconds 0} | {/report/trajectory/rmse_percent 2} | {/report/rotation/mean_deg 2} \
    | {/report/focal_error_percent 1} | {/report/depth/static_abs_rel 4} / {/report/depth/static_outside_masks_abs_rel 4} \
    | {/report/mask/iou 2} / {/report/mask/precision 2} / {/report/mask/recall 2} \
    | {/objects/distance 1} | {/objects/drift 1} | {/objects/jitter 1} | {/objects/relief 1} | {/objects/missed 1}";

/// The geometry of a scene from its training images: seconds, and the report of `eval-geometry`.
pub(super) fn measured(runs: &mut Runs, scene: &Input) -> Result<Value> {
    runs.of(scene, "geometry", "capture", |program| {
        let (out, images) = (capture(scene), scene.path.join("train"));
        let record = out.join("geometry.json");
        let clip = read(&scene.path.join("transforms_train.json"))?;
        let fps = clip["fps"]
            .as_f64()
            .with_context(|| format!("{} has no frame rate", scene.path.display()))?;
        program.run(|c| {
            c.arg("geometry")
                .arg(images)
                .arg("-o")
                .arg(&out)
                .args(["--set", &format!("video.folder_fps={fps}")]);
            c.args(["--segmenter", "none", "--quiet", continuing(&record)])
        })?;
        let report = program.result(|c| {
            c.arg("eval-geometry")
                .arg(&out)
                .arg("--truth")
                .arg(&scene.path)
        })?;
        let mut row =
            json!({"scene": scene.name, "seconds": read(&record)?["seconds"], "report": report});
        for key in ["distance", "drift", "jitter", "relief", "missed"] {
            row["objects"][key] = mean(list(&report["objects"]), key)
                .as_f64()
                .map(|share| 100.0 * share)
                .into();
        }
        Ok(row)
    })
}

/// Where the geometry of a scene is.
pub(super) fn capture(scene: &Input) -> PathBuf {
    scene.dir.join("capture")
}

/// A row per scene.
pub(super) fn table(runs: &mut Runs, scenes: &[Input]) -> Result<String> {
    let rows: Result<Vec<_>> = scenes.iter().map(|scene| measured(runs, scene)).collect();
    Ok(markdown(HEADINGS, TEMPLATES, &rows?))
}

const MOTION_HEADINGS: &str = "scene | after 5 frames: median / 80 %, px | within 1 sigma, % | after 10: median / 80 %, px | within 1 sigma, % \
    | without a node, % | lives on time / late / early, %";
const MOTION_TEMPLATES: &str = "{/scene} | {/carried/0/median_px 2} / {/carried/0/p80_px 2} | {/carried/0/percent} \
    | {/carried/1/median_px 2} / {/carried/1/p80_px 2} | {/carried/1/percent} | {/percent_without_node 1} | {/lives/on_time} / {/lives/late} / {/lives/early}";

/// Measures motion against true tracks: a row per scene.
pub(super) fn motion(runs: &mut Runs, scenes: &[Input]) -> Result<String> {
    let row = |scene: &Input| {
        runs.of(scene, "motion", "motion", |program| {
            let report = program.result(|c| {
                c.arg("eval-geometry")
                    .arg(&scene.path)
                    .arg("--truth")
                    .arg(&scene.path)
                    .arg("--motion")
            })?;
            let mut row = report["motion"].clone();
            row["scene"] = scene.name.clone().into();
            let percent = |value: &Value| value.as_f64().map(|share| 100.0 * share);
            for k in 0..list(&report["motion"]["carried"]).count() {
                row["carried"][k]["percent"] = percent(&row["carried"][k]["within_sigma"]).into();
            }
            row["percent_without_node"] = percent(&row["without_node"]).into();
            for key in ["on_time", "late", "early"] {
                row["lives"][key] = percent(&row["lives"][key]).into();
            }
            Ok(row)
        })
    };
    let rows: Result<Vec<_>> = scenes.iter().map(row).collect();
    Ok(markdown(MOTION_HEADINGS, MOTION_TEMPLATES, &rows?))
}

/// Far views with one kind of estimate at a time replaced by the truth: a row per kind, a column
/// per scene.
pub(super) fn explained(runs: &mut Runs, scenes: &[Input]) -> Result<String> {
    let (mut reports, mut headings, mut templates) = (
        Vec::new(),
        "what is true".to_owned(),
        "{/0/name}".to_owned(),
    );
    for (i, scene) in scenes.iter().enumerate() {
        measured(runs, scene)?;
        reports.push(runs.of(
            scene,
            "replacing estimates by the truth",
            "explain",
            |program| {
                let result = program.result(|c| {
                    c.arg("eval-geometry")
                        .arg(capture(scene))
                        .arg("--truth")
                        .arg(&scene.path);
                    c.args(["--explain", "--train", "200", "-o"])
                        .arg(scene.dir.join("explain"))
                })?;
                Ok(list(&result["explain"])
                    .filter(|row| row["set"] == "far")
                    .cloned()
                    .collect())
            },
        )?);
        let cell = ["psnr_db", "masked_psnr_db", "static_psnr_db"]
            .map(|key| format!("{{/{i}/trained/{key} 2}}"));
        headings += &format!(" | {}", scene.name);
        templates += &format!(" | {}", cell.join(" / "));
    }
    // the rows of all scenes have the same order
    let rows = reports.first().map_or(0, |first| list(first).count());
    let rows: Vec<Value> = (0..rows)
        .map(|i| reports.iter().map(|report| report[i].clone()).collect())
        .collect();
    Ok(markdown(&headings, &templates, &rows))
}
