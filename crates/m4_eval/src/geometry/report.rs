//! The comparison of two captures.

use super::matching::{Matching, Side, pair};
use super::objects::{self, ObjectError, object_errors};
use super::{
    AbsoluteError, PathAlignment, RelativeError, RotationError, TrajectoryError, absolute_error,
    depth, relative_error, trajectory,
};
use m4_core::{Camera, Capture, CaptureFrame};
use serde::{Deserialize, Serialize};

/// Depth after one factor for the whole clip, over every second column and row of the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DepthError {
    /// Frames with depth on both sides.
    pub frames: usize,
    /// The factor: median of truth / estimate over static pixels (over dynamic ones if there are no
    /// other).
    pub scale: f64,
    /// Mean of `|scale * estimate - truth| / truth` over static pixels that the estimate covers.
    pub static_abs_rel: Option<f64>,
    /// The same over those of them that the masks of the estimate leave static: without the errors
    /// of masks, inside of which depth is that of dynamic objects.
    #[serde(default)]
    pub static_outside_masks_abs_rel: Option<f64>,
    /// Share of those pixels within a factor of 1.25.
    pub static_within_25_percent: Option<f64>,
    /// Share of the static pixels of the truth that the estimate covers.
    pub static_coverage: Option<f64>,
    /// As `static_abs_rel`, over dynamic pixels, with the same factor.
    pub moving_abs_rel: Option<f64>,
    /// As `static_within_25_percent`, over dynamic pixels.
    pub moving_within_25_percent: Option<f64>,
    /// As `static_coverage`, over dynamic pixels.
    pub moving_coverage: Option<f64>,
}

/// Agreement of motion masks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MaskScore {
    /// Frames with a mask on both sides.
    pub frames: usize,
    /// Intersection over union, both summed over all frames; 1 if both are empty everywhere.
    pub iou: f64,
    /// Mean of the frames' own intersection over union (1 where both are empty).
    pub mean_frame_iou: f64,
    /// Share of the estimated dynamic pixels that move.
    pub precision: f64,
    /// Share of the dynamic pixels that were found.
    pub recall: f64,
}

/// Errors of an estimate against ground truth. Parts that cannot be compared are `None` and
/// explained in `notes`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GeometryReport {
    /// Pairs of frames compared.
    pub frames: usize,
    /// Method of matching.
    pub matching: Matching,
    /// True if lengths are in metres (those of the truth).
    pub metric: bool,
    /// Camera centres after the best similarity.
    pub trajectory: Option<TrajectoryError>,
    /// Camera axes after the best rotation.
    pub rotation: Option<RotationError>,
    /// Poses after Umeyama's similarity, as evo has them; `None` as `trajectory`.
    #[serde(default)]
    pub absolute: Option<AbsoluteError>,
    /// Motions from each frame to the next, as evo has them; `None` as `trajectory`.
    #[serde(default)]
    pub relative: Option<RelativeError>,
    /// Mean over frames of the relative error of the horizontal focal length at equal image width,
    /// per cent, positive where the estimate is too long.
    pub focal_error_percent: f64,
    /// Depth, where both sides have it.
    pub depth: Option<DepthError>,
    /// Motion masks, where both sides have them.
    pub mask: Option<MaskScore>,
    /// Depth of each dynamic object, where both sides have depth and masks: the instances of the
    /// truth, or all of them as one.
    #[serde(default)]
    pub objects: Vec<ObjectError>,
    /// Parts that could not be compared and why, one sentence each.
    pub notes: Vec<String>,
}

