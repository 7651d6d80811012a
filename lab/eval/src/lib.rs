//! Evaluation: scores of a scene on held-out views, with or without a protocol; scores of a capture
//! against ground truth.
//!
//! ```text
//! capture of a video --split by a Protocol--> capture with training and test frames --train--> scene
//! scene, its held-out views --views (Rules: masks, metrics, poses)--> eval.json with every choice
//! ```

mod aligned;
mod baselines;
mod by_protocol;
mod choices;
mod covisible;
mod error;
mod held_out;
mod motion;
mod perceptual;
mod poses;
pub mod protocol;
mod regions;
mod sets;
mod split;
mod truth;

pub use aligned::AlignedScore;
pub use baselines::{BaselineScore, mean_of};
pub use choices::{
    Choices, FrameChoice, Headline, MaskChoice, PoseChoice, PoseTreatment, ResolutionChoice,
};
pub use covisible::MaskSource;
pub use error::Error;
pub use held_out::{EvalOptions, HeldOut};
pub use motion::{motion, motion_table};
pub use perceptual::LpipsChoice;
pub use poses::{Alignment, Moved};
pub use protocol::{FrameRule, Protocol, Task};
pub use sets::{SetScore, read as read_views};
pub use split::{SPLIT_FILE, SplitRecord, split};
pub use truth::{no_test_list, read_truth};

use aligned::Shifts;
use m4_core::{Capture, CompactMask};
use m4_eval::geometry::{GeometryReport, evaluate};
use m4_eval::image::{ImageReport, MeanScore, PlanarImage};
use m4_io::capture::{CaptureOptions, Split};
use m4_io::reach::Reach;
use m4_io::results::Kind;
use m4_kernels::SimdLevel;
use minute4d::json::write_json;
use minute4d::layout::{self, CAPTURE_FOLDER, EVAL_FILE};
use minute4d::observer::check_stop;
use minute4d::render::SceneRenderer;
use minute4d::settings::Settings;
use minute4d::{Observer, hash};
use perceptual::Perceptual;
use protocol::LpipsRule;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;
use truth::{INSTANCE_FOLDERS, add_instances};

/// Compares the cameras, depth and masks of a capture with a reference for the same video: another
/// capture. `reach` is which files both may name.
///
/// # Errors
///
/// What could not be read, or why the two do not belong together.
pub fn geometry(
    capture: &Path,
    truth: &Path,
    reach: Reach,
    observer: &dyn Observer,
) -> Result<GeometryReport, Error> {
    let options = CaptureOptions {
        reach,
        ..Settings::fast().capture
    };
    let estimate = m4_io::capture::read(capture, Split::Train, &options, observer)?;
    minute4d::Error::unless_exists("known geometry", truth)?;
    Ok(evaluate(
        &estimate,
        &read_truth(truth, &options, observer)?,
    )?)
}

/// A mean over the views that have a score.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OtherMean {
    /// The mean.
    pub mean: f64,
    /// Number of views with it.
    pub views: usize,
}

/// `eval.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EvalReport {
    /// Release of the program that wrote it.
    pub minute4d: String,
    /// The scene that was judged.
    pub scene: PathBuf,
    /// BLAKE3 of its file.
    pub scene_blake3: String,
    /// The capture whose held-out views were used.
    pub data: PathBuf,
    /// Alignment of the held-out cameras, if the scene has a world of its own.
    pub alignment: Option<Alignment>,
    /// Splats of the scene.
    pub splats: usize,
    /// Means over all views.
    pub mean: Option<MeanScore>,
    /// Means by set of held-out views: far (the test list), near, between; without a protocol
    /// alone.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sets: Vec<SetScore>,
    /// Protocol, and one row per view of the test list.
    pub images: ImageReport,
    /// As `images`, of the views near the training camera, where the capture lists some.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub near: Option<ImageReport>,
    /// As `images`, of the views between training frames, where the capture lists some.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub between: Option<ImageReport>,
    /// Each dynamic object after its best shift, by set.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub aligned: Vec<AlignedScore>,
    /// The same views without training, where the data set has depth and masks.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub baselines: Vec<BaselineScore>,
    /// State of LPIPS without a protocol; a protocol's is in `choices`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lpips: Vec<LpipsChoice>,
    /// Means of the scores by other metrics.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub mean_others: BTreeMap<String, OtherMean>,
    /// Everything that the protocol chose, where there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub choices: Option<Choices>,
    /// Images a second while drawing, one after the other, each copied to the host.
    pub frames_per_s: Option<f64>,
    /// Rendering device: `cpu`, or the name of the GPU that drew all images.
    pub device: String,
    /// Seconds it took.
    pub seconds: f64,
}

