//! Record3D's `.r3d`: a zip archive (or the folder that it was unpacked to) of images, depth and poses of an iPhone.
//!
//! ```text
//! metadata        JSON: w h (of K), dw dh (of depth), fps, K (9 numbers, columns first), perFrameIntrinsicCoeffs [n][fx fy cx cy],
//!                 poses [n][qx qy qz qw px py pz] camera to world, frameTimestamps [n] in seconds
//! rgbd/N.jpg      the image, as large as w x h or another multiple
//! rgbd/N.depth    z-depth, metres, 32-bit floats [dh][dw], LZFSE; 0 or NaN where unknown
//! rgbd/N.conf     0, 1 or 2, bytes [dh][dw], LZFSE; depth where it is 0 is dropped
//! ```
//!
//! Camera axes are ARKit's (x right, y up, z back): y and z turn round here. The principal point is measured from the corner.
//!
//! Images are taken as they are stored: poses, `K` and depth are those of the stored rows and columns, whatever an EXIF block says
//! about turning. Images that a tool turned for good (their longer side is not that of `w` and `h`) are refused. `K` is of
//! `w x h` and grows with the image. Source: the notes on the format in marek-simonik/record3d, `record3d_utils.py` of
//! nerfstudio.

mod metadata;
mod sensor;

use crate::dataset::files::{Inside, Members, clock, first_bytes, lens};
use crate::dataset::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceErrorCause};
use crate::image;
use m4_core::{Progress, RgbImage};
use metadata::Metadata;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Largest image file and what a decoded one may have.
const MAX_IMAGE_BYTES: u64 = 64 << 20;
const MAX_PIXELS: u64 = 64 << 20;

/// Detects a file or folder of the format.
pub(crate) fn detect(path: &Path) -> bool {
    if path.is_dir() {
        return path.join("metadata").is_file() && path.join("rgbd").is_dir();
    }
    let named = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("r3d"));
    named && first_bytes::<2>(path) == b"PK"
}

pub(crate) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    let members = Arc::new(Members::open(path, Inside::of(path, options)).map_err(|e| e.at(path))?);
    let metadata = Metadata::read(&members, path)?;
    let numbers = image_numbers(&members).map_err(|e| e.at(path))?;
    let poses = metadata.poses.len();
    let Some(&last) = numbers.last() else {
        return Err(SourceErrorCause::missing("every rgbd/N.jpg", "export the recording again as .r3d").at(path));
    };
    if last >= poses {
        let what = format!("the image rgbd/{last}.jpg has no pose: metadata has {poses}");
        return Err(SourceErrorCause::bad(what, "export the recording again as .r3d").at(path));
    }
    if numbers.len() < poses {
        progress.warn(&format!(
            "{} of {poses} poses of {} have no image and are ignored",
            poses - numbers.len(),
            path.display()
        ));
    }
    // of the first image; `load` compares the others
    let size = image(&members, numbers[0]).map_err(|e| e.at(path))?.size();
    let given = clock::fps(options).map_err(|e| e.at(path))?;
    let fps = metadata.fps.or(given);
    let taken = metadata.clock(&numbers, fps, path)?;
    let frames = numbers.iter().zip(&taken.t).map(|(&n, &t)| {
        let place = |cause: SourceErrorCause| cause.within(path, format!("frame {n}"));
        let k = metadata.intrinsics(n).map_err(place)?;
        let intrinsics = lens::resized(&k, size).map_err(place)?;
        let (for_rgb, for_depth) = (Arc::clone(&members), Arc::clone(&members));
        let (dw, dh) = metadata.depth_size();
        let c2w = metadata.c2w(n).map_err(place)?;
        let rgb = FrameSource::new(move || image(&for_rgb, n));
        Ok(ListedFrame {
            depth: members
                .has(&format!("rgbd/{n}.depth"))
                .map_err(place)?
                .then(|| FrameSource::new(move || sensor::depth(&for_depth, n, dw, dh))),
            ..ListedFrame::new(format!("rgbd/{n}.jpg"), Lens::pinhole(intrinsics), c2w, t, rgb)
        })
    });
    let train = frames.collect::<Result<_, _>>()?;
    Ok(Listing {
        metric: true,
        ..Listing::of_video(train, numbers.len(), taken.duration_s)
    })
}

/// The numbers of the images, in order.
fn image_numbers(members: &Members) -> Result<Vec<usize>, SourceErrorCause> {
    let names = members.names("rgbd")?;
    let mut numbers: Vec<usize> = names
        .iter()
        .filter_map(|n| n.strip_suffix(".jpg"))
        .filter_map(|n| n.parse().ok())
        .collect();
    numbers.sort_unstable();
    numbers.dedup();
    Ok(numbers)
}

fn image(members: &Members, n: usize) -> Result<RgbImage, SourceErrorCause> {
    let name = format!("rgbd/{n}.jpg");
    let bytes = members.read(&name, MAX_IMAGE_BYTES)?;
    let bytes = bytes.ok_or_else(|| SourceErrorCause::missing(&name, "export the recording again as .r3d"))?;
    // a JPEG makes some 400 pixels of a byte at most
    let most = MAX_PIXELS.min((1 << 20) + 1032 * bytes.len() as u64);
    Ok(image::decode_rgb(&bytes, &PathBuf::from(name), most)?)
}
