//! The two stages from the caller's side: checks, conventions, units.

use super::fast::{Descent, Moves, Start};
use super::pairs::PairStore;
use super::reference::{DISPARITY, UNCERTAINTY};
use super::{ADAM_EPSILON, LEARNING_RATE, WEIGHTS, WORKING_PERCENTILE_98};
use super::{CvdError, CvdInput};
use crate::dba::Pinhole;
use m4_core::{Plane, Progress, Se3, SimdLevel};

/// Images below this have no 5x5 neighbourhood to reflect.
const LEAST_SIDE_PX: usize = 8;

/// Consistent disparities and how they came about.
#[derive(Debug, Clone, PartialEq)]
pub struct ConsistentDepth {
    /// One over z-depth, one plane per frame, in the unit of the input; positive.
    pub disparity: Vec<Plane<f32>>,
    /// u, one plane per frame: low where a pixel does not follow the camera's motion.
    pub uncertainty: Vec<Plane<f32>>,
    /// The factor that stage 1 gave each frame: its disparity entered stage 2 as
    /// `scale initial + shift`.
    pub scale: Vec<f64>,
    /// The summand of stage 1, one over the unit of the poses.
    pub shift: Vec<f64>,
    /// The loss before each step, of both stages.
    pub losses: [Vec<f64>; 2],
}

/// Moves the disparity of every frame until the frames agree with one another along the flow.
///
/// Poses and intrinsics are held fixed, and the scale of the poses decides the scale of the result.
/// See the module for the method and [`super::pairs::PairStore`] for the flow. The result is the
/// same on any number of threads.
///
/// # Errors
///
/// [`CvdError`] if the inputs do not belong together or hold numbers that cannot be worked with, if
/// no pixel of any pair counts, if pairs cannot be read, or if `progress` says to stop.
pub fn optimise(
    input: &CvdInput<'_>,
    pairs: &PairStore,
    steps: [usize; 2],
    progress: &dyn Progress,
) -> Result<ConsistentDepth, CvdError> {
    check(input, pairs)?;
    let k = &input.intrinsics;
    let lens = Pinhole::of_image(k.fx, k.fy, k.cx, k.cy, 1.0);
    // disparities times this are worked on
    let unit = WORKING_PERCENTILE_98 / percentile_98(input.disparity);
    let w2c: Vec<Se3<f64>> = input
        .c2w
        .iter()
        .map(|pose| {
            let mut w2c = pose.inverse();
            w2c.translation /= unit;
            w2c
        })
        .collect();
    let scaled: Vec<Vec<f32>> = input
        .disparity
        .iter()
        .map(|plane| {
            plane
                .data()
                .iter()
                .map(|&d| (f64::from(d) * unit) as f32)
                .collect()
        })
        .collect();
    let starts: Vec<Start<'_>> = (0..scaled.len())
        .map(|i| Start {
            disparity: &scaled[i],
            uncertainty: input.uncertainty[i].data(),
        })
        .collect();
    let mut descent = Descent::new(SimdLevel::best(), [lens; 2], &w2c, pairs, &starts);
    drop(starts);
    drop(scaled);
    run(&mut descent, pairs.pairs().len(), steps, progress).map(|course| {
        let Course { affine, losses, .. } = course;
        let (width, height) = pairs.size();
        let plane = |data: Vec<f32>, factor: f64, limits: [f64; 2]| {
            let at = |x: usize, y: usize| {
                (f64::from(data[y * width + x]).clamp(limits[0], limits[1]) / factor) as f32
            };
            Plane::from_fn(width, height, at)
        };
        let disparity = descent
            .disparity()
            .into_iter()
            .map(|d| plane(d, unit, DISPARITY));
        let uncertainty = descent
            .uncertainty()
            .into_iter()
            .map(|u| plane(u, 1.0, UNCERTAINTY));
        ConsistentDepth {
            disparity: disparity.collect(),
            uncertainty: uncertainty.collect(),
            scale: affine.iter().map(|a| a.0).collect(),
            shift: affine.iter().map(|a| a.1 / unit).collect(),
            losses,
        }
    })
}

/// What a descent found besides its variables.
#[derive(Debug, Default)]
pub(super) struct Course {
    /// Scale and shift of each frame after the first stage.
    pub affine: Vec<(f64, f64)>,
    /// Loss before each step, of both stages.
    pub losses: [Vec<f64>; 2],
}

