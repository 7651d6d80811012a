//! All readers.
//!
//! ```text
//! io        images, arrays, tracks, camera paths, captures, scene files, MegaSaM, video
//! formats   splats and cameras of other tools
//! import    clips of other tools: one row for each file that is parsed
//! side      depth, masks and tracks that are given with a clip
//! program   settings, records, manifests of batches and records of their jobs
//! broken    readers that fail, for the tests of the watcher
//! ```

mod broken;
mod formats;
mod import;
mod io;
mod made;
mod program;
mod side;

use crate::fixture::fixture_bytes;
use crate::reader::{Around, Outcome, Reader};
use crate::wrap::Wrap;
use std::path::Path;

/// Every reader, in the order of the crates; names are unique.
#[must_use]
pub fn readers() -> Vec<Reader> {
    [
        io::rows(),
        formats::rows(),
        import::rows(),
        side::rows(),
        program::rows(),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// The families of readers: what their names begin with, in the order of the alphabet.
#[must_use]
pub fn families() -> Vec<&'static str> {
    let mut all: Vec<_> = readers().iter().map(Reader::family).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// The readers of a family, in the order of the table.
#[must_use]
pub fn of_family(family: &str) -> Vec<Reader> {
    readers().into_iter().filter(|r| r.family() == family).collect()
}

/// Readers that fail, each in its own way: what looks for failures has to find it in them.
#[must_use]
pub fn broken_readers() -> Vec<Reader> {
    broken::rows()
}

/// The reader of that name.
#[must_use]
pub fn reader(name: &str) -> Option<Reader> {
    readers().into_iter().chain(broken_readers()).find(|r| r.name == name)
}

/// A reader of one file that is called `file`.
fn alone(
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
        if file.is_empty() {
            from.to_owned()
        } else {
            format!("{from}/{file}")
        }
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
            if of.file == *to {
                from.clone()
            } else {
                format!("{from}{}", &of.file[to.len()..])
            }
        }
        _ => panic!("{name} is within no fixture"),
    };
    let wrap = Wrap::member(&archive, member);
    Reader {
        name,
        wrap,
        seeds: Box::new(move |_| {
            let all = crate::wrap::members(&archive);
            all.into_iter()
                .filter(|(n, _)| n == member)
                .map(|(_, bytes)| bytes)
                .collect()
        }),
        ..of
    }
}
