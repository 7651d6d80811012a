//! One reader, its folder, and the outcome of a read.

use crate::files::{Wrap, copy, fixture};
use std::path::{Path, PathBuf};
use std::{fs, io};
use tempfile::TempDir;

/// Longest message of a refusal, characters: one that is longer quotes the file without end.
pub const MAX_REASON: usize = 1000;

/// What a reader made of some bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// They were read, and what was read is valid.
    Read,
    /// They were refused, with this message.
    Refused(String),
    /// They were taken, but what was read is not valid: what is wrong.
    Invalid(String),
}

impl Outcome {
    /// Of a result and a look at what was read.
    pub fn of<T, E: std::fmt::Display>(read: Result<T, E>, fault: impl FnOnce(&T) -> Option<String>) -> Self {
        match read {
            Err(e) => Self::Refused(e.to_string()),
            Ok(value) => fault(&value).map_or(Self::Read, Self::Invalid),
        }
    }
}

/// What else lies in the folder of a reader.
pub enum Around {
    /// Nothing.
    Nothing,
    /// Copies of fixtures: from, to (below the stage).
    Fixtures(Vec<(String, String)>),
    /// What a function writes.
    Made(fn(&Path)),
}

type Call = Box<dyn Fn(&Path) -> Outcome + Send + Sync>;
type Seeds = Box<dyn Fn(&Path) -> Vec<Vec<u8>> + Send + Sync>;

/// One reader of files.
pub struct Reader {
    /// As the folder of the corpus is called; what it begins with is the family, which has a target of the fuzzer.
    pub name: &'static str,
    /// Where the bytes are put, below the stage.
    pub file: String,
    /// What the reader is given, below the stage.
    pub given: String,
    pub around: Around,
    pub wrap: Wrap,
    pub seeds: Seeds,
    pub call: Call,
}

impl Reader {
    /// Returns the family of the reader.
    pub fn family(&self) -> &'static str {
        self.name.split('-').next().unwrap_or(self.name)
    }

    /// A folder in which this reader reads, ready for bytes. A temporary one, gone when the stage is.
    pub fn stage(&self) -> io::Result<Stage<'_>> {
        let folder = tempfile::Builder::new().prefix("m4fuzz").tempdir()?;
        let here = folder.path();
        match &self.around {
            Around::Nothing => {}
            Around::Fixtures(all) => {
                for (from, to) in all {
                    copy(&fixture(from), &here.join(to))?;
                }
            }
            Around::Made(make) => make(here),
        }
        let file = here.join(&self.file);
        if let Some(parent) = file.parent() {
            fs::create_dir_all(parent)?;
        }
        let seeds = (self.seeds)(&file);
        Ok(Stage {
            reader: self,
            file,
            given: if self.given.is_empty() { here.to_path_buf() } else { here.join(&self.given) },
            seeds,
            folder,
        })
    }
}

/// A reader with its folder.
pub struct Stage<'a> {
    reader: &'a Reader,
    file: PathBuf,
    given: PathBuf,
    seeds: Vec<Vec<u8>>,
    folder: TempDir,
}

impl Stage<'_> {
    /// Sound contents of the file; at least one.
    pub fn seeds(&self) -> &[Vec<u8>] {
        &self.seeds
    }

    /// The reader.
    pub fn reader(&self) -> &Reader {
        self.reader
    }

    /// Puts the bytes where they belong, and reads. A message has `STAGE` instead of the folder.
    pub fn read(&self, bytes: &[u8]) -> io::Result<Outcome> {
        // a file that is emptied and written again is sent to the disk at once by some file systems
        match fs::remove_file(&self.file) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => fs::write(&self.file, self.reader.wrap.on(bytes))?,
        }
        let folder = self.folder.path().to_string_lossy();
        Ok(match (self.reader.call)(&self.given) {
            Outcome::Refused(reason) => Outcome::Refused(reason.replace(&*folder, "STAGE")),
            other => other,
        })
    }

    /// What is wrong with what came of some bytes: not valid, or a message that quotes the file.
    pub fn fault(outcome: &Outcome) -> Option<String> {
        match outcome {
            Outcome::Read => None,
            Outcome::Invalid(what) => Some(format!("invalid: {what}")),
            Outcome::Refused(reason) => {
                let n = reason.chars().count();
                let start: String = reason.chars().take(160).collect();
                (n > MAX_REASON).then(|| format!("a message of {n} characters: {start}"))
            }
        }
    }
}
