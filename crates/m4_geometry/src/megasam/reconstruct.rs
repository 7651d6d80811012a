//! All stages, one after the other: tracking, flow of pairs of frames, consistent depth.

use super::cvd::pairs::{FramePair, PairStore, consistency_mask, halved, pair_list};
use super::cvd::{ConsistentDepth, CvdInput, optimise, uncertainty_of_static};
use super::tracker::{Correspondence, FrameInput, Tracked, TrackerInput};
use super::{
    CELL_PX, DepthPrior, MegasamError, MegasamSettings, PriorKind, TrackingSize, from_grid, tracker,
};
use crate::classical::dense::SourceError;
use crate::dba::Observability;
use crate::flow::{InverseSearch, ScaledFrame};
use crate::resample::resize_bilinear;
use m4_core::{Flow, Intrinsics, Plane, Progress, RgbImage, Se3};

/// Disparity below which a pixel of the tracker's own counts as infinitely far, scene units.
const LEAST_DISPARITY: f32 = 1e-3;

/// A clip.
#[derive(Clone, Copy)]
pub struct MegasamInput<'a> {
    /// The images, all of one size.
    pub images: &'a [&'a RgbImage],
    /// Instants, seconds, ascending.
    pub times_s: &'a [f64],
    /// First guess of the lens of the images; the principal point stays.
    pub lens: Intrinsics,
    /// False keeps the focal length of `lens` whatever can be seen.
    pub focal_is_free: bool,
    /// Depth from one image at the size of tracking; `None` where there is none.
    pub prior: Option<&'a DepthPrior>,
}

/// What was found; lists are `[frames]`.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct MegasamGeometry {
    /// The size at which the clip was tracked.
    pub size: TrackingSize,
    /// The lens of the images.
    pub lens: Intrinsics,
    /// Camera to world, in the unit of [`metric`](Self::metric).
    pub c2w: Vec<Se3<f64>>,
    /// z-depth of the whole images, at the size before cutting ([`TrackingSize::scaled`]); what was
    /// cut has that of the edge.
    pub depth: Vec<Plane<f32>>,
    /// Probability that each cell of the tracker's grid is static, 0..=1.
    pub static_confidence: Vec<Plane<f32>>,
    /// True if lengths are metres.
    pub metric: bool,
    /// Scene units a unit of length: what tracker and published files work in.
    pub norm: f64,
    /// What the keyframes could tell about depth and focal length.
    pub observability: Observability,
    /// True if the focal length was adjusted.
    pub focal_adjusted: bool,
    /// Frames that were keyframes.
    pub keyframes: Vec<usize>,
    /// Root mean square of the tracker's weighted residuals at the end, pixels of the images.
    pub residual_px: f64,
}

impl MegasamGeometry {
    /// How likely each pixel of a whole image is static, 0..=1, at `width` x `height` pixels.
    #[must_use]
    pub fn static_at(&self, frame: usize, width: usize, height: usize) -> Plane<f32> {
        from_grid(
            &self.static_confidence[frame],
            width,
            height,
            self.size.scaled,
        )
    }
}

/// Tracks a clip: cameras, focal length, and disparity and static confidence at 1/8 (MegaSaM 3.2).
///
/// `correspondence` sees images of [`TrackingSize::resized`].
///
/// # Errors
///
/// [`MegasamError`] for images that do not fit together or are too few, where the source fails, or
/// when the user stops.
pub fn track(
    input: &MegasamInput<'_>,
    correspondence: &mut dyn Correspondence,
    settings: &MegasamSettings,
    progress: &dyn Progress,
) -> Result<Tracked, MegasamError> {
    let size = check(input, settings)?;
    let frames = input.images.len();
    let grid = size.grid();
    let sensor = |frame: usize| match input.prior {
        Some(prior) => prior.sensor(frame),
        None => vec![0.0; grid.len()],
    };
    let inputs: Vec<FrameInput> = (0..frames)
        .map(|frame| FrameInput {
            frame,
            time_s: input.times_s[frame],
            sensor: sensor(frame),
        })
        .collect();
    let clip = TrackerInput {
        grid,
        lens: size.grid_lens(&input.lens),
        frames: &inputs,
    };
    let mut tracker = settings.tracker;
    tracker.optimise_focal &= input.focal_is_free;
    Ok(tracker::track(&clip, correspondence, &tracker, progress)?)
}

