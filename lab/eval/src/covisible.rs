//! Co-visibility masks: the pixels of a test image that the training video saw.
//!
//! Published masks of the data set take precedence (`covisible/` in the capture, or a given
//! folder); the files are named like the images of their views. Without them, masks are computed
//! from the poses and depth of the training frames. A test image has no depth, so the depth of the
//! training frames is first projected into it, each pixel as a square of its projected size, the
//! nearest on top; then each training frame is tested for seeing that point
//! (`m4_eval::image::covisible::seen_by_depth`). Dynamic pixels are valid only at the time of the
//! test image: they are projected from the training frame that is nearest in time.

use crate::error::Error;
use m4_core::{Camera, Capture, CaptureFrame, DepthMap, Mask, Plane};
use m4_eval::image::covisible::{CovisibleCounts, DEPTH_TOLERANCE, DepthView, seen_by_depth};
use m4_io::capture::Split;
use m4_io::image::read_mask;
use m4_io::reach::Reach;
use minute4d::layout::COVISIBLE_FOLDER;
use minute4d::{Category, Observer, Refusal, Settings};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Training frames that are asked at most: the share that saw a pixel hardly changes with more.
const MOST_FRAMES: usize = 60;
/// Largest square that a pixel is drawn as, pixels.
const MOST_SIDE: f64 = 4.0;

/// Where masks come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskSource {
    /// The protocol scores whole images.
    None,
    /// Files that a data set publishes, or that were given.
    Files,
    /// Made from poses and depth of the training frames: such scores compare with one another
    /// alone.
    Computed,
}

/// The masks of a protocol.
pub(super) enum Masks {
    None,
    Files(PathBuf),
    Computed(Box<Training>),
}

/// The training views.
pub(super) struct Training {
    frames: Vec<TrainingView>,
    of: usize,
}

struct TrainingView {
    camera: Camera,
    t: f64,
    depth: DepthMap,
    moves: Option<Mask>,
}

impl Masks {
    /// Of the capture in the folder `data`, which may name files within `reach`, or of the folder
    /// `mask_folder`.
    pub fn find(
        data: &Path,
        mask_folder: Option<&Path>,
        reach: Reach,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        if let Some(folder) = mask_folder {
            if folder.is_dir() {
                return Ok(Self::Files(folder.to_path_buf()));
            }
            let what = "folder of co-visibility masks";
            return Err(minute4d::Error::missing(what, folder).into());
        }
        let root = if data.is_dir() {
            data
        } else {
            data.parent().unwrap_or(data)
        };
        let own = root.join(COVISIBLE_FOLDER);
        if own.is_dir() {
            return Ok(Self::Files(own));
        }
        let mut settings = Settings::fast();
        settings.capture.reach = reach;
        let capture = m4_io::capture::read(root, Split::Train, &settings.capture, observer)?;
        let training = Training::of(capture).map_err(|why| {
            let (root, hint) = (
                root.display(),
                "give the official ones with --covisible DIR",
            );
            Refusal::bad_input(format!(
                "co-visibility masks cannot be computed for {root}: {why}; {hint}"
            ))
        })?;
        observer.warn(
            "there are no published co-visibility masks: they are computed from poses and depth of the training frames, and scores inside \
             them are not comparable with published ones",
        );
        Ok(Self::Computed(Box::new(training)))
    }

    pub fn source(&self) -> MaskSource {
        match self {
            Self::None => MaskSource::None,
            Self::Files(_) => MaskSource::Files,
            Self::Computed(_) => MaskSource::Computed,
        }
    }

    /// Description for reports.
    pub fn description(&self) -> String {
        match self {
            Self::None => "none: whole images".to_owned(),
            Self::Files(folder) => format!("the files of {}", folder.display()),
            Self::Computed(training) => format!(
                "made from poses and depth of {} of {} training frames: seen by more than {} of them, depth within {} %",
                training.frames.len(),
                training.of,
                m4_eval::image::covisible::too_few_frames(training.frames.len()),
                100.0 * DEPTH_TOLERANCE
            ),
        }
    }

    /// The mask of a view, 255 where it counts; its camera is in the world of the capture.
    pub fn mask(&self, view: &CaptureFrame) -> Result<Option<Mask>, Error> {
        match self {
            Self::None => Ok(None),
            Self::Files(folder) => {
                let stem = Path::new(&view.name).file_stem().unwrap_or_default();
                let path = folder.join(format!("{}.png", stem.to_string_lossy()));
                if !path.is_file() {
                    let message = format!(
                        "there is no co-visibility mask {} for the view {}; masks are PNG files named as the image of their view, white \
                         where the training video saw the point",
                        path.display(),
                        view.name
                    );
                    return Err(Refusal::new(Category::NoInput, message).into());
                }
                let mask = read_mask(&path)?.to_mask();
                let (expected, size) = (view.rgb.size(), mask.size());
                if expected != size {
                    let message = format!(
                        "{} has {} x {} pixels but its view {} x {}; give the masks of the same factor",
                        path.display(),
                        size.0,
                        size.1,
                        expected.0,
                        expected.1
                    );
                    return Err(Refusal::bad_input(message).into());
                }
                Ok(Some(mask))
            }
            Self::Computed(training) => Ok(Some(training.mask(view)?)),
        }
    }
}

