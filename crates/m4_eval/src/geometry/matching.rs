//! Matches the frames of an estimate to those of the ground truth.

use super::report::{GeometryError, no_frames};
use m4_core::CaptureFrame;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Method of matching frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Matching {
    /// By the file name without folder and extension.
    Name,
    /// First with first: the counts agree, the names do not.
    Order,
    /// By the nearest time, as a share of the clip.
    Time,
}

/// Frames further apart than this are not the same frame, in frames of the truth.
const TIME_TOLERANCE_FRAMES: f64 = 0.3;

fn stem(name: &str) -> &str {
    let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
    file.rsplit_once('.').map_or(file, |(stem, _)| stem)
}

/// The training frames of one side.
pub(super) struct Side<'a> {
    pub frames: Vec<&'a CaptureFrame>,
    /// See [`m4_core::Capture::time_frames`].
    pub time_frames: usize,
}

fn by_name(estimate: &Side<'_>, truth: &Side<'_>) -> Option<Vec<(usize, usize)>> {
    let mut index = BTreeMap::new();
    for (i, frame) in truth.frames.iter().enumerate() {
        if index.insert(stem(&frame.name), i).is_some() {
            return None;
        }
    }
    let mut used = vec![false; truth.frames.len()];
    let mut pairs = Vec::with_capacity(estimate.frames.len());
    for (i, frame) in estimate.frames.iter().enumerate() {
        let &j = index.get(stem(&frame.name))?;
        if std::mem::replace(&mut used[j], true) {
            return None;
        }
        pairs.push((i, j));
    }
    Some(pairs)
}

/// Pairs `(index in estimate, index in truth)`, in the order of the estimate.
///
/// # Errors
///
/// [`GeometryError`] if a side has no frames, or some frame of the estimate no partner.
pub(super) fn pair(
    estimate: &Side<'_>,
    truth: &Side<'_>,
) -> Result<(Matching, Vec<(usize, usize)>), GeometryError> {
    for (which, side) in [("estimate", estimate), ("truth", truth)] {
        if side.frames.is_empty() {
            return Err(no_frames(which));
        }
    }
    if let Some(pairs) = by_name(estimate, truth) {
        return Ok((Matching::Name, pairs));
    }
    if estimate.frames.len() == truth.frames.len() {
        return Ok((
            Matching::Order,
            (0..truth.frames.len()).map(|i| (i, i)).collect(),
        ));
    }
    by_time(estimate, truth).map(|pairs| (Matching::Time, pairs))
}

fn by_time(estimate: &Side<'_>, truth: &Side<'_>) -> Result<Vec<(usize, usize)>, GeometryError> {
    let share =
        |frame: &CaptureFrame, side: &Side<'_>| frame.t / (side.time_frames.max(2) - 1) as f64;
    let spacing = 1.0 / (truth.time_frames.max(2) - 1) as f64;
    let (mut pairs, mut worst) = (Vec::new(), (0.0f64, 0usize));
    for (i, frame) in estimate.frames.iter().enumerate() {
        let at = share(frame, estimate);
        let distance = |j: usize| (share(truth.frames[j], truth) - at).abs() / spacing;
        let nearest = (0..truth.frames.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        let Some(j) = nearest else { continue };
        if distance(j) >= worst.0 || distance(j).is_nan() {
            worst = (distance(j), i);
        }
        pairs.push((i, j));
    }
    let twice = pairs.windows(2).any(|w| w[0].1 == w[1].1);
    if worst.0 <= TIME_TOLERANCE_FRAMES && !twice {
        return Ok(pairs);
    }
    Err(GeometryError(format!(
        "the estimate has {} frames and the ground truth {}; names such as {:?} and {:?} do not match, nor do their times (frame \
         {:?} is {:.2} frames from the nearest one of the ground truth): compare captures of the same frames of the same video",
        estimate.frames.len(),
        truth.frames.len(),
        estimate.frames[0].name,
        truth.frames[0].name,
        estimate.frames[worst.1].name,
        worst.0
    )))
}

#[cfg(test)]
mod tests {
    use super::Matching;
    use crate::geometry::GeometryError;
    use crate::geometry::report::{tests::capture, training};
    use m4_core::Capture;

    fn pair(a: &Capture, b: &Capture) -> Result<(Matching, Vec<(usize, usize)>), GeometryError> {
        super::pair(&training(a), &training(b))
    }

    fn named(names: &[&str]) -> Capture {
        let mut c = capture(names.len());
        for (frame, name) in c.frames.iter_mut().zip(names) {
            frame.name = (*name).to_owned();
        }
        c
    }

    #[test]
    fn frames_pair_by_name_then_order_then_time() {
        let check = |estimate: &[&str], truth: &[&str], matching, pairs: &[(usize, usize)]| {
            assert_eq!(
                pair(&named(estimate), &named(truth)).unwrap(),
                (matching, pairs.to_vec())
            );
        };
        check(
            &["b.png", "a.png"],
            &["train/a.jpg", "train/b.jpg", "train/c.jpg"],
            Matching::Name,
            &[(0, 1), (1, 0)],
        );
        check(
            &["1", "2", "3"],
            &["0", "1", "2"],
            Matching::Order,
            &[(0, 0), (1, 1), (2, 2)],
        );
        // three frames that span the same clip as five
        check(
            &["x", "y", "z"],
            &["0", "1", "2", "3", "4"],
            Matching::Time,
            &[(0, 0), (1, 2), (2, 4)],
        );
    }

    #[test]
    fn other_counts_are_an_error_that_names_both() {
        let refused = |a: &[&str], b: &[&str]| pair(&named(a), &named(b)).unwrap_err().to_string();
        let error = refused(&["x", "y", "z", "w"], &["0", "1", "2", "3", "4"]);
        assert!(
            error.starts_with("the estimate has 4 frames and the ground truth 5"),
            "{error}"
        );
        assert!(refused(&[], &["a"]).starts_with("the estimate has no frames"));
    }
}
