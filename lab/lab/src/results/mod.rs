//! `minute4d-lab results`: measures the tables of `docs/results.md` anew, and writes each into the
//! page between its markers.
//!
//! Everything goes through the programs as a user would run them; figures are read from the files
//! they leave (`run.json`, `geometry.json`, `eval.json`) or print (`eval-geometry`, `bench`).

mod clips;
mod curve;
mod density;
mod geometry;
mod kernels;
mod machine;
mod page;
mod runs;
mod views;

use anyhow::{Result, bail};
use runs::{Input, Runs, inputs, name};
use std::path::{Path, PathBuf};

/// The page, relative to the root.
const PAGE: &str = "docs/results.md";

/// What a section measures: the scenes of the command, the first of those that have held-out views,
/// the clips, or the machine.
enum Over {
    Scenes,
    Views(usize),
    Clips,
    Machine,
}

/// A section: its name, what it measures, and its tables of these inputs.
type Section = (
    &'static str,
    Over,
    fn(&mut Runs, &[Input]) -> Result<String>,
);

/// In the order of the page.
const SECTIONS: [Section; 8] = [
    ("geometry", Over::Scenes, geometry::table),
    ("motion", Over::Scenes, geometry::motion),
    ("views", Over::Views(usize::MAX), views::tables),
    ("ablation", Over::Views(usize::MAX), density::ablation),
    ("curve", Over::Views(usize::MAX), curve::curve),
    ("explain", Over::Views(4), geometry::explained),
    ("clips", Over::Clips, clips::table),
    ("kernels", Over::Machine, kernels::table),
];

/// What to measure.
#[derive(Debug, Default, clap::Args)]
pub struct Results {
    /// Sections to measure: geometry, motion, views, ablation, curve, explain, clips, kernels
    /// [default: all]
    #[arg(long, value_name = "SECTION,SECTION", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Folder for runs, which the same command continues [default: target/results]
    #[arg(long, value_name = "DIR")]
    pub work: Option<PathBuf>,
    /// Folder of real videos for the section clips [default: examples]
    #[arg(long, value_name = "DIR")]
    pub clips: Option<PathBuf>,
    /// Scenes of tools/bench
    pub scenes: Vec<PathBuf>,
}

/// Measures the sections of `wanted` and writes the page of the repository at `root` after each.
/// What an earlier call finished at the same commit is not measured again.
///
/// # Errors
///
/// Wrong arguments, changed files, a page without the markers, a program that fails, files that
/// cannot be read or written.
pub fn run(root: &Path, wanted: &Results) -> Result<()> {
    let mut sections: Vec<&Section> = SECTIONS.iter().collect();
    if let Some(word) = wanted
        .only
        .iter()
        .find(|word| SECTIONS.iter().all(|s| s.0 != **word))
    {
        bail!("{word} is no section: {}", SECTIONS.map(|s| s.0).join(", "));
    }
    if !wanted.only.is_empty() {
        sections.retain(|s| wanted.only.iter().any(|word| word == s.0));
    }
    let work = wanted
        .work
        .clone()
        .unwrap_or_else(|| root.join("target/results"));
    let (folder, scenes) = (wanted.clips.clone(), wanted.scenes.clone());
    if scenes.is_empty()
        && sections
            .iter()
            .any(|s| matches!(s.1, Over::Scenes | Over::Views(_)))
    {
        bail!("no scene is named; without scenes: --only clips,kernels");
    }
    let origin = machine::origin(root)?;
    let scenes = inputs(scenes, &work.join("scenes"))?;
    let has_views = |scene: &&Input| scene.path.join("transforms_test.json").is_file();
    let with_views: Vec<Input> = scenes.iter().filter(has_views).cloned().collect();
    let clips = inputs(clips::files(root, folder.as_deref())?, &work.join("clips"))?;
    let machine = inputs(vec!["machine".into()], &work)?;
    let over = |section: &Section| match section.1 {
        Over::Scenes => &scenes[..],
        Over::Views(n) => &with_views[..n.min(with_views.len())],
        Over::Clips => &clips[..],
        Over::Machine => &machine[..],
    };
    let page = root.join(PAGE);
    let mut runs = Runs::new(root, &origin);
    for section in &sections {
        page::replaced(&page, section.0, "")?;
        section.2(&mut runs, over(section))?; // counts the runs
    }
    runs.begin()?;
    for section in &sections {
        let tables = section.2(&mut runs, over(section))?;
        let words = match section.1 {
            Over::Scenes | Over::Views(_) => over(section)
                .iter()
                .map(|scene| format!(" {}", scene.name))
                .collect(),
            Over::Clips => folder
                .iter()
                .map(|dir| format!(" --clips {}", name(dir)))
                .collect(),
            Over::Machine => String::new(),
        };
        let date = std::mem::take(&mut runs.date);
        let line = format!(
            "*{date}, {origin}, `cargo lab results --only {}{words}`*",
            section.0
        );
        page::write(
            &page,
            &page::replaced(&page, section.0, &format!("{line}\n\n{tables}"))?,
        )?;
    }
    Ok(())
}

#[test]
fn wrong_arguments_are_refused() {
    let only = |words: &[&str]| {
        words
            .iter()
            .map(|word| (*word).to_owned())
            .collect::<Vec<_>>()
    };
    for (words, scenes) in [
        (&["view"][..], vec!["a".into()]),
        (&["kernels", "views"], vec![]),
        (&[], vec![]),
    ] {
        let wanted = Results {
            only: only(words),
            scenes,
            ..Results::default()
        };
        let error = run(Path::new("nowhere"), &wanted).unwrap_err().to_string();
        assert!(
            ["section", "scene"].iter().any(|word| error.contains(word)),
            "{error}"
        );
    }
}