/// Makes the depth of a tracked clip consistent along the flow, and returns it with cameras and
/// static confidence in the unit of the depth (MegaSaM 3.3).
///
/// `flow` sees images of [`TrackingSize::resized`]. Without a prior, depth starts as what the
/// tracker found, and its unit is arbitrary.
///
/// # Errors
///
/// [`MegasamError`] for images that do not fit together, where the source of flow fails, or when
/// the user stops.
pub fn reconstruct(
    input: &MegasamInput<'_>,
    tracked: Tracked,
    flow: &mut dyn PairFlow,
    settings: &MegasamSettings,
    progress: &dyn Progress,
) -> Result<MegasamGeometry, MegasamError> {
    let size = check(input, settings)?;
    let frames = input.images.len();
    let grid = size.grid();
    let lens = size.full_lens(&input.lens, &tracked.geometry.lens);

    let image_of = |frame: usize| size.resized(input.images[frame]);
    let budget_bytes = settings.flow_budget_mb.saturating_mul(1_000_000);
    let pairs = measure(
        frames,
        &image_of,
        size.cropped,
        flow,
        budget_bytes,
        progress,
    )?;
    let (width, height) = (size.cropped.0 / 2, size.cropped.1 / 2);
    let on_grid = |values: &Vec<f32>| {
        Plane::from_fn(grid.width, grid.height, |x, y| values[y * grid.width + x])
    };
    let on_half =
        |plane: &Plane<f32>| -> Plane<f32> { from_grid(plane, width, height, size.cropped) };
    let disparity: Vec<Plane<f32>> = (0..frames)
        .map(|frame| match input.prior {
            Some(prior) => prior.halved(frame),
            None => on_half(&on_grid(&tracked.geometry.disparity[frame]))
                .map(|&d| d.max(LEAST_DISPARITY)),
        })
        .collect();
    let static_confidence: Vec<Plane<f32>> =
        tracked.static_confidence.iter().map(on_grid).collect();
    let uncertainty: Vec<Plane<f32>> = static_confidence
        .iter()
        .map(|plane| on_half(plane).map(|&m| uncertainty_of_static(m)))
        .collect();
    let c2w = tracked.c2w();
    let consistent = optimise(
        &CvdInput {
            c2w: &c2w,
            intrinsics: size.cropped_lens(&lens).resized(width, height),
            disparity: &disparity,
            uncertainty: &uncertainty,
        },
        &pairs,
        settings.cvd_steps,
        progress,
    )?;
    Ok(finish(
        input,
        size,
        lens,
        tracked,
        static_confidence,
        consistent,
    ))
}

/// Back to the unit of the depth.
fn finish(
    input: &MegasamInput<'_>,
    size: TrackingSize,
    lens: Intrinsics,
    tracked: Tracked,
    static_confidence: Vec<Plane<f32>>,
    consistent: ConsistentDepth,
) -> MegasamGeometry {
    let norm = input.prior.map_or(1.0, |prior| prior.norm);
    let metric = input
        .prior
        .is_some_and(|prior| prior.kind == PriorKind::Metric);
    // Relative depth has no unit worth going back to.
    let unit = if metric { norm } else { 1.0 };
    let c2w = tracked.c2w().into_iter().map(|mut pose| {
        pose.translation /= unit;
        pose
    });
    let depth = consistent.disparity.iter().map(|half| {
        let cropped = resize_bilinear(half, size.cropped.0, size.cropped.1);
        let z = |d: f32| (1.0 / (f64::from(d) * unit)) as f32;
        let (right, bottom) = (size.cropped.0 - 1, size.cropped.1 - 1);
        Plane::from_fn(size.scaled.0, size.scaled.1, |x, y| {
            z(cropped.row(y.min(bottom))[x.min(right)])
        })
    });
    MegasamGeometry {
        size,
        lens,
        c2w: c2w.collect(),
        depth: depth.collect(),
        static_confidence,
        metric,
        norm,
        observability: tracked.observability,
        focal_adjusted: tracked.focal_adjusted,
        keyframes: tracked.keyframes,
        residual_px: tracked.rms_px * CELL_PX as f64 * size.full.0 as f64 / size.scaled.0 as f64,
    }
}