impl GeometryReport {
    /// The report as a table for people.
    #[must_use]
    pub fn table(&self) -> String {
        let mut out = String::new();
        let mut line = |name: &str, text: String| out += &format!("{name:<12} {text}\n");
        let by = match self.matching {
            Matching::Name => "file name",
            Matching::Order => "order",
            Matching::Time => "time",
        };
        line("frames", format!("{}, paired by {by}", self.frames));
        if let Some(path) = &self.trajectory {
            line(
                "trajectory",
                format!(
                    "{:.2} % of the path (root mean square, after alignment)",
                    path.rmse_percent
                ),
            );
        }
        if let Some(rotation) = &self.rotation {
            line(
                "rotation",
                format!("{:.2} degrees (mean)", rotation.mean_deg),
            );
        }
        line(
            "focal length",
            format!("{:+.2} %", self.focal_error_percent),
        );
        if let Some(depth) = &self.depth {
            let cell = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.4}"));
            let [fixed, outside, dynamic] = [
                depth.static_abs_rel,
                depth.static_outside_masks_abs_rel,
                depth.moving_abs_rel,
            ]
            .map(cell);
            line(
                "depth",
                format!(
                    "AbsRel {fixed} static ({outside} outside the masks), {dynamic} dynamic (all pixels of the true masks)"
                ),
            );
        }
        if let Some(mask) = &self.mask {
            line(
                "masks",
                format!(
                    "IoU {:.3}, precision {:.3}, recall {:.3}",
                    mask.iou, mask.precision, mask.recall
                ),
            );
        }
        if !self.objects.is_empty() {
            out += &objects::table(&self.objects);
        }
        for note in &self.notes {
            out += &format!("note: {note}\n");
        }
        out
    }
}

/// Compares the training frames of an estimate (those without a held-out camera) with the truth.
///
/// Frames are paired by file stem, else by order where counts agree, else by time.
///
/// # Errors
///
/// [`GeometryError`] if a side is empty, frames cannot be paired, or a camera is not finite.
pub fn evaluate(estimate: &Capture, truth: &Capture) -> Result<GeometryReport, GeometryError> {
    let metric = truth.metric;
    let seconds_per_frame = truth
        .duration_s
        .map(|s| s / (truth.time_frames.max(2) - 1) as f64);
    let (estimate, truth) = (training(estimate), training(truth));
    check_finite("estimate", &estimate)?;
    check_finite("truth", &truth)?;
    let (matching, index) = pair(&estimate, &truth)?;
    let pairs: Vec<(&CaptureFrame, &CaptureFrame)> = index
        .iter()
        .map(|&(e, t)| (estimate.frames[e], truth.frames[t]))
        .collect();
    let cameras: (Vec<Camera>, Vec<Camera>) =
        pairs.iter().map(|(e, t)| (e.camera, t.camera)).unzip();
    let poses = |cameras: &[Camera]| cameras.iter().map(|c| c.c2w).collect::<Vec<_>>();
    let (estimated, true_poses) = (poses(&cameras.0), poses(&cameras.1));
    let relative_focal = |c: &Camera| c.intrinsics.fx / c.intrinsics.width as f64;
    let focal_error = |(e, t): (&Camera, &Camera)| relative_focal(e) / relative_focal(t) - 1.0;
    let focal_sum: f64 = cameras.0.iter().zip(&cameras.1).map(focal_error).sum();
    let depth = depth::depth_error(&pairs);
    let objects = depth.map_or_else(Vec::new, |depth| {
        object_errors(&pairs, depth.scale, seconds_per_frame)
    });
    let report = GeometryReport {
        frames: pairs.len(),
        matching,
        metric,
        trajectory: trajectory::trajectory_error(&cameras.0, &cameras.1),
        rotation: trajectory::rotation_error(&cameras.0, &cameras.1),
        // they fail where the trajectory's does, which a note says
        absolute: absolute_error(&estimated, &true_poses, PathAlignment::Sim3).ok(),
        relative: relative_error(&estimated, &true_poses, PathAlignment::Sim3, 1).ok(),
        focal_error_percent: 100.0 * focal_sum / pairs.len() as f64,
        depth,
        mask: depth::mask_score(&pairs),
        objects,
        notes: Vec::new(),
    };
    Ok(with_notes(report, &estimate, &truth))
}

fn with_notes(mut report: GeometryReport, estimate: &Side<'_>, truth: &Side<'_>) -> GeometryReport {
    let mut note = |missing: bool, text: &str| {
        if missing {
            report.notes.push(text.to_owned());
        }
    };
    let no_path = report.trajectory.is_none();
    note(
        no_path,
        "trajectory: one of the paths has no extent, so there is nothing to align",
    );
    let no_depth = report.depth.is_none();
    note(no_depth, "depth: no pair of frames has depth on both sides");
    note(
        report.mask.is_none(),
        "masks: no pair of frames has a mask on both sides",
    );
    let unknown = report.depth.is_some() && truth.frames.iter().all(|f| f.mask.is_none());
    note(
        unknown,
        "depth: the ground truth has no masks, so every pixel counts as static",
    );
    // a part of a clip is numbered again: its 00001 need not be the whole clip's
    let (part, whole) = (estimate.frames.len(), truth.frames.len());
    if report.matching == Matching::Name && part != whole {
        report.notes.push(format!(
            "frames: {part} of the estimate were paired with {whole} of the ground truth by file name; if the estimate was \
             made from a part of the clip, its names are numbered anew and the figures \
             mean nothing"
        ));
    }
    report
}

