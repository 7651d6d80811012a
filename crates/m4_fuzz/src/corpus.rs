//! Files of earlier findings: `corpus/READER/NAME`.

use std::path::{Path, PathBuf};
use std::{fs, io};

fn folder(reader: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(reader)
}

/// Names and contents of the earlier findings in a reader, in the order of the names; empty if there are none.
///
/// # Errors
///
/// What the system says.
pub fn corpus(reader: &str) -> io::Result<Vec<(String, Vec<u8>)>> {
    let entries = match fs::read_dir(folder(reader)) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut paths = entries.map(|e| e.map(|e| e.path())).collect::<io::Result<Vec<_>>>()?;
    paths.sort();
    let named = |p: PathBuf| {
        let name = p.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok((name, fs::read(&p)?))
    };
    paths.into_iter().map(named).collect()
}