/// Renders the held-out views of the capture `data` and compares them with its images; writes
/// `eval.json` into the run `out`. Where the options name a protocol, its rules hold and
/// `eval.json` names every choice.
///
/// A scene that was trained on another capture of the same video has a world of its own; the
/// held-out cameras are then placed by the similarity that takes the training cameras of `data` to
/// those of the scene, and a warning says how well that fits.
///
/// # Errors
///
/// [`minute4d::Error::Refused`] without held-out views, or if the capture cannot be judged by the
/// protocol; else what could not be read, compared or written.
pub fn views(
    out: &Path,
    data: &Path,
    options: &EvalOptions,
    observer: &dyn Observer,
) -> Result<EvalReport, Error> {
    let start = Instant::now();
    let level = SimdLevel::detect()?;
    // before anything large is read
    let split = match options.protocol {
        Some(protocol) => by_protocol::check(data, protocol, options)?,
        None => None,
    };
    let held = HeldOut::read(out, data, options.reach, observer)?;
    let gpu = options.device.open(|why| observer.warn(why))?;
    let mut renderer = SceneRenderer::new(&held.scene, level, gpu.as_ref(), observer)?;
    let (images, other, choices, drawing_s) = match options.protocol {
        None => {
            let (images, other, drawing_s) =
                plain(&held, data, out, options, &mut renderer, observer)?;
            (images, other, None, drawing_s)
        }
        Some(protocol) => {
            let scored = by_protocol::score(
                &held,
                data,
                protocol,
                split,
                options,
                (level, &mut renderer),
                observer,
            )?;
            (
                scored.images,
                OtherSets::default(),
                Some(scored.choices),
                scored.drawing_s,
            )
        }
    };
    let means = images.mean_others().into_iter();
    let report = EvalReport {
        minute4d: env!("CARGO_PKG_VERSION").to_owned(),
        scene_blake3: hash::of_path(&held.path)?,
        data: data.to_path_buf(),
        splats: held.scene.splats.n(),
        mean: images.mean(),
        mean_others: means
            .map(|(name, (mean, views))| (name, OtherMean { mean, views }))
            .collect(),
        choices,
        frames_per_s: (drawing_s > 0.0).then(|| images.frames.len() as f64 / drawing_s),
        device: gpu
            .as_ref()
            .filter(|_| renderer.is_on_gpu())
            .map_or("cpu", |gpu| gpu.name())
            .to_owned(),
        sets: other.rows,
        images,
        near: other.near,
        between: other.between,
        aligned: other.aligned,
        baselines: other.baselines,
        lpips: other.lpips,
        scene: held.path,
        alignment: held.alignment,
        seconds: start.elapsed().as_secs_f64(),
    };
    layout::claim(out, Kind::Run, &[EVAL_FILE])?;
    write_json(&out.join(EVAL_FILE), &report)?;
    Ok(report)
}

/// What is scored beside the test list.
#[derive(Default)]
struct OtherSets {
    rows: Vec<SetScore>,
    near: Option<ImageReport>,
    between: Option<ImageReport>,
    aligned: Vec<AlignedScore>,
    baselines: Vec<BaselineScore>,
    lpips: Vec<LpipsChoice>,
}

