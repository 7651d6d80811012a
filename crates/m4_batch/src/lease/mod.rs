//! Who works on a job: files that only one worker can make.
//!
//! The leases of a job are numbered files in one folder. Whoever makes the next number has the job: making a file that is
//! not there yet is the one thing that a file system, also a shared one, lets only one of many do. A
//! lease is alive while its holder writes its file again and again; it is free when its content says that it was given back,
//! or when the file has not been written for longer than the lease lasts. Ages are taken on the file server's clock: that of
//! a file written there just now.
//!
//! A holder that finds a higher number than its own has lost the job. It is certain to find it before it publishes anything,
//! because for that it takes the next number itself ([`Lease::confirm`]).

mod hold;
mod store;

pub use hold::Lease;
pub use store::Seen;
pub(crate) use store::random;

use crate::error::FileError;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Duration;

/// Who holds a lease: the content of its file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// A random name of this worker.
    pub nonce: String,
    /// The machine.
    pub host: String,
    /// The process.
    pub pid: u32,
    /// When the lease was taken, seconds since 1970 by the holder's clock.
    pub since_s: u64,
    /// True when the job was given back.
    pub released: bool,
}

/// What came of asking for a job.
#[derive(Debug)]
pub enum Taken {
    /// It is ours; before us it may have been another's, who vanished without giving it back.
    Mine {
        /// To be held until the work is done.
        lease: Lease,
        /// Who vanished.
        vanished: Option<Seen>,
    },
    /// Another has it.
    Held(Option<Seen>),
}

/// Asks for the job whose leases are in `folder`. A lease that has not been renewed for `lasts` counts as free.
///
/// # Errors
///
/// [`FileError`] where the folder cannot be used.
pub fn take(folder: &Path, lasts: Duration, me: &Holder) -> Result<Taken, FileError> {
    let seen = look(folder)?;
    let (number, vanished) = match seen {
        None => (1, None),
        Some(seen) if seen.is_alive(lasts) => return Ok(Taken::Held(Some(seen))),
        Some(seen) if seen.is_released() => (seen.number + 1, None),
        Some(seen) => (seen.number + 1, Some(seen)),
    };
    match store::create(folder, number, me)? {
        Some(bytes) => Ok(Taken::Mine {
            lease: Lease::hold(folder, number, bytes, me, lasts),
            vanished,
        }),
        None => Ok(Taken::Held(None)),
    }
}

/// The newest lease of a job, if there is any.
///
/// # Errors
///
/// [`FileError`] where the folder cannot be read.
pub fn look(folder: &Path) -> Result<Option<Seen>, FileError> {
    store::newest(folder)
}

#[cfg(test)]
mod tests;
