//! Which modules of a crate use which: no cycle among its top modules, so that each can be read
//! after those that it uses.
//!
//! A top module is `src/NAME.rs` or `src/NAME/`. An arrow is a path that starts with `crate::`, or
//! with `super::` up to the root of the crate, in code that is no test; names that the root
//! re-exports count for the module that they come from. Code in the root itself has a place of its
//! own, the name of its file.

mod tokens;

use crate::paper::{Sources, sources};
use anyhow::{Context, Result, anyhow, bail};
use proc_macro2::{TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use tokens::{attribute, item, path_goes_on, sign, strings, tree, word};

/// For each top module those that it uses, each with an example: the file and the name.
pub type Modules = BTreeMap<String, BTreeMap<String, String>>;

/// A use of a name of the crate's root.
struct Use {
    /// The top module that uses it, or the root.
    from: String,
    name: String,
    /// The path as it goes on from the root, for people.
    path: String,
    file: String,
}

/// Where a name comes from.
enum Home {
    /// A top module, or the root.
    Here(String),
    /// Another crate.
    Elsewhere,
}

/// Where tokens stand.
#[derive(Clone)]
struct Place {
    /// The path of the module, empty for the root.
    module: Vec<String>,
    /// The file.
    file: String,
    /// The folder of the files of its modules, with a slash at the end.
    folder: String,
}

/// What is read of a crate.
struct Reader<'a> {
    sources: &'a Sources,
    /// The file of the root without its folders.
    root: &'static str,
    /// For each name in the root, the first part of the path that it comes from; for an item of the
    /// root its file.
    names: BTreeMap<String, String>,
    modules: BTreeSet<String>,
    uses: Vec<Use>,
}

/// The top modules of the crate whose sources are in `folder` (`crates/m4_io/src/`).
///
/// # Errors
///
/// A file that is missing or no Rust, and a name that the root does not have.
pub fn modules(folder: &str, sources: &Sources) -> Result<Modules> {
    let root = if sources.contains_key(&format!("{folder}lib.rs")) {
        "lib.rs"
    } else {
        "main.rs"
    };
    let place = Place {
        module: Vec::new(),
        file: format!("{folder}{root}"),
        folder: folder.to_owned(),
    };
    let mut reader = Reader {
        sources,
        root,
        names: BTreeMap::new(),
        modules: BTreeSet::new(),
        uses: Vec::new(),
    };
    reader.file(&place)?;
    let mut modules: Modules = reader
        .modules
        .iter()
        .map(|name| (name.clone(), BTreeMap::new()))
        .collect();
    for Use {
        from,
        name,
        path,
        file,
    } in &reader.uses
    {
        let to = reader
            .home(name)
            .with_context(|| format!("{file}: no `{name}` in the root of the crate"))?;
        if let Home::Here(to) = to
            && to != *from
        {
            let arrows = modules.entry(from.clone()).or_default();
            arrows
                .entry(to)
                .or_insert_with(|| format!("{path} in {file}"));
        }
    }
    Ok(modules)
}

