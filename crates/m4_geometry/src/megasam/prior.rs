//! Depth from one image as the tracker takes it: one disparity map per frame, one scale for the
//! clip; relative disparity of one network aligned to metric depth of another (stage B0,
//! docs/spec/front-end.md 1.2).

use super::{CELL_PX, MegasamError, TrackingSize};
use crate::resample::{crop, resize_bilinear, resize_nearest};
use m4_core::Plane;

/// Disparity in scene units below which a pixel counts as infinitely far: its depth would be
/// clamped.
const LEAST_DISPARITY: f32 = 1e-4;
/// Least depth in scene units that counts as known.
const LEAST_DEPTH: f32 = 0.01;

/// What the unit of the depth is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PriorKind {
    /// Metres.
    Metric,
    /// Not known: relative disparity alone.
    Relative,
}

/// Disparity of every frame of a clip in scene units, at the size of tracking.
#[derive(Debug, Clone)]
pub struct DepthPrior {
    /// What the unit is.
    pub kind: PriorKind,
    /// Scene units a unit of the depth: metres times this are scene units. MegaSaM divides by it
    /// and forgets it.
    pub norm: f64,
    /// `[frames]` of the cropped size; 0 where nothing is known.
    disparity: Vec<Plane<f32>>,
}

impl DepthPrior {
    /// Relative disparity (up to one scale and shift for the clip, 0 or more) aligned to metric
    /// depth, metres (not finite or 0 where unknown, which counts as infinitely far): MegaSaM's
    /// own. The relative maps are brought to the size of the metric ones.
    ///
    /// # Errors
    ///
    /// [`MegasamError`] for lists of different lengths, empty maps, or depth without scale.
    pub fn aligned(
        metric_m: &[Plane<f32>],
        relative: &[Plane<f32>],
        size: &TrackingSize,
    ) -> Result<Self, MegasamError> {
        pixels(metric_m)?;
        pixels(relative)?;
        let at_metric = |(relative, metric): (&Plane<f32>, &Plane<f32>)| {
            resize_nearest(relative, metric.width(), metric.height()).into_vec()
        };
        let relative: Vec<Vec<f32>> = if metric_m.len() == relative.len() {
            relative.iter().zip(metric_m).map(at_metric).collect()
        } else {
            // Let it say so.
            relative.iter().map(|r| r.data().to_vec()).collect()
        };
        let far = |z: &f32| if z.is_finite() && *z > 0.0 { *z } else { 1e8 };
        let metric: Vec<Vec<f32>> = metric_m
            .iter()
            .map(|m| m.data().iter().map(far).collect())
            .collect();
        let alignment = MonoAlignment::new(&metric, &relative)?;
        let disparity = relative.iter().zip(metric_m).map(|(relative, metric)| {
            let depth = alignment.sensor_depth(relative);
            let disparity = depth
                .iter()
                .map(|&z| if z > 0.0 { 1.0 / z } else { 0.0 })
                .collect();
            let plane = Plane::from_vec(metric.width(), metric.height(), disparity);
            plane.map(|plane| at_tracking(&plane, size))
        });
        let disparity: Result<Vec<_>, _> = disparity.collect();
        Ok(Self {
            kind: PriorKind::Metric,
            norm: alignment.norm,
            // the sizes are those of the maps themselves
            disparity: disparity.map_err(|_| no_pixels(0))?,
        })
    }

    /// Depth in metres alone (0 or not finite where unknown).
    ///
    /// # Errors
    ///
    /// [`MegasamError`] for no maps, empty maps, or maps in which nothing is known.
    pub fn metric(depth_m: &[Plane<f32>], size: &TrackingSize) -> Result<Self, MegasamError> {
        let inverse = |z: &f32| {
            if z.is_finite() && *z > 0.0 {
                1.0 / z
            } else {
                0.0
            }
        };
        let disparity: Vec<Plane<f32>> = depth_m.iter().map(|plane| plane.map(inverse)).collect();
        Self::of_disparity(PriorKind::Metric, &disparity, size)
    }