/// Joint PSNR and SSIM of images in 8 bits, LPIPS where it is installed, of every list of held-out
/// views; objects after their best shift; baselines where the data set has depth; and the seconds
/// of drawing.
fn plain(
    held: &HeldOut,
    data: &Path,
    out: &Path,
    options: &EvalOptions,
    renderer: &mut SceneRenderer<'_>,
    observer: &dyn Observer,
) -> Result<(ImageReport, OtherSets, f64), Error> {
    let read = CaptureOptions {
        reach: options.reach,
        ..Settings::fast().capture
    };
    let size = held.test.frames.first().map_or((0, 0), |v| v.rgb.size());
    let lpips = Perceptual::load(
        &[LpipsRule::Alex],
        false,
        size.0.min(size.1),
        options.device,
    )?;
    let train = match data.is_dir() && data.join(Split::Train.file_name()).is_file() {
        true => Some(read_truth(data, &read, observer)?),
        false => None,
    };
    let mut other = OtherSets {
        lpips: lpips.choices.clone(),
        ..OtherSets::default()
    };
    let mut lists = vec![("far", held.test.clone())];
    for (set, split) in [("near", Split::Near), ("between", Split::Between)] {
        lists.extend(sets::read(data, split, &read, observer)?.map(|views| (set, views)));
    }
    let (mut reports, mut drawing_s) = (BTreeMap::new(), 0.0);
    for (set, views) in &mut lists {
        add_instances(views, &data.join(INSTANCE_FOLDERS[1]))?;
        let mut shifts = Shifts::default();
        let (report, seconds) = score_views(
            held,
            views,
            data,
            options.grow_mask,
            (&mut *renderer, &lpips, &mut shifts),
            observer,
        )?;
        drawing_s += seconds;
        let angles = train.as_ref().map_or_else(
            || vec![None; views.frames.len()],
            |train| sets::angles(train, views),
        );
        other.rows.extend(sets::rows(set, &report, &angles));
        other.aligned.extend(shifts.rows(set));
        reports.insert(*set, report);
    }
    let complete = |c: &Capture| {
        c.frames
            .iter()
            .all(|f| f.depth.is_some() && f.mask.is_some())
    };
    if let Some(input) = train.filter(complete) {
        // a scene trained from a video has its own geometry beside it
        let own =
            sets::read(&out.join(CAPTURE_FOLDER), Split::Train, &read, observer)?.filter(complete);
        let lists: Vec<(&str, &Capture)> = lists.iter().map(|(set, views)| (*set, views)).collect();
        other.baselines = baselines::score(&input, own.as_ref(), held, &lists, observer)?;
    }
    let images = reports
        .remove("far")
        .unwrap_or_else(|| ImageReport::new("far", options.grow_mask));
    (other.near, other.between) = (reports.remove("near"), reports.remove("between"));
    Ok((images, other, drawing_s))
}

/// Scores the views of one list, and says how many seconds drawing took.
fn score_views(
    held: &HeldOut,
    capture: &Capture,
    data: &Path,
    grow_mask: usize,
    (renderer, lpips, shifts): (&mut SceneRenderer<'_>, &Perceptual, &mut Shifts),
    observer: &dyn Observer,
) -> Result<(ImageReport, f64), Error> {
    let views = &capture.frames;
    let mut images = ImageReport::new(data.display().to_string(), grow_mask);
    let mut drawing_s = 0.0;
    for (i, frame) in views.iter().enumerate() {
        check_stop(observer, "eval", false)?;
        let t = held.moment(frame);
        let begin = Instant::now();
        let drawn = held.draw(renderer, frame)?;
        drawing_s += begin.elapsed().as_secs_f64();
        let (image, reference) = (PlanarImage::from(&drawn), PlanarImage::from(&frame.rgb));
        let index = frame.camera_index;
        let mask = frame.mask.as_ref().map(CompactMask::to_mask);
        let score = images.add(&frame.name, t, index, &image, &reference, mask.as_ref())?;
        let note = format!("{:.2} dB", score.psnr_db);
        lpips.score(&mut images, &frame.name, &image, &reference, None)?;
        shifts.add(&drawn, frame)?;
        observer.update("eval", i + 1, views.len(), &note);
    }
    Ok((images, drawing_s))
}

impl EvalReport {
    /// The scores as tables for people: one line per view of the test list, then one per set.
    #[must_use]
    pub fn table(&self) -> String {
        let mut out = self.images.table();
        if !self.sets.is_empty() {
            out += &sets::table(&self.sets);
        }
        if !self.aligned.is_empty() {
            out += &aligned::table(&self.aligned);
        }
        if !self.baselines.is_empty() {
            out += &baselines::table(&self.baselines);
        }
        for missing in self.lpips.iter().filter_map(|lpips| lpips.absent.as_ref()) {
            out += &format!("LPIPS      not scored: {missing}\n");
        }
        out
    }
}