pub(super) fn training(capture: &Capture) -> Side<'_> {
    Side {
        frames: capture
            .frames
            .iter()
            .filter(|f| f.camera_index.is_none())
            .collect(),
        time_frames: capture.time_frames,
    }
}

fn check_finite(which: &'static str, side: &Side<'_>) -> Result<(), GeometryError> {
    for frame in &side.frames {
        let k = &frame.camera.intrinsics;
        let pose = &frame.camera.c2w;
        let finite_pose = pose
            .rotation
            .iter()
            .chain(pose.translation.iter())
            .all(|v| v.is_finite());
        let what = if !finite_pose {
            "the pose"
        } else if !(k.fx.is_finite() && k.fx > 0.0 && k.width > 0) {
            "the focal length over the image width"
        } else {
            continue;
        };
        return Err(not_finite(what, &frame.name, which));
    }
    Ok(())
}

/// The middle value, or the mean of the two middle ones; NaN for none.
pub(super) fn median_of_sorted(values: &[f64]) -> f64 {
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

/// Why an estimate could not be compared with the truth: a side without frames, frames that cannot
/// be paired, poses or focal lengths that are no numbers, or paths that cannot be aligned; the text
/// says which.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct GeometryError(pub(super) String);

pub(super) fn no_frames(which: &str) -> GeometryError {
    GeometryError(format!(
        "the {which} has no frames; nothing can be compared"
    ))
}

pub(super) fn not_finite(what: &str, name: &str, which: &str) -> GeometryError {
    GeometryError(format!(
        "{what} of frame {name:?} of the {which} is not a finite number; the file is damaged or the run diverged"
    ))
}

#[cfg(test)]
pub(super) mod tests {
    use super::{GeometryReport, Matching, evaluate};
    use m4_core::{
        Camera, Capture, CaptureFrame, CompactMask, Intrinsics, Plane, Se3, nalgebra::Vector6,
    };

    /// `n` frames on a curve, depth 2 everywhere but 4 in the moving left half; 16x12.
    pub(crate) fn capture(n: usize) -> Capture {
        let frame = |i: usize| {
            let a = i as f64 * 0.3;
            CaptureFrame {
                name: format!("train/{i:05}.jpg"),
                camera: Camera {
                    intrinsics: Intrinsics::centred(16, 12, 15.0),
                    c2w: Se3::identity().retract(&Vector6::new(
                        a,
                        a * a,
                        a.sin(),
                        0.1 * a,
                        0.0,
                        0.2 * a,
                    )),
                },
                t: i as f64,
                rgb: Plane::filled(16, 12, [0; 3]),
                depth: Some(Plane::from_fn(16, 12, |x, _| if x < 8 { 4.0 } else { 2.0 }).into()),
                mask: Some(CompactMask::from_fn(16, 12, |x, _| x < 8)),
                motion: None,
                instances: None,
                camera_index: None,
                distance_sigma: None,
            }
        };
        Capture {
            frames: (0..n).map(frame).collect(),
            time_frames: n,
            duration_s: None,
            metric: true,
            tracks: None,
        }
    }

    #[test]
    fn ground_truth_scores_perfectly() {
        let report = evaluate(&capture(5), &capture(5)).unwrap();
        assert_eq!((report.frames, report.matching), (5, Matching::Name));
        assert!(report.trajectory.unwrap().rmse < 1e-9 && report.focal_error_percent.abs() < 1e-12);
        assert!(
            report.absolute.unwrap().translation.max < 1e-9 && report.relative.unwrap().pairs == 4
        );
        let depth = report.depth.unwrap();
        assert_eq!(
            (depth.static_abs_rel, depth.moving_abs_rel),
            (Some(0.0), Some(0.0))
        );
        assert_eq!(report.mask.unwrap().iou, 1.0);
        assert!(report.notes.is_empty());
    }

    #[test]
    fn depth_is_compared_after_the_factor_of_static_pixels() {
        let mut estimate = capture(3);
        for frame in &mut estimate.frames {
            // A quarter of the size; static depth halved, moving depth 1 instead of 4, one column
            // unknown.
            frame.depth = Some(Plane::from_fn(8, 6, |x, _| if x == 7 { 0.0 } else { 1.0 }).into());
        }
        let depth = evaluate(&estimate, &capture(3)).unwrap().depth.unwrap();
        assert!((depth.scale - 2.0).abs() < 1e-12);
        assert_eq!(depth.static_abs_rel, Some(0.0));
        assert!((depth.moving_abs_rel.unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(depth.moving_within_25_percent, Some(0.0));
        assert!((depth.static_coverage.unwrap() - 0.75).abs() < 1e-12);
    }

    #[test]
    fn static_pixels_in_masks_count_apart() {
        let mut estimate = capture(2);
        for frame in &mut estimate.frames {
            // a quarter of the static half is in the mask, and as far as the dynamic half
            frame.mask = Some(CompactMask::from_fn(16, 12, |x, _| x < 10));
            frame.depth =
                Some(Plane::from_fn(16, 12, |x, _| if x < 10 { 4.0 } else { 2.0 }).into());
        }
        let depth = evaluate(&estimate, &capture(2)).unwrap().depth.unwrap();
        assert_eq!(depth.static_outside_masks_abs_rel, Some(0.0));
        assert!((depth.static_abs_rel.unwrap() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn masks_are_compared_by_overlap() {
        let mut estimate = capture(2);
        for frame in &mut estimate.frames {
            frame.mask = Some(CompactMask::from_fn(16, 12, |x, _| (4..12).contains(&x)));
        }
        let mask = evaluate(&estimate, &capture(2)).unwrap().mask.unwrap();
        assert!(
            (mask.iou - 4.0 / 12.0).abs() < 1e-12 && (mask.mean_frame_iou - mask.iou).abs() < 1e-12
        );
        assert_eq!((mask.precision, mask.recall), (0.5, 0.5));
    }

    #[test]
    fn focal_length_is_relative_to_the_width() {
        let mut estimate = capture(2);
        for frame in &mut estimate.frames {
            frame.camera.intrinsics = Intrinsics::centred(32, 24, 33.0);
        }
        let report = evaluate(&estimate, &capture(2)).unwrap();
        assert!((report.focal_error_percent - 10.0).abs() < 1e-9);
    }

    #[test]
    fn missing_depth_masks_and_focal_are_reported() {
        let mut truth = capture(3);
        for frame in &mut truth.frames {
            (frame.depth, frame.mask) = (None, None);
        }
        let report = evaluate(&capture(3), &truth).unwrap();
        assert!(
            report.depth.is_none() && report.mask.is_none() && report.notes.len() == 2,
            "{report:?}"
        );
        let text = serde_json::to_string(&report).unwrap();
        let back = serde_json::from_str::<GeometryReport>(&text).unwrap();
        assert_eq!(
            (back.depth, back.mask, back.notes),
            (report.depth, report.mask, report.notes)
        );
        assert!((back.trajectory.unwrap().scale - 1.0).abs() < 1e-9);
    }

    #[test]
    fn partial_match_by_name_warns() {
        let doubted = |estimate, truth| {
            let report = evaluate(&capture(estimate), &capture(truth)).unwrap();
            report
                .notes
                .iter()
                .any(|note| note.contains("numbered anew"))
        };
        assert!(doubted(3, 5) && !doubted(5, 5));
    }

    #[test]
    fn held_out_views_are_left_out_and_damage_is_named() {
        let mut truth = capture(4);
        truth.frames[3].camera_index = Some(0);
        assert_eq!(evaluate(&capture(3), &truth).unwrap().frames, 3);
        truth.frames[1].camera.c2w.translation.x = f64::NAN;
        let error = evaluate(&capture(3), &truth).unwrap_err().to_string();
        assert!(
            error.contains("the pose of frame") && error.contains("of the truth"),
            "{error}"
        );
    }
}