    /// Relative disparity alone, 0 or more: its shift is taken for 0.
    ///
    /// # Errors
    ///
    /// [`MegasamError`] for no maps, empty maps, or maps in which nothing is known.
    pub fn relative(disparity: &[Plane<f32>], size: &TrackingSize) -> Result<Self, MegasamError> {
        Self::of_disparity(PriorKind::Relative, disparity, size)
    }

    fn of_disparity(
        kind: PriorKind,
        disparity: &[Plane<f32>],
        size: &TrackingSize,
    ) -> Result<Self, MegasamError> {
        pixels(disparity)?;
        let is_known = |d: &&f32| d.is_finite() && **d > 0.0;
        let mut all: Vec<f64> = disparity
            .iter()
            .flat_map(|plane| plane.data())
            .filter(is_known)
            .map(|&d| f64::from(d))
            .collect();
        let norm = if all.is_empty() {
            0.0
        } else {
            percentile(&mut all, 0.98) / 2.0
        };
        if !(norm > 0.0 && norm.is_finite()) {
            return Err(no_scale(norm));
        }
        let scaled = |d: &f32| {
            let d = (f64::from(*d) / norm) as f32;
            let near = d > 1.0 / LEAST_DEPTH;
            if !d.is_finite() || d <= 0.0 || near {
                0.0
            } else {
                d.max(LEAST_DISPARITY)
            }
        };
        Ok(Self {
            kind,
            norm,
            disparity: disparity
                .iter()
                .map(|plane| at_tracking(&plane.map(scaled), size))
                .collect(),
        })
    }

    /// Number of frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.disparity.len()
    }

    /// Disparity of a frame in scene units, of the cropped size; 0 where unknown.
    #[must_use]
    pub fn disparity(&self, frame: usize) -> &Plane<f32> {
        &self.disparity[frame]
    }

    /// The same on the tracker's grid, `[height * width]`: one over the mean known depth of the 8 x
    /// 8 pixels around a cell's pixel.
    #[must_use]
    pub fn sensor(&self, frame: usize) -> Vec<f32> {
        let plane = &self.disparity[frame];
        let half = CELL_PX / 2;
        let (columns, rows) = (plane.width() / CELL_PX, plane.height() / CELL_PX);
        let cell = |n: usize| {
            let (x, y) = (n % columns * CELL_PX, n / columns * CELL_PX);
            let (mut depth, mut count) = (0.0_f32, 0_u32);
            for row in y.saturating_sub(half)..(y + CELL_PX - half) {
                for &d in &plane.row(row)[x.saturating_sub(half)..x + CELL_PX - half] {
                    if d > 0.0 {
                        depth += 1.0 / d;
                        count += 1;
                    }
                }
            }
            if depth > 0.0 {
                count as f32 / depth
            } else {
                0.0
            }
        };
        (0..columns * rows).map(cell).collect()
    }

    /// The same at half the size, bilinear; `1e-3` where unknown, as far away as the tracker takes
    /// it.
    #[must_use]
    pub(super) fn halved(&self, frame: usize) -> Plane<f32> {
        let plane = &self.disparity[frame];
        let half = resize_bilinear(plane, plane.width() / 2, plane.height() / 2);
        half.map(|&d| d.max(1e-3))
    }
}

fn at_tracking(plane: &Plane<f32>, size: &TrackingSize) -> Plane<f32> {
    crop(
        &resize_nearest(plane, size.scaled.0, size.scaled.1),
        size.cropped,
    )
}

fn no_pixels(frame: usize) -> MegasamError {
    MegasamError::Input(format!(
        "the depth of image {frame} has no pixels; give a map of the shape of the image"
    ))
}

fn pixels(planes: &[Plane<f32>]) -> Result<(), MegasamError> {
    match planes.iter().position(|p| p.data().is_empty()) {
        Some(frame) => Err(no_pixels(frame)),
        None => Ok(()),
    }
}

/// Metric depths below this with hardly any relative disparity are taken for sky that was
/// misjudged.
const SKY_DEPTH_M: f64 = 2.0;

/// Relative disparity below which they are.
const SKY_DISPARITY: f64 = 0.02;

/// The metric disparity that such pixels get instead, 1/m.
const SKY_METRIC: f64 = 0.01;