impl Reader<'_> {
    /// Where a name of the root comes from.
    fn home(&self, name: &str) -> Option<Home> {
        let from = if self.modules.contains(name) {
            name
        } else {
            self.names.get(name)?
        };
        let is_here = from == self.root || self.modules.contains(from);
        Some(if is_here {
            Home::Here(from.to_owned())
        } else {
            Home::Elsewhere
        })
    }

    fn file(&mut self, place: &Place) -> Result<()> {
        let text = self
            .sources
            .get(&place.file)
            .with_context(|| format!("no file {}", place.file))?;
        let tokens: TokenStream = text.parse().map_err(|e| anyhow!("{}: {e}", place.file))?;
        self.tokens(tokens, place, true)
    }

    /// Reads tokens; `items` where they are those of a module.
    fn tokens(&mut self, tokens: TokenStream, place: &Place, items: bool) -> Result<()> {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut exported = false;
        let mut i = 0;
        while i < tokens.len() {
            let rest = &tokens[i..];
            if let Some((attribute, length)) = attribute(rest) {
                let text = attribute.to_string().replace(' ', "");
                if text == "cfg(test)" || text.starts_with("cfg(all(test,") {
                    i += length + item(&rest[length..]);
                    continue;
                }
                exported |= text == "macro_export";
                self.tokens(strings(attribute), place, false)?;
                i += length;
                continue;
            }
            i += match word(rest, 0).as_deref() {
                Some("mod") if items && word(rest, 1).is_some() => self.module(rest, place)?,
                Some("macro_rules") if sign(rest, 1, '!') => {
                    let name = word(rest, 2).unwrap_or_default();
                    let home = place.module.first().filter(|_| exported).cloned();
                    if let Some(home) =
                        home.or_else(|| place.module.is_empty().then(|| self.root.to_owned()))
                    {
                        self.names.insert(name, home);
                    }
                    exported = false;
                    3
                }
                Some("use") if !sign(rest, 1, '<') => self.import(&tokens, i, place)?,
                Some("crate" | "self" | "super") if path_goes_on(rest) => {
                    let mut paths = Vec::new();
                    let length = tree(rest, &[], &mut paths);
                    for (path, _) in &paths {
                        self.path(path, place)?;
                    }
                    length
                }
                Some(name) if place.module.is_empty() => {
                    self.in_root(name, &tokens[..i], path_goes_on(rest), items, place);
                    1
                }
                _ => {
                    if let TokenTree::Group(group) = &rest[0] {
                        self.tokens(group.stream(), place, false)?;
                    }
                    1
                }
            };
        }
        Ok(())
    }

    /// `mod name;` or `mod name { .. }`.
    fn module(&mut self, tokens: &[TokenTree], place: &Place) -> Result<usize> {
        let name = word(tokens, 1).unwrap_or_default();
        if place.module.is_empty() {
            self.modules.insert(name.clone());
        }
        let mut inner = place.clone();
        inner.module.push(name.clone());
        inner.folder = format!("{}{name}/", place.folder);
        if let Some(TokenTree::Group(group)) = tokens.get(2) {
            self.tokens(group.stream(), &inner, true)?;
        } else {
            inner.file = format!("{}{name}.rs", place.folder);
            if !self.sources.contains_key(&inner.file) {
                inner.file = format!("{}mod.rs", inner.folder);
            }
            self.file(&inner)?;
        }
        Ok(3)
    }

    /// `use a::{b, c as d};`: in the root it gives names.
    fn import(&mut self, tokens: &[TokenTree], at: usize, place: &Place) -> Result<usize> {
        let mut paths = Vec::new();
        let length = 1 + tree(&tokens[at + 1..], &[], &mut paths);
        for (path, name) in paths {
            if !place.module.is_empty() {
                self.path(&path, place)?;
                continue;
            }
            let Some(first) = path
                .iter()
                .find(|part| !["crate", "self"].contains(&part.as_str()))
            else {
                continue;
            };
            if name == "*" {
                bail!(
                    "{}: `use {first}::*` hides which names the root has",
                    place.file
                );
            }
            self.names.entry(name).or_insert_with(|| first.clone());
        }
        Ok(length)
    }

    /// A word in the root's own code: an item that it defines, or a name that it uses.
    fn in_root(
        &mut self,
        name: &str,
        before: &[TokenTree],
        leads: bool,
        items: bool,
        place: &Place,
    ) {
        let defines = [
            "const", "enum", "fn", "static", "struct", "trait", "type", "union",
        ];
        let last = before.len().wrapping_sub(1);
        let keyword = word(before, last).is_some_and(|word| defines.contains(&word.as_str()));
        if sign(before, last, '.')
            || sign(before, last, ':') && sign(before, last.wrapping_sub(1), ':')
        {
            return;
        }
        if items && keyword {
            self.names.insert(name.to_owned(), self.root.to_owned());
        } else if leads && self.modules.contains(name) || self.names.contains_key(name) {
            let (from, file) = (self.root.to_owned(), place.file.clone());
            self.uses.push(Use {
                from,
                name: name.to_owned(),
                path: name.to_owned(),
                file,
            });
        }
    }

    /// A path that may lead to the root and down again.
    fn path(&mut self, path: &[String], place: &Place) -> Result<()> {
        let up = path.iter().take_while(|part| *part == "super").count();
        let at = match path[0].as_str() {
            "crate" => 1,
            "self" if place.module.is_empty() => 1,
            "super" if up == place.module.len() => up,
            _ => return Ok(()),
        };
        let Some(name) = path.get(at).filter(|name| *name != "self") else {
            return Ok(());
        };
        if name == "*" {
            bail!(
                "{}: a glob of the whole crate hides what is used",
                place.file
            );
        }
        let from = place
            .module
            .first()
            .map_or(self.root, String::as_str)
            .to_owned();
        self.uses.push(Use {
            from,
            name: name.clone(),
            path: path[at..].join("::"),
            file: place.file.clone(),
        });
        Ok(())
    }
}

/// The top modules that use each other in a circle, one set for each circle or knot of circles.
pub fn cycles(modules: &Modules) -> Vec<BTreeSet<&str>> {
    let all: BTreeMap<&str, BTreeSet<&str>> = modules
        .keys()
        .map(|name| (&**name, reached(modules, name)))
        .collect();
    let mut knots: BTreeSet<BTreeSet<&str>> = BTreeSet::new();
    for (name, to) in &all {
        knots.insert(
            to.iter()
                .copied()
                .filter(|other| all.get(other).is_some_and(|back| back.contains(name)))
                .collect(),
        );
    }
    knots.into_iter().filter(|knot| !knot.is_empty()).collect()
}

/// What `from` uses, and what that uses.
fn reached<'a>(modules: &'a Modules, from: &'a str) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&str> = vec![from];
    while let Some(name) = open.pop() {
        let targets = modules.get(name).into_iter().flat_map(BTreeMap::keys);
        open.extend(targets.map(String::as_str).filter(|to| reached.insert(*to)));
    }
    reached
}

/// Says which modules of `name` use each other in a circle, one text for each circle; empty when
/// there is none.
pub fn violations(name: &str, modules: &Modules) -> Vec<String> {
    let mut faults = Vec::new();
    for knot in cycles(modules) {
        let list = knot.iter().copied().collect::<Vec<_>>().join(", ");
        let mut text = format!("modules of {name} use each other in a circle: {list}");
        for from in &knot {
            for (to, example) in modules[*from]
                .iter()
                .filter(|(to, _)| knot.contains(to.as_str()))
            {
                text.push_str(&format!("\n  {from} -> {to}: {example}"));
            }
        }
        faults.push(text);
    }
    faults
}

/// Checks every crate under `root`.
pub fn check(root: &Path) -> Result<()> {
    let sources = sources(root)?;
    let of = |file: &'_ String| Some(file.split_once("/src/")?.0.to_owned());
    let mut packages: BTreeSet<String> = sources.keys().filter_map(of).collect();
    packages.retain(|package| root.join(package).join("Cargo.toml").is_file());
    let mut faults = Vec::new();
    for package in &packages {
        faults.extend(violations(
            package,
            &modules(&format!("{package}/src/"), &sources)?,
        ));
    }
    if faults.is_empty() {
        Ok(())
    } else {
        bail!("{}", faults.join("\n"))
    }
}
