//! Where the paper stands in the code: the table of equations of ARCHITECTURE.md against the
//! markers in the sources, and citations of the specifications against their headings.

use anyhow::{Context, Result, bail};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// What must have a row of the table, and for equations the caption that the row must begin with:
/// what each is in the paper.
pub const ITEMS: [(&str, &str); 13] = [
    ("Eq. 1", "Gaussian"),
    ("Eq. 2", "4DSH"),
    ("Eq. 3", "front end"),
    ("Eq. 4", "back-projection"),
    ("Eq. 5", "point tracking"),
    ("Eq. 6", "per-pixel error"),
    ("Eq. 7", "error mask"),
    ("Eq. 8", "refined error"),
    ("Eq. 9", "densify score"),
    ("Eq. 10", "prune score"),
    ("sec. 3.1", ""),
    ("sec. 3.2", ""),
    ("sec. 3.3", ""),
];

/// Prefix of an equation or a section of the paper in a marker.
const PAPER: &str = "Minute4D ";
/// Prefix of the name of a specification in a citation.
const SPECIFICATIONS: &str = "docs/spec/";

/// A row of the table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Row {
    /// Equation or section.
    pub item: String,
    /// Its caption: the second column up to a colon.
    pub caption: String,
    /// The files that it links to, relative to the root.
    pub files: Vec<String>,
}

/// The text of each source file, by its path relative to the root with forward slashes.
pub type Sources = BTreeMap<String, String>;

/// The digits and dots at the start of `text`, without a dot at their end.
fn number(text: &str) -> &str {
    let end = text
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(text.len());
    text[..end].trim_end_matches('.')
}

/// The markers of a source: `Minute4D Eq. 9` as `Eq. 9`, `Minute4D sec. 3.1` as `sec. 3.1`.
pub fn markers(source: &str) -> BTreeSet<String> {
    let mut markers = BTreeSet::new();
    for (at, _) in source.match_indices(PAPER) {
        let rest = &source[at + PAPER.len()..];
        for kind in ["Eq. ", "sec. "] {
            match rest.strip_prefix(kind).map(number) {
                Some(number) if !number.is_empty() => markers.insert(format!("{kind}{number}")),
                _ => false,
            };
        }
    }
    markers
}

/// The rows of the table whose header starts with `paper`.
pub fn rows(markdown: &str) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut in_table = false;
    for line in markdown.lines() {
        let Some(inside) = line.trim().strip_prefix('|') else {
            in_table = false;
            continue;
        };
        let mut columns = inside.split('|').map(str::trim);
        let (first, second) = (columns.next().unwrap_or(""), columns.next().unwrap_or(""));
        if in_table && !first.starts_with("--") {
            let links = inside
                .split("](")
                .skip(1)
                .filter_map(|part| part.split(')').next());
            rows.push(Row {
                item: first.to_owned(),
                caption: second.split(':').next().unwrap_or("").to_owned(),
                files: links.map(str::to_owned).collect(),
            });
        }
        in_table |= first == "paper";
    }
    rows
}

/// Compares table and sources; one line per mistake, empty when all is well.
pub fn violations(rows: &[Row], sources: &Sources) -> Vec<String> {
    let mut faults = Vec::new();
    for (item, caption) in ITEMS {
        match &rows
            .iter()
            .filter(|row| row.item == item)
            .collect::<Vec<_>>()[..]
        {
            [row] if caption.is_empty() || row.caption == caption => {}
            [row] => faults.push(format!(
                "the row for {item} has the caption `{}` in place of `{caption}`",
                row.caption
            )),
            several => faults.push(format!(
                "the table has {} rows for {item} in place of one",
                several.len()
            )),
        }
    }
    for Row { item, files, .. } in rows {
        if files.is_empty() {
            faults.push(format!("the row for {item} names no file"));
        }
        for file in files {
            match sources.get(file) {
                None => faults.push(format!(
                    "the row for {item} names {file}, which is no source file"
                )),
                Some(text) if !markers(text).contains(item) => {
                    faults.push(format!(
                        "{file} lacks the marker `{PAPER}{item}` of its row"
                    ));
                }
                Some(_) => {}
            }
        }
    }
    for (file, text) in sources {
        for marker in markers(text) {
            let named = rows
                .iter()
                .any(|row| row.item == marker && row.files.contains(file));
            if !named {
                faults.push(format!(
                    "{file} has the marker `{PAPER}{marker}`, and no row for it names the file"
                ));
            }
        }
    }
    faults
}

