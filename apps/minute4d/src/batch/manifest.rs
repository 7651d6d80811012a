//! The manifest: one JSON object per line, the first for all jobs, each other one for one job.

use crate::batch::layout;
use m4_io::{atomic, files};
use minute4d::{Category, Error, Refusal, hash};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::fs;
use std::path::Path;

/// `format` of the first line.
pub const FORMAT: &str = "minute4d-batch";
/// Version of the manifest and of every record of a batch.
pub const VERSION: u32 = 1;
/// Largest manifest that is read, bytes: over a million jobs.
const MAX_BYTES: u64 = 1 << 30;

/// What every run of a batch is started with. It is kept as text, so that nothing that is edited
/// later changes a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Arguments {
    /// Every setting, as TOML: what `--config` of a run is given.
    pub settings: String,
    /// Further arguments of `minute4d run`, such as `--device cpu`.
    pub arguments: Vec<String>,
}

impl Arguments {
    /// BLAKE3 of settings and arguments, hexadecimal.
    pub fn blake3(&self) -> String {
        let parts = std::iter::once(&self.settings)
            .chain(&self.arguments)
            .map(String::as_str);
        hash::of_parts(&parts.collect::<Vec<_>>())
    }
}

/// The first line.
#[derive(Debug, Serialize, Deserialize)]
struct Header {
    format: String,
    version: u32,
    /// Release of the program that planned.
    minute4d: String,
    /// Where results go: a folder with its whole path.
    results: String,
    /// The number of following lines.
    jobs: usize,
    settings_blake3: String,
    #[serde(flatten)]
    run: Arguments,
}

/// One clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Name of the job and of its result; unique, safe as a file name.
    pub id: String,
    /// The clip, with its whole path.
    pub input: String,
    /// BLAKE3 of its bytes, hexadecimal; of a file or folder.
    pub blake3: String,
    /// The folder of the result.
    pub output: String,
}

impl Job {
    /// Hash of the input and the settings: a result with the same key need not be made again.
    pub fn key(&self, run: &Arguments) -> String {
        hash::of_parts(&[&self.blake3, &run.blake3()])
    }
}

/// The jobs of a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct Manifest {
    /// Where results go: a folder with its whole path.
    pub results: String,
    /// What every run is started with.
    pub run: Arguments,
    /// The clips, in the order of their ids; the index of a job is its place here.
    pub jobs: Vec<Job>,
}

impl Manifest {
    /// Writes it, whole or not at all.
    ///
    /// # Errors
    ///
    /// [`Error::Refused`] where there is one and not `force`; [`Error::Write`] where it cannot be
    /// written.
    pub fn write(&self, path: &Path, force: bool) -> Result<(), Error> {
        if !force && fs::symlink_metadata(path).is_ok() {
            let message = format!("{} already exists; --force replaces it", path.display());
            return Err(Refusal::new(Category::CannotWrite, message).into());
        }
        let header = Header {
            format: FORMAT.to_owned(),
            version: VERSION,
            minute4d: env!("CARGO_PKG_VERSION").to_owned(),
            results: self.results.clone(),
            jobs: self.jobs.len(),
            settings_blake3: self.run.blake3(),
            run: self.run.clone(),
        };
        let mut lines = vec![serde_json::to_string(&header)];
        lines.extend(self.jobs.iter().map(serde_json::to_string));
        let lines: Result<Vec<String>, _> = lines.into_iter().collect();
        let text = lines.map_err(Error::internal)?.join("\n") + "\n";
        atomic::write(path, text.as_bytes()).map_err(Error::write(path))
    }

