//! Data sets with ground truth, as their folders have it.

use crate::error::Error;
use m4_core::Capture;
use m4_io::capture::{CaptureOptions, Split};
use minute4d::{Observer, Refusal};
use std::path::Path;

/// Reads the training frames of a data set, with the instance maps of a benchmark scene.
pub fn read_truth(
    truth: &Path,
    options: &CaptureOptions,
    observer: &dyn Observer,
) -> Result<Capture, Error> {
    let mut read = m4_io::capture::read(truth, Split::Train, options, observer)?;
    add_instances(&mut read, &truth.join(INSTANCE_FOLDERS[0]))?;
    Ok(read)
}

/// Folders of a benchmark scene with an instance map per training image and per held-out image; its
/// lists of frames do not name them, so that no training reads them.
pub(crate) const INSTANCE_FOLDERS: [&str; 2] = ["instance", "test_instance"];

/// Adds the instance maps that lie in a folder, by the names of the images, to frames without.
pub(crate) fn add_instances(truth: &mut Capture, folder: &Path) -> Result<(), Error> {
    for frame in truth
        .frames
        .iter_mut()
        .filter(|frame| frame.instances.is_none())
    {
        let name = Path::new(&frame.name).with_extension("png");
        let file = name
            .file_name()
            .map(|name| folder.join(name))
            .filter(|file| file.is_file());
        if let Some(file) = file {
            frame.instances = Some(m4_io::image::read_ids(&file)?);
        }
    }
    Ok(())
}

/// The refusal of a capture without held-out views.
pub fn no_test_list(data: &Path) -> Refusal {
    Refusal::bad_input(format!(
        "{} has no transforms_test.json, so there are no held-out views to compare with; give a capture that has some",
        data.display()
    ))
}