/// The numbers of the headings of a specification: `## 3. Optimisation` as `3`, `### 4.4 Reading`
/// as `4.4`.
pub fn headings(markdown: &str) -> BTreeSet<String> {
    let titles = markdown.lines().filter(|line| line.starts_with("##"));
    let numbers = titles.map(|line| number(line.trim_start_matches('#').trim_start()));
    numbers
        .filter(|n| !n.is_empty())
        .map(str::to_owned)
        .collect()
}

/// Citations such as `docs/spec/optimiser.md 4.4` whose file or heading does not exist; `headings`
/// are those of each specification by its path.
pub fn dangling(sources: &Sources, headings: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let mut faults = Vec::new();
    for (file, text) in sources {
        for (at, _) in text.match_indices(SPECIFICATIONS) {
            let cited = &text[at..];
            let end = cited
                .find(".md")
                .map_or(cited.len(), |end| end + ".md".len());
            let (specification, rest) = cited.split_at(end);
            let Some(headings) = headings.get(specification) else {
                let start = specification
                    .split_whitespace()
                    .next()
                    .unwrap_or(specification);
                faults.push(format!("{file} cites {start}, which is no specification"));
                continue;
            };
            let section = number(rest.trim_start());
            if !headings.contains(section) {
                faults.push(format!(
                    "{file} cites section `{section}` of {specification}, which has none"
                ));
            }
        }
    }
    faults
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Adds the Rust and TypeScript files under `folder`, which is `name` relative to the root.
fn collect(folder: &Path, name: &str, sources: &mut Sources) -> Result<()> {
    for entry in
        std::fs::read_dir(folder).with_context(|| format!("cannot list {}", folder.display()))?
    {
        let path = entry?.path();
        let Some(last) = path.file_name().and_then(|n| n.to_str()) else {
            continue;
        };
        let name = format!("{name}/{last}");
        if path.is_dir() {
            if !["node_modules", "target"].contains(&last) {
                collect(&path, &name, sources)?;
            }
        } else if path.extension().is_some_and(|e| e == "rs" || e == "ts") {
            sources.insert(name, read(&path)?);
        }
    }
    Ok(())
}

/// Folders of packages.
const FOLDERS: [&str; 3] = ["crates", "apps", "lab"];

/// The Rust and TypeScript files of the packages under `root`.
pub fn sources(root: &Path) -> Result<Sources> {
    let mut sources = Sources::new();
    for folder in FOLDERS {
        collect(&root.join(folder), folder, &mut sources)?;
    }
    Ok(sources)
}

/// Checks the sources under `root` against the table of its ARCHITECTURE.md and the headings of
/// `docs/spec`.
pub fn check(root: &Path) -> Result<()> {
    let sources = sources(root)?;
    let mut faults = violations(&rows(&read(&root.join("ARCHITECTURE.md"))?), &sources);
    let mut specifications = BTreeMap::new();
    for name in ["optimiser", "front-end", "scaffold"] {
        let path = format!("{SPECIFICATIONS}{name}.md");
        let text = read(&root.join(&path))?;
        specifications.insert(path, headings(&text));
    }
    faults.extend(dangling(&sources, &specifications));
    if faults.is_empty() {
        Ok(())
    } else {
        bail!("{}", faults.join("\n"))
    }
}