/// Depth of scene units below which a pixel counts as unknown.
const LEAST_SENSOR_DEPTH: f64 = 0.01;

/// Depth whose 98th percentile is no scale.
fn no_scale(norm: f64) -> MegasamError {
    MegasamError::Input(format!(
        "the depth of the clip has no scale (its disparity is {norm} at the 98th percentile); check the depth maps"
    ))
}

/// The alignment of a clip. Scene units are metres times [`norm`](Self::norm).
#[derive(Debug, Clone, PartialEq)]
pub struct MonoAlignment {
    /// Scale of each frame, 1/m per unit of relative disparity.
    pub scales: Vec<f64>,
    /// Shift of each frame, 1/m.
    pub shifts: Vec<f64>,
    /// The frame whose scale and shift all frames get.
    pub index: usize,
    /// Disparity of near content, 1/m, over two: divides disparities, and multiplies metres into
    /// scene units.
    pub norm: f64,
}

impl MonoAlignment {
    /// Aligns relative disparity to metric depth in metres, both `[frames][pixels]`.
    ///
    /// # Errors
    ///
    /// [`MegasamError::Input`] where lists do not fit together or hold nothing.
    pub fn new(metric_m: &[Vec<f32>], relative: &[Vec<f32>]) -> Result<Self, MegasamError> {
        if metric_m.is_empty() || metric_m.len() != relative.len() {
            return Err(MegasamError::Input(format!(
                "{} metric and {} relative depth maps were given; give one of each for every frame, at least one",
                metric_m.len(),
                relative.len()
            )));
        }
        let (mut scales, mut shifts) = (Vec::new(), Vec::new());
        for (frame, (metric, relative)) in metric_m.iter().zip(relative).enumerate() {
            if metric.is_empty() || metric.len() != relative.len() {
                return Err(MegasamError::Input(format!(
                    "frame {frame} has {} metric and {} relative values; give planes of the same size that are not empty",
                    metric.len(),
                    relative.len()
                )));
            }
            let (scale, shift) = frame_alignment(metric, relative);
            scales.push(scale);
            shifts.push(shift);
        }
        let product: Vec<f64> = scales.iter().zip(&shifts).map(|(s, b)| s * b).collect();
        let middle = median(&mut product.clone());
        let mut index = 0;
        for (k, p) in product.iter().enumerate() {
            if (p - middle).abs() < (product[index] - middle).abs() {
                index = k;
            }
        }
        let (scale, shift) = (scales[index], shifts[index]);
        let mut all: Vec<f64> = relative
            .iter()
            .flatten()
            .map(|&a| scale * f64::from(a) + shift)
            .collect();
        let norm = percentile(&mut all, 0.98) / 2.0;
        if !(norm > 0.0 && norm.is_finite()) {
            return Err(no_scale(norm));
        }
        Ok(Self {
            scales,
            shifts,
            index,
            norm,
        })
    }

    /// Depth in scene units of relative disparities, 0 where it is unknown.
    #[must_use]
    pub fn sensor_depth(&self, relative: &[f32]) -> Vec<f32> {
        let (scale, shift) = (self.scales[self.index], self.shifts[self.index]);
        let depth = |a: f32| (self.norm / (scale * f64::from(a) + shift)).clamp(1e-4, 1e4);
        let depth_or_zero = |d: f64| {
            if d < LEAST_SENSOR_DEPTH {
                0.0
            } else {
                d as f32
            }
        };
        relative.iter().map(|&a| depth_or_zero(depth(a))).collect()
    }
}

/// Scale and shift of one frame, by medians.
fn frame_alignment(metric_m: &[f32], relative: &[f32]) -> (f64, f64) {
    let a: Vec<f64> = relative.iter().map(|&x| f64::from(x)).collect();
    let g: Vec<f64> = metric_m
        .iter()
        .zip(&a)
        .map(|(&m, &a)| {
            let m = f64::from(m);
            if m < SKY_DEPTH_M && a < SKY_DISPARITY {
                SKY_METRIC
            } else {
                1.0 / (m + 1e-8)
            }
        })
        .collect();
    let (ga, gg) = (median(&mut a.clone()), median(&mut g.clone()));
    let mut ratios: Vec<f64> = g
        .iter()
        .zip(&a)
        .map(|(g, a)| (g - gg + 1e-8) / (a - ga + 1e-8))
        .collect();
    let scale = median(&mut ratios);
    let mut rest: Vec<f64> = g.iter().zip(&a).map(|(g, a)| g - scale * a).collect();
    (scale, median(&mut rest))
}

