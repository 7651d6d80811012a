//! First splats against what a minute makes of them: numbers, shares of static ones, with density
//! control and without, at equal processor seconds.

use super::density::{first_and_last, scores, split};
use super::page::table;
use super::runs::{Input, Program, Runs, read};
use anyhow::Result;
use serde_json::{Value, json};
use std::path::Path;

const TABLE: [&str; 2] = [
    "scene | asked for | density control | first splats: static + dynamic | splats | iterations | processor, s | held-out frames: whole / dynamic \
     | far | near | between",
    "{/scene} | {/asked} | {/density} | {/first/splats_static 0} + {/first/splats_dynamic 0} | {/splats 0} | {/iterations 0} | {/processor_s 0} \
     | {/held/psnr_db 2} / {/held/masked_psnr_db 2} | {/far/psnr_db 2} / {/far/masked_psnr_db 2} | {/near/psnr_db 2} / {/near/masked_psnr_db 2} \
     | {/between/psnr_db 2} / {/between/masked_psnr_db 2}",
];

/// Thousands of first splats, and shares of static ones.
const TOTALS: [usize; 5] = [50, 100, 150, 300, 600];
const SHARES: [f64; 3] = [0.25, 0.5, 0.75];
/// The share of the rows with density control.
const EVEN: f64 = 0.5;
/// Points of a dynamic splat, about: it lives for several frames.
const POINTS_PER_SPLAT: f64 = 2.5;
/// What training may take of processors, with all that is not the loop: two cores for most of a
/// minute.
const PROCESSOR_S: f64 = 110.0;
const CORES: f64 = 2.0;
/// Iterations of the run that tells what an iteration takes; the first half is not counted.
const TRIAL: usize = 100;

/// Every number and share for every scene. Where a scene has no more to make splats of, rows repeat
/// the first splats of smaller numbers: only the first of these is trained.
pub(super) fn curve(runs: &mut Runs, scenes: &[Input]) -> Result<String> {
    let mut rows = Vec::new();
    for scene in scenes {
        let mut done = Vec::new();
        for total in TOTALS {
            for (share, density) in SHARES
                .map(|share| (share, false))
                .into_iter()
                .chain([(EVEN, true)])
            {
                let row = row(runs, scene, total, share, density, &done)?;
                done.push(json!([row["first"], density]));
                rows.push(row);
            }
        }
    }
    Ok(table(TABLE[0], TABLE[1], &rows))
}

fn row(
    runs: &mut Runs,
    scene: &Input,
    total: usize,
    share: f64,
    density: bool,
    done: &[Value],
) -> Result<Value> {
    let asked = format!("{total}k, {:.0} % static", 100.0 * share);
    let control = if density { "loss-guided" } else { "none" };
    let what = format!("curve {total}k {share} {control}");
    let folder = what.replace(' ', "-");
    runs.of(scene, &what, &folder, |program| {
        let out = scene.dir.join(&folder);
        let data = split(program, scene)?;
        let count = total as f64 * 1000.0;
        let settings = [
            format!("init.max_static={:.0}", share * count),
            format!("init.max_dynamic={:.0}", (1.0 - share) * count * POINTS_PER_SPLAT),
            format!("train.density.enabled={density}"),
        ];
        let mut row = json!({"scene": scene.name, "asked": asked, "density": control});
        let trial = train(program, &data, &out, &settings, TRIAL)?;
        row["first"] =
            json!({"splats_static": trial.first["splats_static"], "splats_dynamic": trial.first["splats_dynamic"]});
        if done.contains(&json!([row["first"], density])) {
            return Ok(row);
        }
        let run = train(program, &data, &out, &settings, trial.affordable())?;
        row["splats"] = json!(run.splats());
        row["iterations"] = run.last["iteration"].clone();
        row["processor_s"] = json!(run.processor_s);
        row["held"] = scores(program, &out, &data)?;
        row["far"] = scores(program, &out, &scene.path)?;
        let eval = read(&out.join("eval.json"))?;
        for set in ["near", "between"] {
            let mean = super::page::list(&eval["sets"]).find(|s| s["set"] == set).map(|s| s["mean"].clone());
            row[set] = mean.unwrap_or_default();
        }
        Ok(row)
    })
}

/// A training: its first and last events, and the processor seconds of all of it; outside the loop
/// all cores count.
struct Trained {
    first: Value,
    last: Value,
    processor_s: f64,
}

impl Trained {
    fn splats(&self) -> u64 {
        ["splats_static", "splats_dynamic"]
            .iter()
            .filter_map(|key| self.last[key].as_u64())
            .sum()
    }

    /// Iterations that [`PROCESSOR_S`] allows, by what those after the first event took.
    fn affordable(&self) -> usize {
        let last = |key: &str| self.last[key].as_f64().unwrap_or(0.0);
        let between = |key: &str| last(key) - self.first[key].as_f64().unwrap_or(0.0);
        let each = between("processor_seconds") / between("iteration").max(1.0);
        let left = PROCESSOR_S - (self.processor_s - last("processor_seconds"));
        ((left / each.max(1e-6)) as usize / 10 * 10).clamp(TRIAL, 5000)
    }
}

fn train(
    program: &Program,
    data: &Path,
    out: &Path,
    settings: &[String],
    iterations: usize,
) -> Result<Trained> {
    let iterations = iterations.to_string();
    program.run(|c| {
        c.arg("train")
            .arg(data)
            .arg("-o")
            .arg(out)
            .args(["--iterations", &iterations]);
        settings.iter().for_each(|setting| {
            c.args(["--set", setting]);
        });
        c.args(["--no-viewer", "--quiet", "--force"])
    })?;
    let (first, last) = first_and_last(&out.join("metrics.jsonl"))?;
    let seconds = |value: &Value| value["seconds"].as_f64().unwrap_or(0.0);
    let stage_s = seconds(&read(&out.join("run.json"))?["stages"]["train"]);
    let processor_s =
        last["processor_seconds"].as_f64().unwrap_or(0.0) + CORES * (stage_s - seconds(&last));
    Ok(Trained {
        first,
        last,
        processor_s,
    })
}

#[test]
fn iterations_follow_from_the_trial() {
    let event = |iteration: usize, processor_seconds: f64| json!({"iteration": iteration, "processor_seconds": processor_seconds});
    let trial = Trained {
        first: event(50, 5.0),
        last: event(100, 8.0),
        processor_s: 38.0,
    };
    // 30 s outside the loop, 60 ms an iteration
    assert_eq!(trial.affordable(), 1330);
    let slow = Trained {
        first: event(50, 50.0),
        last: event(100, 90.0),
        processor_s: 200.0,
    };
    assert_eq!(slow.affordable(), TRIAL);
}