impl Training {
    fn of(capture: Capture) -> Result<Self, String> {
        let of = capture.frames.len();
        let step = of.div_ceil(MOST_FRAMES).max(1);
        let training_view = |frame: CaptureFrame| {
            let depth = frame.depth?.to_map();
            (depth.size() == frame.rgb.size()).then(|| TrainingView {
                camera: frame.camera,
                t: frame.t,
                depth,
                moves: frame.mask.map(|m| m.to_mask()),
            })
        };
        let frames: Vec<TrainingView> = capture
            .frames
            .into_iter()
            .step_by(step)
            .filter_map(training_view)
            .collect();
        if frames.is_empty() {
            return Err("its training frames have no depth".to_owned());
        }
        let few = m4_eval::image::covisible::too_few_frames(frames.len());
        if frames.len() <= few {
            return Err(format!(
                "a place counts when more than {few} training frames saw it, and {} have depth",
                frames.len()
            ));
        }
        Ok(Self { frames, of })
    }

    fn mask(&self, view: &CaptureFrame) -> Result<Mask, Error> {
        let depth = match view.depth.as_ref().map(m4_core::CompactDepth::to_map) {
            Some(own) if own.size() == view.rgb.size() => own,
            _ => self.depth(view),
        };
        let test = DepthView {
            camera: &view.camera,
            depth: &depth,
        };
        let (width, height) = view.rgb.size();
        let mut counts = CovisibleCounts::new(width, height);
        for training_view in &self.frames {
            let training = DepthView {
                camera: &training_view.camera,
                depth: &training_view.depth,
            };
            counts.add(&seen_by_depth(test, training, DEPTH_TOLERANCE)?)?;
        }
        Ok(counts.mask())
    }

    /// z-depth of the view, 0 where no training frame saw anything.
    fn depth(&self, view: &CaptureFrame) -> DepthMap {
        let camera = &view.camera;
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let mut out: DepthMap = Plane::filled(width, height, f32::INFINITY);
        let apart = |s: &TrainingView| (s.t - view.t).abs();
        let nearest = self.frames.iter().map(apart).fold(f64::INFINITY, f64::min);
        for training_view in &self.frames {
            let with_motion = apart(training_view) <= nearest;
            let moves = |x, y| {
                training_view
                    .moves
                    .as_ref()
                    .is_some_and(|m| m.size() == training_view.depth.size() && m[(x, y)] != 0)
            };
            let (w, h) = training_view.depth.size();
            for y in 0..h {
                for x in 0..w {
                    let z = f64::from(training_view.depth[(x, y)]);
                    if !(z.is_finite() && z > 0.0) || (!with_motion && moves(x, y)) {
                        continue;
                    }
                    let point = training_view.camera.unproject(x as f64, y as f64, z);
                    let ([u, v], target_depth) = camera.project(&point);
                    if target_depth > 0.0 {
                        // as large as the pixel lands
                        let side = camera.intrinsics.fx / training_view.camera.intrinsics.fx * z
                            / target_depth;
                        draw(
                            &mut out,
                            u,
                            v,
                            target_depth as f32,
                            side.clamp(1.0, MOST_SIDE),
                        );
                    }
                }
            }
        }
        out.map(|&z| if z.is_finite() { z } else { 0.0 })
    }
}

/// A square of `side` pixels around a place, where nothing nearer is.
fn draw(out: &mut DepthMap, u: f64, v: f64, z: f32, side: f64) {
    let (width, height) = out.size();
    let range = |at: f64, length: usize| {
        let (from, to) = ((at - side / 2.0).ceil().max(0.0), (at + side / 2.0).floor());
        // a cast saturates: below 0 there is nothing to draw
        let to = if to < 0.0 {
            0
        } else {
            (to as usize + 1).min(length)
        };
        from as usize..to
    };
    for y in range(v, height) {
        for x in range(u, width) {
            if z < out[(x, y)] {
                out[(x, y)] = z;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Masks, Training};
    use m4_core::{Capture, Plane};
    use m4_testkit::clips::plain_clip;

    fn capture(n: usize, depth: bool) -> Capture {
        let mut capture = plain_clip(n, (32, 16));
        for frame in &mut capture.frames {
            frame.depth = depth.then(|| Plane::filled(32, 16, 4.0).into());
        }
        capture
    }

    /// A wall at depth 4: a test camera a unit and a half to the right sees 6 columns that no
    /// training camera saw.
    #[test]
    fn pixels_unseen_in_training_are_masked_out() {
        let training = Training::of(capture(8, true)).unwrap();
        let masks = Masks::Computed(Box::new(training));
        let mut view = capture(4, false).frames.remove(3);
        view.camera.c2w.translation.x = 1.5;
        let mask = masks.mask(&view).unwrap().unwrap();
        for y in 0..16 {
            for x in 0..32 {
                let visible = mask[(x, y)] != 0;
                assert!(
                    visible == (x < 26) || x == 26 || x == 25,
                    "{x} {y}: {visible}"
                );
            }
        }
        assert!(
            masks.description().contains("8 of 8 training frames"),
            "{}",
            masks.description()
        );
    }

    #[test]
    fn covisibility_without_depth_or_enough_frames_is_an_error() {
        assert!(Training::of(capture(8, false)).is_err_and(|why| why.contains("no depth")));
        assert!(Training::of(capture(5, true)).is_err_and(|why| why.contains("more than 5")));
    }
}
