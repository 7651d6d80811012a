//! `minute4d gallery`: makes a page of many scenes.

use crate::failure::Failure;
use crate::gallery::{PAGE_FILE, list, page};
use crate::output::Output;
use crate::report_file;
use clap::Args;
use minute4d::Error;
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Gallery {
    /// A folder with the folders of scenes; the page is FOLDER/index.html
    pub folder: PathBuf,
}

pub fn run(args: &Gallery, output: &Output) -> Result<(), Failure> {
    let entries = list(&args.folder)?;
    let absolute = std::path::absolute(&args.folder).map_err(Error::read(&args.folder))?;
    let title = absolute
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let path = args.folder.join(PAGE_FILE);
    report_file::write(&path, page(&entries, &title).as_bytes())?;
    output.note(&format!(
        "{} scenes; the folder can be copied to any web host as it is",
        entries.len()
    ));
    Ok(output.result(path.display(), &json!({"path": path, "scenes": entries}))?)
}
