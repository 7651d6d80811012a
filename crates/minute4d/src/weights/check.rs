//! Compares a file with its published size and checksum.

use super::{Entry, WeightsError};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::io::{self, Read, Write};

/// Size and SHA-256 of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sum {
    pub bytes: u64,
    pub sha256: String,
}

/// Copies all of `from` to `to` (at most `limit` bytes and one more, which tells that there are too many) and sums it up.
///
/// # Errors
///
/// What reading or writing says; the side is in the first field.
pub fn copy(from: impl Read, mut to: impl Write, limit: Option<u64>) -> Result<Sum, (Side, io::Error)> {
    let mut from = from.take(limit.map_or(u64::MAX, |n| n + 1));
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    let mut bytes = 0;
    loop {
        let n = match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => n,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err((Side::Read, error)),
        };
        hasher.update(&buffer[..n]);
        to.write_all(&buffer[..n]).map_err(|error| (Side::Write, error))?;
        bytes += n as u64;
    }
    let mut sha256 = String::new();
    for byte in hasher.finalize() {
        let _ = write!(sha256, "{byte:02x}");
    }
    Ok(Sum { bytes, sha256 })
}

/// The end of a copy that failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Read,
    Write,
}

/// Compares `sum` of the file `what` with what `entry` says.
///
/// # Errors
///
/// [`WeightsError::Differs`] with the first difference.
pub fn compare(entry: &Entry, what: &str, sum: &Sum) -> Result<(), WeightsError> {
    let differs = |expected: String, found: String| WeightsError::Differs {
        name: entry.name,
        what: what.to_owned(),
        expected,
        found,
    };
    match entry.bytes {
        Some(bytes) if sum.bytes > bytes => {
            return Err(differs(format!("{bytes} bytes"), "more".to_owned()));
        }
        Some(bytes) if sum.bytes != bytes => {
            return Err(differs(format!("{bytes} bytes"), format!("{} bytes", sum.bytes)));
        }
        None if sum.bytes == 0 => return Err(differs("a checkpoint".to_owned(), "an empty file".to_owned())),
        _ => {}
    }
    match entry.sha256 {
        Some(sha256) if sha256 != sum.sha256 => {
            Err(differs(format!("SHA-256 {sha256}"), format!("SHA-256 {}", sum.sha256)))
        }
        _ => Ok(()),
    }
}
