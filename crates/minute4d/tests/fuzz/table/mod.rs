//! All readers.
//!
//! ```text
//! io        images, arrays, tracks, camera paths, captures, scene files, splats and cameras of other tools, video
//! import    clips of other tools: one row for each file that is parsed; depth, masks and tracks that are given with a clip
//! program   settings, records, manifests of batches and records of their jobs
//! made      valid files by our own writers
//! ```

mod import;
mod io;
mod made;
mod program;

use crate::files::{Wrap, fixture_bytes, members};
use crate::reader::{Around, Outcome, Reader};
use std::path::Path;

/// Every reader, in the order of the crates; names are unique.
pub fn readers() -> Vec<Reader> {
    [io::rows(), import::rows(), program::rows()].into_iter().flatten().collect()
}

/// The families of readers: what their names begin with, in the order of the alphabet.
pub fn families() -> Vec<&'static str> {
    let mut all: Vec<_> = readers().iter().map(Reader::family).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// A reader of one file that is called `file`.
pub fn alone(
    name: &'static str,
    file: &str,
    seeds: impl Fn() -> Vec<Vec<u8>> + Send + Sync + 'static,
    call: impl Fn(&Path) -> Outcome + Send + Sync + 'static,
) -> Reader {
    Reader {
        name,
        file: file.to_owned(),
        given: file.to_owned(),
        around: Around::Nothing,
        wrap: Wrap::Plain,
        seeds: Box::new(move |_| seeds()),
        call: Box::new(call),
    }
}

/// A reader of a copy of `fixtures/SOURCE`, in which the bytes take the place of `file` (empty: of the source itself).
fn among(
    name: &'static str,
    source: &str,
    file: &str,
    call: impl Fn(&Path) -> Outcome + Send + Sync + 'static,
) -> Reader {
    let base = source.rsplit('/').next().unwrap_or(source);
    let of = |from: &str| {
        if file.is_empty() { from.to_owned() } else { format!("{from}/{file}") }
    };
    let seed = of(source);
    Reader {
        name,
        file: of(base),
        given: base.to_owned(),
        around: Around::Fixtures(vec![(source.to_owned(), base.to_owned())]),
        wrap: Wrap::Plain,
        seeds: Box::new(move |_| vec![fixture_bytes(&seed)]),
        call: Box::new(call),
    }
}

/// The same where the bytes are one member of the archive.
fn within(name: &'static str, member: &'static str, of: Reader) -> Reader {
    let archive = match &of.around {
        Around::Fixtures(all) => {
            let (from, to) = &all[0];
            if of.file == *to { from.clone() } else { format!("{from}{}", &of.file[to.len()..]) }
        }
        _ => panic!("{name} is within no fixture"),
    };
    let wrap = Wrap::member(&archive, member);
    Reader {
        name,
        wrap,
        seeds: Box::new(move |_| {
            let all = members(&archive);
            all.into_iter().filter(|(n, _)| n == member).map(|(_, bytes)| bytes).collect()
        }),
        ..of
    }
}
