//! Splits the depth error of dynamic objects by cause: distance (and its drift and jitter over
//! time), relief, pixels that the mask missed.
//!
//! One mean over all dynamic pixels mixes these, though each has another cure: an object at a wrong
//! distance slides beside its true place in a novel view, a flat one is seen from the wrong side,
//! and a missed pixel has the depth of the background.

use super::depth::{covering, is_set, usable};
use super::report::median_of_sorted;
use m4_core::CaptureFrame;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Length of the window whose median is the slow part of an error of distance, seconds: nine frames
/// at 24 per second.
const DRIFT_WINDOW_S: f64 = 0.375;
/// Share of the image that an object must cover, in pixels that both masks hold, before its
/// distance counts in a frame.
const MIN_SHARE: f64 = 2e-4;
/// Frames per second that are assumed where the truth does not say how long the clip is.
const ASSUMED_FPS: f64 = 24.0;

/// Errors of one object, all relative: 0.01 is 1 % of the distance. Each is
/// `ln(scale * estimate / truth)` with the clip's factor ([`super::DepthError::scale`]) over pixels
/// that both masks hold, `m(t)` its median in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ObjectError {
    /// Number in the instance maps of the truth; 0 if it has none, and all dynamic pixels are one
    /// object.
    pub id: u16,
    /// Frames that show it, in which both masks hold at least a five-thousandth of the image.
    pub frames: usize,
    /// Error of distance: mean of `|m(t)|`. `None` without such frames, as the next four.
    pub distance: Option<f64>,
    /// Constant part: the median of `m(t)`, positive where the estimate is too far.
    pub constant: Option<f64>,
    /// Slow drift: mean of `|s(t) - constant|`, with `s` the median of `m` over 0.375 s.
    pub drift: Option<f64>,
    /// Jitter: mean of `|m(t) - s(t)|`.
    pub jitter: Option<f64>,
    /// Error of relief: mean over pixels of the distance of each to `m(t)`.
    pub relief: Option<f64>,
    /// Share of the object's pixels that the estimated masks miss.
    pub missed: f64,
}

/// The rows for people, all in per cent.
pub(super) fn table(objects: &[ObjectError]) -> String {
    let titles = [
        "object", "frames", "distance", "constant", "drift", "jitter", "relief", "missed",
    ];
    let row = |cells: [String; 8]| {
        cells
            .iter()
            .map(|cell| format!("{cell:>9}"))
            .collect::<String>()
            + "\n"
    };
    let percent = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{:.1} %", 100.0 * v));
    let mut out = row(titles.map(str::to_owned));
    for o in objects {
        let name = if o.id == 0 {
            "all".to_owned()
        } else {
            o.id.to_string()
        };
        let [distance, constant, drift, jitter, relief] =
            [o.distance, o.constant, o.drift, o.jitter, o.relief].map(percent);
        out += &row([
            name,
            o.frames.to_string(),
            distance,
            constant,
            drift,
            jitter,
            relief,
            percent(Some(o.missed)),
        ]);
    }
    out
}

/// Sums over the frames of one object.
#[derive(Default)]
struct Sums {
    /// Time in seconds and median error of each frame.
    medians: Vec<(f64, f64)>,
    relief: f64,
    relief_pixels: usize,
    missed: usize,
    pixels: usize,
}

/// Errors per object, by number. Empty if no pair of frames has masks and depth on both sides.
/// `scale` takes estimated to true depth, `seconds_per_frame` the unit of the truth's time to
/// seconds, if known.
pub(super) fn object_errors(
    pairs: &[(&CaptureFrame, &CaptureFrame)],
    scale: f64,
    seconds_per_frame: Option<f64>,
) -> Vec<ObjectError> {
    let unit = seconds_per_frame.unwrap_or(1.0 / ASSUMED_FPS);
    let mut objects: BTreeMap<u16, Sums> = BTreeMap::new();
    for (estimate, truth) in pairs {
        for (id, frame) in frame_errors(estimate, truth, scale) {
            let sums = objects.entry(id).or_default();
            sums.missed += frame.missed;
            sums.pixels += frame.pixels;
            let mut errors = frame.errors;
            if errors.is_empty() || (errors.len() as f64) < MIN_SHARE * frame.of as f64 {
                continue;
            }
            errors.sort_by(f64::total_cmp);
            let median = median_of_sorted(&errors);
            sums.medians.push((truth.t * unit, median));
            sums.relief += errors.iter().map(|e| (e - median).abs()).sum::<f64>();
            sums.relief_pixels += errors.len();
        }
    }
    objects
        .into_iter()
        .map(|(id, sums)| sums.result(id))
        .collect()
}