/// The middle value, of an even count the mean of the two.
fn median(values: &mut [f64]) -> f64 {
    percentile(values, 0.5)
}

/// The value below which a share of `values` lies, with linear interpolation.
pub(crate) fn percentile(values: &mut [f64], share: f64) -> f64 {
    let at = share * (values.len() - 1) as f64;
    let (low, part) = (at.floor() as usize, at - at.floor());
    let (_, &mut first, rest) = values.select_nth_unstable_by(low, f64::total_cmp);
    if part == 0.0 || rest.is_empty() {
        return first;
    }
    let next = rest.iter().copied().fold(f64::INFINITY, f64::min);
    first + part * (next - first)
}

#[cfg(test)]
mod tests {
    use super::{DepthPrior, PriorKind, TrackingSize};
    use m4_core::Plane;

    fn size() -> TrackingSize {
        TrackingSize::new((64, 48), 64.0 * 48.0).unwrap()
    }

    #[test]
    fn metres_become_disparities_of_two_where_things_are_near() {
        let depth: Vec<_> = (0..3)
            .map(|_| Plane::from_fn(32, 24, |x, _| if x == 0 { 0.0 } else { 1.0 + x as f32 }))
            .collect();
        let prior = DepthPrior::metric(&depth, &size()).unwrap();
        assert_eq!((prior.kind, prior.frames()), (PriorKind::Metric, 3));
        let plane = prior.disparity(1);
        assert_eq!(plane.size(), (64, 48));
        assert_eq!(plane.row(5)[0], 0.0, "what is unknown stays so");
        // metres times norm are scene units
        let scene = 1.0 / f64::from(plane.row(5)[40]);
        assert!((scene / prior.norm - 21.0).abs() < 1e-4, "{scene}");
        let mut all: Vec<f32> = plane.data().to_vec();
        all.sort_by(f32::total_cmp);
        // the 98th percentile of the known disparities
        assert!((all[all.len() * 97 / 100] - 2.0).abs() < 1e-4);
        let grid = prior.sensor(1);
        assert_eq!(grid.len(), 8 * 6);
        // Cell 3 is pixel 24, the left of the two pixels of column 12: around it are columns 10 to
        // 13.
        let want = (11.0 + 12.0 + 13.0 + 14.0) / 4.0 * prior.norm;
        assert!(
            (1.0 / f64::from(grid[3]) / want - 1.0).abs() < 1e-5,
            "{} {want}",
            1.0 / grid[3]
        );
    }

    #[test]
    fn relative_disparity_takes_scale_and_shift_of_metres() {
        let metric: Vec<_> = (0..2)
            .map(|_| Plane::from_fn(32, 24, |x, y| 1.5 + 0.1 * (x + y) as f32))
            .collect();
        let relative: Vec<_> = metric
            .iter()
            .map(|m| m.map(|z| 5.0 * (1.0 / z - 0.1)))
            .collect();
        let prior = DepthPrior::aligned(&metric, &relative, &size()).unwrap();
        let z = 1.0 / f64::from(prior.disparity(0).row(20)[30]) / prior.norm;
        assert!((z - (1.5 + 0.1 * 25.0)).abs() < 0.01, "{z}");
        assert!(DepthPrior::aligned(&metric[..1], &relative, &size()).is_err());
    }

    #[test]
    fn prior_without_depth_is_an_error() {
        let nothing = [Plane::filled(8, 6, 0.0)];
        assert!(DepthPrior::metric(&nothing, &size()).is_err());
        assert!(DepthPrior::metric(&[], &size()).is_err());
        assert!(DepthPrior::metric(&[Plane::filled(8, 6, f32::NAN)], &size()).is_err());
        assert!(DepthPrior::relative(&[Plane::filled(0, 6, 1.0)], &size()).is_err());
    }
}