    /// Reads and checks one.
    ///
    /// # Errors
    ///
    /// [`Error::Read`]; [`Error::Refused`] for a file that is no manifest, or a damaged one, with
    /// the line.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = files::read(path, MAX_BYTES).map_err(Error::read(path))?;
        Self::parse(&text).map_err(|reason| {
            let path = path.display();
            Refusal::bad_input(format!(
                "{path}: {reason}; create the manifest again with `minute4d batch plan`"
            ))
            .into()
        })
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let text = std::str::from_utf8(bytes).map_err(|e| format!("it is not text ({e})"))?;
        let mut lines = text.lines().enumerate();
        let first = lines.next().map_or("", |(_, line)| line);
        let header: Header = serde_json::from_str(first)
            .map_err(|e| format!("line 1 is not the first line of a manifest ({e})"))?;
        if header.format != FORMAT || header.version != VERSION {
            let version = format!("{} {}", header.format, header.version);
            return Err(format!(
                "line 1 is of {version:?}, and {FORMAT} {VERSION} is read here"
            ));
        }
        if header.run.blake3() != header.settings_blake3 {
            return Err("line 1: settings or arguments were changed by hand".to_owned());
        }
        let (mut jobs, mut ids) = (Vec::new(), HashSet::new());
        for (i, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
            let line_number = i + 1;
            let job: Job = serde_json::from_str(line)
                .map_err(|e| format!("line {line_number} is not a job ({e})"))?;
            if !layout::is_safe(&job.id) {
                return Err(format!(
                    "line {line_number}: the id {:?} cannot be the name of a folder",
                    job.id
                ));
            }
            if !ids.insert(job.id.to_lowercase()) {
                return Err(format!(
                    "line {line_number}: the id {:?} was given before",
                    job.id
                ));
            }
            jobs.push(job);
        }
        if jobs.len() != header.jobs {
            return Err(format!(
                "it lists {} jobs and should list {}",
                jobs.len(),
                header.jobs
            ));
        }
        Ok(Self {
            results: header.results,
            run: header.run,
            jobs,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Arguments, Job, Manifest};
    use std::fs;

    fn manifest() -> Manifest {
        let job = |id: &str| Job {
            id: id.to_owned(),
            input: format!("/clips/{id}.mp4"),
            blake3: "00".to_owned(),
            output: format!("/results/{id}"),
        };
        Manifest {
            results: "/results".to_owned(),
            run: Arguments {
                settings: "a = 1\n[b]\nc = \"x\"\n".to_owned(),
                arguments: vec!["--device".to_owned(), "cpu".to_owned()],
            },
            jobs: vec![job("a"), job("b")],
        }
    }

    #[test]
    fn malformed_manifests_are_rejected_with_the_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("jobs.jsonl");
        manifest().write(&path, false).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        let (cut, _) = text.trim_end().rsplit_once('\n').unwrap();
        let cases = [
            (String::new(), "line 1"),
            (text.replace("minute4d-batch", "other"), "line 1"),
            (text.replace("a = 1", "a = 2"), "changed by hand"),
            (text.replace("\"id\":\"b\"", "\"id\":\"../b\""), "line 3"),
            (text.replace("\"id\":\"b\"", "\"id\":\"A\""), "given before"),
            (text.replace("\"id\":\"a\"", "\"id\":-7"), "line 2"),
            (
                text.replace("\"blake3\":\"00\",", ""),
                "missing field `blake3`",
            ),
            (cut.to_owned(), "lists 1 jobs and should list 2"),
        ];
        for (text, words) in cases {
            fs::write(&path, &text).unwrap();
            let message = Manifest::read(&path).unwrap_err().to_string();
            assert!(message.contains(words), "{words}: {message}");
        }
    }

    #[test]
    fn the_key_follows_input_and_settings() {
        let one = manifest();
        let key = one.jobs[0].key(&one.run);
        assert_eq!(
            key,
            one.jobs[1].key(&one.run),
            "the same bytes, whatever the name"
        );
        let other = Arguments {
            arguments: vec!["--device".to_owned(), "gpu".to_owned()],
            ..one.run.clone()
        };
        assert_ne!(key, one.jobs[0].key(&other));
        assert_ne!(
            key,
            Job {
                blake3: "01".to_owned(),
                ..one.jobs[0].clone()
            }
            .key(&one.run)
        );
    }
}