impl Sums {
    fn result(mut self, id: u16) -> ObjectError {
        let missed = self.missed as f64 / self.pixels.max(1) as f64;
        let frames = self.medians.len();
        if frames == 0 {
            let none = None;
            return ObjectError {
                id,
                frames,
                distance: none,
                constant: none,
                drift: none,
                jitter: none,
                relief: none,
                missed,
            };
        }
        self.medians.sort_by(|a, b| a.0.total_cmp(&b.0));
        let median_where = |inside: &dyn Fn(f64) -> bool| {
            let mut values: Vec<f64> = self
                .medians
                .iter()
                .filter(|m| inside(m.0))
                .map(|m| m.1)
                .collect();
            values.sort_by(f64::total_cmp);
            median_of_sorted(&values)
        };
        let constant = median_where(&|_| true);
        let slow: Vec<f64> = self
            .medians
            .iter()
            // half a thousandth more, so that rounding of times takes no frame away
            .map(|&(at, _)| median_where(&|t| (t - at).abs() <= 0.5005 * DRIFT_WINDOW_S))
            .collect();
        let mean = |sum: f64| Some(sum / frames as f64);
        let of_slow = self.medians.iter().zip(&slow);
        ObjectError {
            id,
            frames,
            distance: mean(self.medians.iter().map(|m| m.1.abs()).sum()),
            constant: Some(constant),
            drift: mean(slow.iter().map(|s| (s - constant).abs()).sum()),
            jitter: mean(of_slow.map(|(m, s)| (m.1 - s).abs()).sum()),
            relief: Some(self.relief / self.relief_pixels as f64),
            missed,
        }
    }
}

/// What one frame says of one object.
#[derive(Default)]
struct InFrame {
    /// `ln(scale * estimate / truth)` where both masks and both depths are set.
    errors: Vec<f64>,
    missed: usize,
    pixels: usize,
    /// Pixels of the image.
    of: usize,
}

/// The objects that the masks of the truth show.
fn frame_errors(
    estimate: &CaptureFrame,
    truth: &CaptureFrame,
    scale: f64,
) -> BTreeMap<u16, InFrame> {
    let mut objects: BTreeMap<u16, InFrame> = BTreeMap::new();
    let (Some(own_mask), Some(true_mask)) = (&estimate.mask, &truth.mask) else {
        return objects;
    };
    let (Some(own), Some(depth)) = (&estimate.depth, &truth.depth) else {
        return objects;
    };
    let size = true_mask.size();
    for (x, y) in true_mask.set_pixels() {
        let in_size = |to| covering((x, y), size, to);
        let id = match &truth.instances {
            None => 0,
            Some(ids) => in_size(ids.size()).map_or(0, |(x, y)| ids.at(x, y)),
        };
        let object = objects.entry(id).or_default();
        object.of = size.0 * size.1;
        object.pixels += 1;
        if !is_set(own_mask, (x, y), size) {
            object.missed += 1;
            continue;
        }
        let at = |(x, y), map: &m4_core::CompactDepth| map.at(x, y);
        let own = in_size(own.size())
            .map(|p| at(p, own))
            .filter(|&z| usable(z));
        let depth = in_size(depth.size())
            .map(|p| at(p, depth))
            .filter(|&z| usable(z));
        if let (Some(own), Some(depth)) = (own, depth) {
            object
                .errors
                .push((scale * f64::from(own) / f64::from(depth)).ln());
        }
    }
    objects
}

