//! Archives with the arrays of a whole clip, as networks of one pass leave them.

use crate::core::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceFault};
use crate::files::arrays::Arrays;
use crate::files::pictures::{self, Picture};
use crate::files::{Inside, clock, lens};
use m4_scene::Progress;
use std::path::Path;

/// Names of the arrays; the first that is there is read.
pub(super) struct Keys {
    pub images: &'static [&'static str],
    pub depth: &'static [&'static str],
    /// World to camera.
    pub w2c: &'static [&'static str],
    /// Camera to world.
    pub c2w: &'static [&'static str],
    pub intrinsics: &'static [&'static str],
}

/// Reads the arrays; pictures that are not among them come from the options.
pub(super) fn list(
    path: &Path,
    keys: &Keys,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Listing, ReadSourceError> {
    clock::fps(options).map_err(|fault| fault.at(path))?;
    let mut arrays = Arrays::open(path, options)?;
    let depth = arrays.need(keys.depth, "depth maps tell the size that the cameras are for")?;
    let (n, w, h) = arrays.map_shape(depth)?;
    let c2w = match arrays.find(keys.c2w) {
        Some(name) => arrays.poses(name)?,
        None => {
            let name = arrays.need(keys.w2c, "poses are needed")?;
            arrays.poses(name)?.iter().map(m4_math::Se3::inverse).collect()
        }
    };
    let intrinsics = arrays.need(keys.intrinsics, "intrinsics are needed, in pixels of the depth maps")?;
    let lenses = arrays.lenses(intrinsics, n, (w, h))?;
    let count = |what: &str, found: usize| {
        let what = format!("it has {n} depth maps but {found} {what}");
        SourceFault::bad(what, "give what one run of the network left").at(path)
    };
    if c2w.len() != n {
        return Err(count("poses", c2w.len()));
    }
    let mut times_s = None;
    let pictures = match (&options.pictures, arrays.find(keys.images)) {
        (Some(folder), _) => {
            let all = pictures::read(folder, &Inside::named(folder, options), options, progress)?;
            times_s = all.times_s;
            all.all
        }
        (None, Some(name)) => {
            let all = arrays.pictures(name, progress)?.into_iter().enumerate();
            all.map(|(i, rgb)| Picture {
                name: format!("{i:05}"),
                size: rgb.size(),
                rgb: FrameSource::held(rgb),
            })
            .collect()
        }
        (None, None) => {
            let what = format!("the array {}", keys.images.join(" or "));
            let remedy = "give the folder of the pictures that the network saw (pictures)";
            return Err(SourceFault::missing(what, remedy).at(path));
        }
    };
    if pictures.len() != n {
        return Err(count("pictures", pictures.len()));
    }
    let depths = arrays.maps(depth, progress)?;
    let mut train = Vec::with_capacity(n);
    for (i, ((picture, depth), (k, c2w))) in pictures.into_iter().zip(depths).zip(lenses.iter().zip(c2w)).enumerate() {
        let k = lens::scaled(k, picture.size);
        let k = k.map_err(|fault| fault.within(path, format!("frame {i} ({})", picture.name)))?;
        train.push(ListedFrame {
            depth: Some(depth),
            ..ListedFrame::new(picture.name, Lens::pinhole(k), c2w, i as f64, picture.rgb)
        });
    }
    let last_s = times_s.and_then(|times| times.last().copied());
    let duration_s = clock::duration_of(last_s, n, options, progress);
    Ok(Listing::of_video(train, n, duration_s))
}