fn check(
    input: &MegasamInput<'_>,
    settings: &MegasamSettings,
) -> Result<TrackingSize, MegasamError> {
    let expected = input.images.len();
    let full = input.images.first().map_or((0, 0), |p| p.size());
    let refused = |what: String| Err(MegasamError::Input(what));
    let other_size = |frame: usize, found: (usize, usize), wanted: (usize, usize)| {
        refused(format!(
            "image {frame} has {}x{} pixels where the first has {}x{}",
            found.0, found.1, wanted.0, wanted.1
        ))
    };
    if let Some(frame) = input.images.iter().position(|p| p.size() != full) {
        return other_size(frame, input.images[frame].size(), full);
    }
    let lists = [
        ("instants", input.times_s.len()),
        (
            "depth maps",
            input.prior.map_or(expected, DepthPrior::frames),
        ),
    ];
    for (what, count) in lists {
        if count != expected {
            return refused(format!(
                "{what} of {count} frames were given for {expected} images; give one an image, all of one size"
            ));
        }
    }
    let size = TrackingSize::new(full, settings.tracking_pixels)?;
    let maps = input.prior.filter(|prior| prior.frames() > 0);
    match maps.map(|prior| prior.disparity(0).size()) {
        Some(other) if other != size.cropped => other_size(0, other, size.cropped),
        _ => Ok(size),
    }
}

/// Measures flow between two frames of a clip. Pairs are asked for by step and then by source
/// ([`pair_list`]), so that a network can begin with what it found for a shorter step.
pub trait PairFlow {
    /// For records and messages.
    fn name(&self) -> &str;

    /// The flow of `pair` and that back, of the size of the images `a` (of the source) and `b`;
    /// fails where it cannot be had.
    fn both(
        &mut self,
        pair: FramePair,
        a: &RgbImage,
        b: &RgbImage,
    ) -> Result<[Flow; 2], SourceError>;
}

/// Looks at each pair anew.
impl PairFlow for InverseSearch {
    fn name(&self) -> &str {
        "classical"
    }

    fn both(&mut self, _: FramePair, a: &RgbImage, b: &RgbImage) -> Result<[Flow; 2], SourceError> {
        let [from, to] = [a, b].map(|image| ScaledFrame::new(image, image.size()));
        let (forward, backward) = InverseSearch::both(*self, &from, &to);
        Ok([forward, backward])
    }
}

const PHASE: &str = "flow between frames";

/// The flow of every pair at half the size of the images, with the pixels that return to where they
/// started; `budget_bytes` of it stay in memory.
///
/// # Errors
///
/// [`MegasamError`] where flow cannot be had or kept, or the user stops.
pub(super) fn measure(
    frames: usize,
    image_of: &dyn Fn(usize) -> RgbImage,
    size: (usize, usize),
    flow: &mut dyn PairFlow,
    budget_bytes: usize,
    progress: &dyn Progress,
) -> Result<PairStore, MegasamError> {
    let (width, height) = (size.0 / 2, size.1 / 2);
    let mut store = PairStore::new(width, height, budget_bytes);
    let pairs = pair_list(frames);
    let mut last: Option<(usize, RgbImage)> = None;
    for (done, &pair) in pairs.iter().enumerate() {
        if progress.cancelled() {
            return Err(MegasamError::Cancelled);
        }
        let a = match last.take() {
            Some((frame, image)) if frame == pair.source => image,
            _ => image_of(pair.source),
        };
        let b = image_of(pair.target);
        let both = flow.both(pair, &a, &b);
        let [forward, backward] = both.map_err(|source| MegasamError::Flow {
            between: (pair.source, pair.target),
            source,
        })?;
        let [forward, backward] = [forward, backward].map(|flow| halved(&flow));
        let mask = consistency_mask(&forward, &backward);
        store.push(pair, &forward, &mask)?;
        // The next pair of the shortest step begins here.
        last = Some((pair.target, b));
        progress.update(PHASE, done + 1, pairs.len(), flow.name());
    }
    Ok(store)
}
