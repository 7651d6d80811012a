//! What each choice is worth: trainings with one thing changed each.

use super::{last_metrics, number, program, run, stem, train_and_score};
use anyhow::{Context, Result, bail};
use std::path::Path;

/// Steps of every row unless the command says otherwise.
const ITERATIONS: usize = 1200;

/// A training that differs from the default in one thing.
struct Row {
    /// The name for `--rows`.
    name: &'static str,
    /// The name in the table.
    what: &'static str,
    sets: &'static [&'static str],
    /// Frames a step: rows with several take as many steps fewer, and density control goes by frames.
    batch: usize,
}

const fn row(name: &'static str, what: &'static str, sets: &'static [&'static str]) -> Row {
    Row { name, what, sets, batch: 1 }
}

const ROWS: &[Row] = &[
    row("default", "default", &[]),
    Row { name: "batch-2", what: "two frames per step, half the steps", sets: &["train.batch=2"], batch: 2 },
    Row { name: "batch-4", what: "four frames per step, a quarter of the steps", sets: &["train.batch=4"], batch: 4 },
    row("no-colour-fit", "no colours by least squares last", &["train.colour_fit.rounds=0"]),
    row("colour-fit-3", "3 rounds of it last", &["train.colour_fit.rounds=3"]),
    row("short-lives", "lives of 0.5 frames", &["init.keyframe_gaps=0.5"]),
    row("long-lives", "lives of 1.5 frames", &["init.keyframe_gaps=1.5"]),
    row("no-density", "no density control", &["train.density.enabled=false"]),
];

/// What the command was asked for.
#[derive(Debug, PartialEq)]
struct Ask<'a> {
    iterations: usize,
    /// Names of rows; empty for all.
    rows: Vec<&'a str>,
    /// Rows that were trained before with the same settings are only scored again.
    reuse: bool,
    scenes: Vec<&'a str>,
}

impl<'a> Ask<'a> {
    fn parse(words: &[&'a str]) -> Result<Self> {
        let mut ask = Self { iterations: ITERATIONS, rows: Vec::new(), reuse: false, scenes: Vec::new() };
        let mut words = words.iter();
        while let Some(&word) = words.next() {
            match word {
                "--iterations" => {
                    let value = words.next().context("--iterations: expected a number")?;
                    ask.iterations =
                        value.parse().with_context(|| format!("--iterations {value}: expected a number"))?;
                }
                "--rows" => {
                    ask.rows = words.next().context("--rows: expected names, NAME,NAME")?.split(',').collect();
                }
                "--reuse" => ask.reuse = true,
                other if other.starts_with("--") => {
                    bail!("{other}: expected --iterations N, --rows NAME,... or --reuse")
                }
                scene => ask.scenes.push(scene),
            }
        }
        let known: Vec<&str> = ROWS.iter().map(|r| r.name).collect();
        if let Some(unknown) = ask.rows.iter().find(|name| !known.contains(name)) {
            bail!("there is no row {unknown:?}; the rows are {}", known.join(", "));
        }
        if ask.scenes.is_empty() {
            bail!("which scenes? expected the folders of captures");
        }
        if ask.iterations < 4 {
            bail!("--iterations {}: expected at least 4", ask.iterations);
        }
        Ok(ask)
    }

    /// The default, which all others are compared with, and those asked for.
    fn rows(&self) -> impl Iterator<Item = &'static Row> {
        let asked = |row: &&Row| row.name == "default" || self.rows.is_empty() || self.rows.contains(&row.name);
        ROWS.iter().filter(asked)
    }
}

impl Row {
    /// Every setting of a training of as many frames as `iterations` steps of the default look at.
    fn settings(&self, iterations: usize) -> Vec<String> {
        let mut out = vec![format!("train.iterations={}", iterations / self.batch), "train.budget_s=0".to_owned()];
        if self.batch > 1 {
            for (key, steps) in [("from", 500), ("every", 100), ("prune_every", 500)] {
                out.push(format!("train.density.{key}={}", steps / self.batch));
            }
        }
        out.extend(self.sets.iter().map(|&set| set.to_owned()));
        out
    }
}

#[derive(Debug, Clone, Copy)]
struct Figures {
    psnr: f64,
    moving: f64,
    ssim: f64,
    seconds: f64,
    splats: u64,
}

