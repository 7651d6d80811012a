//! The folder of a run.

use super::{checkpoints, remove_checkpoints, remove_half_written, take_over};
use crate::run::record::{RUN_FILE, RunRecord, Status};
use crate::run::steps::StepFolder;
use m4_io::atomic;
use m4_io::capture::Split;
use m4_io::results::{Kind, ResultFolder};
use minute4d::Error;
use minute4d::layout::{
    CAPTURE_FOLDER, CHECKPOINT_FOLDER, EVAL_FILE, Existing, METRICS_FILE, POSTER_FILE,
    PREVIEW_FILE, SCENE_FILE, VIEWER_FILE, is_capture,
};
use std::path::{Path, PathBuf};

/// The files that a run writes into its folder, its record first.
const FILES: [&str; 7] = [
    RUN_FILE,
    SCENE_FILE,
    METRICS_FILE,
    PREVIEW_FILE,
    VIEWER_FILE,
    EVAL_FILE,
    POSTER_FILE,
];
/// The folders, in the form of a list of results.
const CHECKPOINTS: &str = "checkpoints/";
const CAPTURE: &str = "capture/";

/// The folder of a run. Where it contains a scene, the run works in a folder beside it, and the old
/// scene, capture and record stay as they are until the run is complete.
pub(crate) struct RunFolder {
    results: ResultFolder,
    /// Where the run works.
    work: PathBuf,
    replaces: bool,
    /// The folder that keeps its old files: the input.
    input_folder: Option<&'static str>,
}

impl RunFolder {
    /// Creates or reuses the folder of the run that `record` describes, and locks it. Returns the
    /// record of an earlier run to resume.
    ///
    /// # Errors
    ///
    /// [`Error`] for a file of that name, a folder with other things in it, an unexpected earlier
    /// run, or one that is running, and where the run would replace one of its `inputs`. A capture
    /// of an earlier run that is the input is kept.
    pub fn open(
        path: &Path,
        existing: Existing,
        record: &RunRecord,
        inputs: &[&Path],
    ) -> Result<(Self, Option<RunRecord>), Error> {
        let mut results = ResultFolder::open(path, Kind::Run)?;
        let is_input =
            results.check_inputs([CAPTURE_FOLDER], inputs).is_err() && is_capture(inputs[0]);
        let names = || {
            FILES
                .into_iter()
                .chain([CHECKPOINTS])
                .chain((!is_input).then_some(CAPTURE))
        };
        results.check_inputs(names(), inputs)?;
        if !is_capture(inputs[0]) {
            results.check_not_itself(inputs)?;
        }
        let old = RunRecord::read(path)?;
        let replaces = old
            .as_ref()
            .is_some_and(|old| old.files.contains_key(SCENE_FILE));
        let nothing = old.as_ref().is_some_and(|old| old.status == Status::Failed)
            && contents(path).is_empty();
        let what = || match &old {
            Some(old) if old.status == Status::Finished => "a finished run".to_owned(),
            _ => format!("an unfinished run ({})", contents(path).join(", ")),
        };
        let mut earlier = take_over(&results, existing, old.clone(), nothing, what, RUN_FILE)?;
        results.check_free(names())?;
        let work = if replaces {
            results.next()
        } else {
            path.to_path_buf()
        };
        if replaces {
            // What a killed process left of those before the scene.
            remove_checkpoints(path)?;
            let begun = RunRecord::read(&work)?;
            let same = |old: &RunRecord| {
                old.settings == record.settings && old.input.blake3 == record.input.blake3
            };
            if earlier.is_none() {
                results.begin()?;
            } else if begun.is_none() || old.as_ref().is_some_and(same) {
                results.begin_with_old()?;
            } else {
                earlier = begun;
            }
            results.keep();
        } else {
            if earlier.is_none() {
                if results.names(CHECKPOINTS) {
                    remove_checkpoints(path)?;
                }
                results.clear(is_input.then_some(CAPTURE_FOLDER))?;
            }
            results.claim(names())?;
        }
        // No other process writes these while the folder is locked.
        remove_half_written(&work, &FILES)?;
        let saved = work.join(CHECKPOINT_FOLDER);
        atomic::remove_temporary(&saved, false, &atomic::is_temporary)
            .map_err(Error::write(&saved))?;
        let input_folder = is_input.then_some(CAPTURE_FOLDER);
        Ok((
            Self {
                results,
                work,
                replaces,
                input_folder,
            },
            earlier,
        ))
    }

    /// Where the run works.
    pub fn path(&self) -> &Path {
        &self.work
    }

    /// Where its results are when it is complete.
    pub fn place(&self) -> &Path {
        self.results.path()
    }

    /// Puts the results of the complete run into their place.
    pub fn commit(&mut self) -> Result<(), Error> {
        if self.replaces {
            self.results.commit(self.input_folder)?;
            Ok(())
        } else {
            Ok(self.results.release()?)
        }
    }
}

/// What an unfinished run left that is worth keeping.
fn contents(folder: &Path) -> Vec<String> {
    let mut all = Vec::new();
    let capture = folder.join(CAPTURE_FOLDER);
    if capture.join(Split::Train.file_name()).is_file() {
        all.push("a capture".to_owned());
    } else if StepFolder::exist(&capture) {
        all.push("finished steps of geometry".to_owned());
    }
    let saved = checkpoints(folder).len();
    if saved > 0 {
        all.push(format!(
            "{saved} checkpoint{}",
            if saved == 1 { "" } else { "s" }
        ));
    }
    if folder.join(SCENE_FILE).is_file() {
        all.push("a scene".to_owned());
    }
    all
}
