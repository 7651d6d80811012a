//! The folder of results: names of jobs, which are safe as folder names on any system, where
//! everything of a job lies, and the record of its outcome, `.state/ID.json`.

use crate::batch::manifest::VERSION;
use minute4d::Error;
use minute4d::json::read_json;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// What a published result says of the job that it belongs to.
pub const RESULT_FILE: &str = "batch.json";
/// The folder of results: one folder per clip, and hidden ones for the work itself.
#[derive(Debug, Clone)]
pub struct Layout {
    root: PathBuf,
}

impl Layout {
    /// Results under `root`.
    pub fn new(root: &Path) -> Self {
        let root = root.to_path_buf();
        Self { root }
    }

    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// The published result of a clip.
    pub fn result(&self, id: &str) -> PathBuf {
        self.root.join(id)
    }

    /// Where a clip's scene is made.
    pub fn work(&self, id: &str) -> PathBuf {
        self.root.join(".work").join(id)
    }

    /// The settings of the run in [`Self::work`].
    pub(crate) fn settings(&self, id: &str) -> PathBuf {
        self.root.join(".work").join(format!("{id}.toml"))
    }

    /// Locked by the process that runs the job.
    pub(crate) fn lock(&self, id: &str) -> PathBuf {
        self.root.join(".lock").join(id)
    }

    /// The folder of what came of the clips: it is made when a batch is planned, so that it is
    /// known whether the results are mounted.
    pub(crate) fn states(&self) -> PathBuf {
        self.root.join(".state")
    }

    /// What came of a clip.
    pub fn state(&self, id: &str) -> PathBuf {
        self.states().join(format!("{id}.json"))
    }

    /// Log of the runs of a clip.
    pub fn log(&self, id: &str) -> PathBuf {
        self.root.join(".log").join(format!("{id}.txt"))
    }

    /// The folder in which a result is checked before it is published.
    pub(crate) fn incoming(&self, id: &str) -> PathBuf {
        self.root.join(".incoming").join(id)
    }

    /// The folder in which an older result waits to be removed.
    pub(crate) fn outgoing(&self, id: &str) -> PathBuf {
        self.root.join(".outgoing").join(id)
    }
}

/// Most characters of a name before what makes it unique.
const LONGEST: usize = 80;
/// Characters of a hash that make a name unique.
const HASH_CHARS: usize = 8;

/// Names that Windows keeps for devices.
const DEVICES: [&str; 4] = ["con", "prn", "aux", "nul"];

/// Gives each input `(name, path)` an id. Those whose names fall together, also where case does not
/// count, get a piece of the hash of their path, so that no id depends on which other clips are
/// listed later or earlier.
pub(crate) fn ids(inputs: &[(String, String)]) -> Vec<String> {
    let plain: Vec<String> = inputs.iter().map(|(name, _)| safe(name)).collect();
    let mut count: HashMap<String, usize> = HashMap::new();
    for name in &plain {
        *count.entry(name.to_lowercase()).or_default() += 1;
    }
    let mut ids = Vec::with_capacity(plain.len());
    for (name, (_, path)) in plain.into_iter().zip(inputs) {
        let alone = count.get(&name.to_lowercase()).is_some_and(|&n| n == 1);
        ids.push(if alone {
            name
        } else {
            format!("{name}-{}", short_hash(path, HASH_CHARS))
        });
    }
    ids
}

pub(crate) fn short_hash(text: &str, chars: usize) -> String {
    blake3::hash(text.as_bytes()).to_hex()[..chars].to_owned()
}

fn safe(name: &str) -> String {
    let safe_char = |c: char| {
        if c.is_ascii_alphanumeric() || "._-".contains(c) {
            c
        } else {
            '_'
        }
    };
    let text: String = name.chars().map(safe_char).take(LONGEST).collect();
    let text = text.trim_start_matches(['.', '-']).trim_end_matches('.');
    match text {
        "" => "clip".to_owned(),
        text if DEVICES.contains(&text.to_lowercase().as_str()) => format!("{text}_"),
        text => text.to_owned(),
    }
}

/// Whether an id of a manifest can be the name of a folder: it names no other place.
pub(crate) fn is_safe(id: &str) -> bool {
    !id.is_empty()
        && id.len() <= LONGEST + HASH_CHARS + 1
        && !id.starts_with(['.', '-'])
        && id
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "._-".contains(c))
}

/// The outcome of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The result is published.
    Done,
    /// A permanent failure, for which the clip's own bytes are the evidence: it is not run again
    /// unless forced.
    Failed,
    /// The machine could not do it, or it was stopped: a note only, which does not prevent another
    /// run.
    Retryable,
}

/// The record of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JobRecord {
    /// [`VERSION`].
    pub version: u32,
    /// The job.
    pub id: String,
    /// Hash of input and settings that all this is of; another one starts again.
    pub key: String,
    /// The outcome.
    pub outcome: Outcome,
    /// The reason.
    pub reason: String,
    /// Exit code of the run, where it had one.
    pub code: Option<i32>,
    /// Wall-clock seconds that it took.
    pub seconds: f64,
    /// The machine.
    pub host: String,
}

impl JobRecord {
    /// The record, if there is one that this release can use and that is of this input and these
    /// settings.
    pub(crate) fn read(path: &Path, key: &str) -> Result<Option<Self>, Error> {
        Ok(read_json::<Self>(path)?.filter(|r| r.version == VERSION && r.key == key))
    }
}

#[cfg(test)]
mod tests {
    use super::{ids, is_safe};

    #[test]
    fn ids_are_safe_unique_and_do_not_depend_on_the_order() {
        let ids_of = |names: &[(&str, &str)]| {
            let owned: Vec<_> = names
                .iter()
                .map(|(a, b)| ((*a).to_owned(), (*b).to_owned()))
                .collect();
            ids(&owned)
        };
        let odd = ids_of(&[
            ("../../etc", "1"),
            ("a b\nc", "2"),
            ("ü", "3"),
            ("con", "4"),
            ("...", "5"),
            ("x", "6"),
        ]);
        assert_eq!(odd, ["_.._etc", "a_b_c", "_", "con_", "clip", "x"]);
        let long = "l".repeat(500);
        let clash = ids_of(&[
            ("Clip", "/a/Clip.mp4"),
            ("clip", "/b/clip.mp4"),
            (&long, "l"),
        ]);
        assert!(
            clash[0].starts_with("Clip-") && clash[1].starts_with("clip-"),
            "{clash:?}"
        );
        assert_ne!(clash[0].to_lowercase(), clash[1].to_lowercase());
        let turned = ids_of(&[("clip", "/b/clip.mp4"), ("Clip", "/a/Clip.mp4")]);
        assert_eq!((&turned[0], &turned[1]), (&clash[1], &clash[0]));
        assert!(
            odd.iter().chain(&clash).all(|id| is_safe(id)),
            "{odd:?} {clash:?}"
        );
        for bad in ["", "..", ".hidden", "a/b", "-rf", "a\\b", "ä"] {
            assert!(!is_safe(bad), "{bad}");
        }
    }
}