/// Trains each scene in every row, for as many frames each, and scores the held-out views: one Markdown row each,
/// returned together, with the difference to the default in brackets. Splats and figures are the same on any number of
/// threads and however busy the machine is; seconds are processor time of the optimisation alone, of all cores together.
pub fn ablation(root: &Path, words: &[&str], work: &Path) -> Result<String> {
    let ask = Ask::parse(words)?;
    let program = program(root)?;
    // a row that the program does not know must not be found out after an hour
    for row in ask.rows() {
        let settings = row.settings(ask.iterations);
        let sets = settings.iter().flat_map(|set| ["--set", set]);
        let words: Vec<&str> =
            ["train", ask.scenes[0], "-o", "unused", "--print-config"].into_iter().chain(sets).collect();
        run(&program, &words).with_context(|| format!("row {}", row.name))?;
    }
    let mut table = format!(
        "| scene | {} steps of one frame | PSNR | PSNR moving | SSIM | processor seconds | splats |\n|---|---|---|---|---|---|---|\n",
        ask.iterations
    );
    for scene in &ask.scenes {
        let name = stem(scene);
        let mut default = None;
        for row in ask.rows() {
            let out = work.join(format!("ablation-{name}-{}", row.name));
            let figures = measure(&program, scene, row, &ask, &out)?;
            table += &line(&name, row.what, figures, default);
            default.get_or_insert(figures);
        }
    }
    Ok(table)
}

fn measure(program: &Path, scene: &str, row: &Row, ask: &Ask<'_>, out: &Path) -> Result<Figures> {
    let settings = row.settings(ask.iterations);
    let sets = settings.iter().flat_map(|set| ["--set", set]);
    let options: Vec<&str> = ask.reuse.then_some("--resume").into_iter().chain(sets).collect();
    let [_, eval] = train_and_score(program, scene, scene, out, &options)?;
    let last = last_metrics(out)?;
    let mean = &eval["mean"];
    Ok(Figures {
        psnr: number(&mean["psnr_db"]),
        moving: number(&mean["masked_psnr_db"]),
        ssim: number(&mean["ssim"]),
        seconds: number(&last["processor_seconds"]),
        splats: eval["splats"].as_u64().unwrap_or_default(),
    })
}

fn line(scene: &str, what: &str, f: Figures, default: Option<Figures>) -> String {
    let with = |digits: usize, pick: fn(&Figures) -> f64| {
        let value = pick(&f);
        match default.as_ref().map(|d| value - pick(d)) {
            Some(delta) => format!("{value:.digits$} ({delta:+.digits$})"),
            None => format!("{value:.digits$}"),
        }
    };
    format!(
        "| {scene} | {what} | {} | {} | {} | {} | {} |\n",
        with(2, |f| f.psnr),
        with(2, |f| f.moving),
        with(3, |f| f.ssim),
        with(1, |f| f.seconds),
        f.splats
    )
}

#[cfg(test)]
mod tests {
    use super::{Ask, Figures, ITERATIONS, ROWS, line};
    use std::collections::BTreeSet;

    #[test]
    fn words_choose_rows_and_steps() {
        let ask = Ask::parse(&["--rows", "batch-2,no-density", "a", "--iterations", "400", "b"]).unwrap();
        assert_eq!((ask.iterations, ask.reuse, ask.scenes.as_slice()), (400, false, ["a", "b"].as_slice()));
        let names: Vec<&str> = ask.rows().map(|r| r.name).collect();
        assert_eq!(names, ["default", "batch-2", "no-density"], "the default is always there to compare with");
        let all = Ask::parse(&["a", "--reuse"]).unwrap();
        assert!(all.reuse && all.iterations == ITERATIONS);
        assert_eq!(all.rows().count(), ROWS.len());
        for wrong in [&["--rows", "cubes", "a"][..], &["--iterations", "many", "a"], &["--fast", "a"], &[]] {
            assert!(Ask::parse(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn every_row_looks_at_as_many_frames() {
        let names: BTreeSet<&str> = ROWS.iter().map(|r| r.name).collect();
        assert_eq!(names.len(), ROWS.len());
        for row in ROWS {
            let settings = row.settings(1200);
            let steps: usize = settings[0].strip_prefix("train.iterations=").unwrap().parse().unwrap();
            let batch = format!("train.batch={}", row.batch);
            assert_eq!(steps * row.batch, 1200);
            assert_eq!(settings.contains(&batch), row.batch > 1, "{}", row.name);
        }
    }

    #[test]
    fn ablation_differences_are_printed_with_a_sign() {
        let default = Figures { psnr: 31.0, moving: 23.5, ssim: 0.95, seconds: 20.0, splats: 7 };
        let other = Figures { psnr: 30.5, seconds: 22.04, ..default };
        assert_eq!(
            line("mill-1", "no density control", other, Some(default)),
            "| mill-1 | no density control | 30.50 (-0.50) | 23.50 (+0.00) | 0.950 (+0.000) | 22.0 (+2.0) | 7 |\n"
        );
        assert_eq!(
            line("mill-1", "default", default, None),
            "| mill-1 | default | 31.00 | 23.50 | 0.950 | 20.0 | 7 |\n"
        );
    }
}