#[cfg(test)]
mod tests {
    use super::super::report::tests::capture;
    use super::object_errors;
    use m4_core::{Capture, CompactDepth, CompactIds, CompactMask, Plane};

    /// Objects 1 (columns 0 to 3) and 2 (4 to 7) of `report::tests::capture`, both at a depth of 4.
    fn truth(n: usize) -> Capture {
        let mut truth = capture(n);
        for frame in &mut truth.frames {
            let ids = Plane::from_fn(16, 12, |x, _| if x < 8 { 1 + x as u16 / 4 } else { 0 });
            frame.instances = Some(CompactIds::from(&ids));
        }
        truth
    }

    fn errors(estimate: &Capture, truth: &Capture) -> Vec<super::ObjectError> {
        let pairs: Vec<_> = estimate.frames.iter().zip(&truth.frames).collect();
        object_errors(&pairs, 1.0, Some(1.0 / 24.0))
    }

    /// The estimate whose depth is multiplied by `factor(frame, x)`.
    fn spoiled(n: usize, factor: impl Fn(usize, usize) -> f32) -> Capture {
        let mut estimate = capture(n);
        for (i, frame) in estimate.frames.iter_mut().enumerate() {
            let map = Plane::from_fn(16, 12, |x, _| if x < 8 { 4.0 * factor(i, x) } else { 2.0 });
            frame.depth = Some(CompactDepth::from(map));
        }
        estimate
    }

    fn near(actual: Option<f64>, expected: f64) {
        let actual = actual.unwrap();
        assert!(
            (actual - expected).abs() < 2e-3,
            "{actual} instead of {expected}"
        );
    }

    #[test]
    fn each_cause_is_seen_in_its_own_figure() {
        let n = 48;
        // object 1 is 5 % too far; object 2 drifts from -4 % to 4 % over the clip and is 1 % too
        // deep on one half, too near on the other
        let drift = |i: usize| 0.08 * (i as f32 / (n - 1) as f32 - 0.5);
        let estimate = spoiled(n, |i, x| match x {
            0..4 => 1.05,
            4 | 5 => (drift(i) + 0.01).exp(),
            _ => (drift(i) - 0.01).exp(),
        });
        let actual = errors(&estimate, &truth(n));
        assert_eq!(
            actual
                .iter()
                .map(|o| (o.id, o.frames, o.missed))
                .collect::<Vec<_>>(),
            [(1, n, 0.0), (2, n, 0.0)]
        );
        let far = 1.05f64.ln();
        for (object, [distance, constant, drift, relief]) in actual
            .iter()
            .zip([[far, far, 0.0, 0.0], [0.02, 0.0, 0.02, 0.01]])
        {
            near(object.distance, distance);
            near(object.constant, constant);
            near(object.drift, drift);
            near(object.jitter, 0.0);
            near(object.relief, relief);
        }
    }

    #[test]
    fn jitter_is_what_changes_from_frame_to_frame() {
        let estimate = spoiled(48, |i, _| if i % 4 == 0 { 1.02 } else { 1.0 });
        let [object, _] = errors(&estimate, &truth(48))[..] else {
            panic!("two objects")
        };
        near(object.distance, 0.005);
        near(object.drift, 0.0);
        near(object.jitter, 0.005);
        assert!(object.jitter.unwrap() > 0.004, "{object:?}");
    }

    #[test]
    fn missed_pixels_count_as_missed_alone() {
        let mut estimate = spoiled(4, |_, x| if x < 2 { 3.0 } else { 1.0 });
        for frame in &mut estimate.frames {
            frame.mask = Some(CompactMask::from_fn(16, 12, |x, _| (2..4).contains(&x)));
        }
        let actual = errors(&estimate, &truth(4));
        assert_eq!(actual[0].missed, 0.5);
        near(actual[0].distance, 0.0);
        assert_eq!(
            (actual[1].missed, actual[1].distance, actual[1].frames),
            (1.0, None, 0)
        );
    }
}