/// Runs both stages.
pub(super) fn run(
    descent: &mut Descent<'_>,
    pairs: usize,
    steps: [usize; 2],
    progress: &dyn Progress,
) -> Result<Course, CvdError> {
    const MOVES: [Moves; 2] = [Moves::Affine, Moves::Pixels];
    let total = steps[0] + steps[1];
    let mut course = Course::default();
    for (index, moves) in MOVES.into_iter().enumerate() {
        descent.begin();
        for step in 0..steps[index] {
            if progress.cancelled() {
                let stage = index + 1;
                return Err(CvdError::Cancelled { stage, step });
            }
            let (weights, rate) = (&WEIGHTS[index], LEARNING_RATE[index]);
            let report = descent.step(moves, weights, rate, ADAM_EPSILON, step + 1)?;
            if index == 0 && step == 0 && report.count == 0.0 {
                return Err(CvdError::NoFlow { pairs });
            }
            course.losses[index].push(report.loss);
            let done = course.losses[0].len() + course.losses[1].len();
            progress.update(
                "consistent depth",
                done,
                total,
                &format!("loss {:.4}", report.loss),
            );
        }
        if moves == Moves::Affine {
            course.affine = descent.settle();
        }
    }
    Ok(course)
}

fn check(input: &CvdInput<'_>, pairs: &PairStore) -> Result<(), CvdError> {
    let refused = |what: String| Err(CvdError::Input(what));
    let frames = input.c2w.len();
    let (width, height) = pairs.size();
    if width < LEAST_SIDE_PX || height < LEAST_SIDE_PX {
        return refused(format!(
            "frames of {width}x{height} are too small; at least {LEAST_SIDE_PX} px per side are needed"
        ));
    }
    let count = |what: &str, found: usize, expected: usize| {
        if found == expected {
            return Ok(());
        }
        refused(format!(
            "{what} has {found} entries where {expected} were expected; give one for each frame, all of one size"
        ))
    };
    let k = &input.intrinsics;
    count("disparity", input.disparity.len(), frames)?;
    count("uncertainty", input.uncertainty.len(), frames)?;
    count("a row of the intrinsics' image", k.width, width)?;
    count("a column of the intrinsics' image", k.height, height)?;
    for (pair, p) in pairs.pairs().iter().enumerate() {
        if p.source >= frames || p.target >= frames {
            return refused(format!(
                "pair {pair} is of frames {} and {}, but there are {frames} frames",
                p.source, p.target
            ));
        }
    }
    for frame in 0..frames {
        let pose = &input.c2w[frame];
        let lens = [
            k.fx,
            k.fy,
            k.cx,
            k.cy,
            k.fx.recip(),
            k.fy.recip(),
            k.fx.sqrt(),
            k.fy.sqrt(),
        ];
        let numbers = pose
            .rotation
            .iter()
            .chain(pose.translation.iter())
            .chain(&lens);
        if let Some(&value) = numbers.into_iter().find(|v| !v.is_finite()) {
            return refused(format!(
                "the camera of frame {frame} holds {value}; it must be finite, with focal lengths above 0"
            ));
        }
        let positive = |v: f32| v > 0.0 && v.is_finite();
        for (what, planes) in [
            ("disparity", input.disparity),
            ("uncertainty", input.uncertainty),
        ] {
            let plane = &planes[frame];
            count(what, plane.width(), width)?;
            count(what, plane.height(), height)?;
            if let Some(value) = plane.data().iter().find(|v| !positive(**v)) {
                return refused(format!(
                    "{what} of frame {frame} holds {value}; it must be above 0 and finite"
                ));
            }
        }
    }
    Ok(())
}

/// Of all pixels of all frames, by linear interpolation between ranks as NumPy has it; 0 frames
/// give 1.
fn percentile_98(disparity: &[Plane<f32>]) -> f64 {
    let mut values: Vec<f32> = disparity.iter().flat_map(|p| p.data()).copied().collect();
    if values.is_empty() {
        return 1.0;
    }
    let rank = 0.98 * (values.len() - 1) as f64;
    let (_, &mut below, above) =
        values.select_nth_unstable_by(rank.floor() as usize, f32::total_cmp);
    let next = above
        .iter()
        .copied()
        .min_by(f32::total_cmp)
        .unwrap_or(below);
    f64::from(below) + rank.fract() * f64::from(next - below)
}
