//! What the geometry stage measured, for its record and the log.

use super::{Confidence, Footage};
use crate::networks::UsedNetwork;
use crate::settings::{FrontendPart, GeometryOptions, Segmenter};
use m4_core::advice::{DEPTH_WEIGHTS, MASK_WEIGHTS};
use m4_core::median;
use m4_geometry::classical::dense::{DistanceCue, DynamicObject};
use m4_geometry::classical::sparse::RadialDistortion;
use serde::{Deserialize, Serialize};

/// The results of the geometry stage.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GeometrySummary {
    /// Frames of the capture.
    pub frames: usize,
    /// Their size, pixels.
    pub size: [usize; 2],
    /// Horizontal focal length, pixels.
    pub focal_px: f64,
    /// The same as a field of view, degrees.
    pub fov_deg: f64,
    /// Distortion that the clip showed and that was taken out of its frames; `focal_px` above is
    /// that of the straight frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distortion: Option<RadialDistortion>,
    /// `parallax`, `rotation_only` or `static`.
    pub camera_motion: String,
    /// Median reprojection error of static regions, pixels.
    pub residual_px: f64,
    /// Number of feature tracks.
    pub tracks: usize,
    /// Number of triangulated tracks.
    pub points: usize,
    /// Share of all pixels that are dynamic.
    pub moving_share: f64,
    /// Number of point tracks in dynamic regions, in `tracks.npz`.
    #[serde(default)]
    pub moving_tracks: usize,
    /// Dynamic objects, what gives their distance, and how sure it is; none where depth was given
    /// or predicted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<DynamicObject>,
    /// The front end: `classical`, `raft`, `megasam+raft+moge`, ...
    #[serde(default)]
    pub frontend: String,
    /// The networks of the front end, with the licences of their weights.
    #[serde(default)]
    pub networks: Vec<UsedNetwork>,
    /// Number of keyframes of the tracking network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keyframes: Option<Vec<usize>>,
    /// Units of MegaSaM's own files (disparities whose 98th percentile is 2) a metre, where depth
    /// is metric.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub megasam_units_a_metre: Option<f64>,
    /// The segmentation method: `none`, `mobilesam`.
    #[serde(default)]
    pub segmenter: String,
    /// The geometry that the user provided: `intrinsics`, `poses`, `masks`, `depth`.
    #[serde(default)]
    pub given: Vec<String>,
    /// Cuts, repeated frames, bars and the like, and what was done about them; `None` for one
    /// continuous take.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub footage: Option<Footage>,
    /// How often depth and masks were computed: twice if the masks changed the cameras.
    #[serde(default = "once")]
    pub rounds: usize,
    /// The confidence.
    #[serde(default)]
    pub confidence: Option<Confidence>,
}

/// Share of pixels with measured depth below which a network's would help.
const LITTLE_DEPTH: f64 = 0.35;
/// Share of the dynamic pixels whose distance is assumed above which it would help, too.
const MUCH_ASSUMED: f64 = 0.3;

impl GeometrySummary {
    /// Returns the advice to get the weights that would help this clip most, of those that `asked`
    /// would have used: depth, where little of it was measured, else masks of dynamic objects.
    /// `None` where neither is lacking, and in builds without networks.
    pub fn helpful_weights(&self, asked: &GeometryOptions) -> Option<&'static str> {
        if !cfg!(feature = "nets") {
            return None;
        }
        let little = |confidence: &Confidence| confidence.measured_share < LITTLE_DEPTH;
        let lacks_depth = asked.frontend.is_auto()
            && self.frontend == FrontendPart::Classical.name()
            && !self.given.iter().any(|given| given == "depth")
            && (self.camera_motion != "parallax"
                || self.confidence.as_ref().is_some_and(little)
                || self.assumed_share() > MUCH_ASSUMED);
        let lacks_masks = asked.segmenter == Segmenter::Auto
            && self.segmenter == Segmenter::None.name()
            && self.keyframes.is_none()
            && self.moving_share > 0.0
            && !self.given.iter().any(|given| given == "masks");
        match (lacks_depth, lacks_masks) {
            (true, _) => Some(DEPTH_WEIGHTS),
            (false, true) => Some(MASK_WEIGHTS),
            (false, false) => None,
        }
    }

    /// Returns how far the distances of dynamic objects can be trusted, in one line; `None` where
    /// there are none.
    pub fn objects_description(&self) -> Option<String> {
        let mut parts = Vec::new();
        for (cue, by) in [
            (DistanceCue::Contact, "by the ground under them"),
            (DistanceCue::FixedPoint, "by a point that stays in place"),
            (DistanceCue::Ballistic, "by their fall"),
            (DistanceCue::Assumed, "assumed"),
        ] {
            let mut sigmas: Vec<f64> = self
                .objects
                .iter()
                .filter(|object| object.cue == cue)
                .map(|object| object.sigma_percent)
                .collect();
            let count = sigmas.len();
            if let Some(sigma) = median(&mut sigmas) {
                parts.push(format!("{count} {by} (to {sigma:.0} %)"));
            }
        }
        (!parts.is_empty()).then(|| format!("distance of dynamic objects: {}", parts.join(", ")))
    }

    /// The share of the dynamic pixels of objects whose distance is assumed, 0..1.
    fn assumed_share(&self) -> f64 {
        let pixels = |object: &DynamicObject| object.share * object.frames as f64;
        let assumed = self
            .objects
            .iter()
            .filter(|object| object.cue == DistanceCue::Assumed);
        let all = self.objects.iter().map(pixels).sum::<f64>();
        assumed.map(pixels).sum::<f64>() / all.max(f64::MIN_POSITIVE)
    }
}

/// Defaults for records of earlier releases.
fn once() -> usize {
    1
}

#[cfg(all(test, feature = "nets"))]
mod tests {
    use super::{
        Confidence, DEPTH_WEIGHTS, DistanceCue, DynamicObject, GeometryOptions, GeometrySummary,
        MASK_WEIGHTS,
    };
    use crate::geometry::{Focal, Grade};

    #[test]
    fn what_lacks_most_is_advised() {
        let confidence = Confidence {
            grade: Grade::Good,
            advice: None,
            parallax_deg: 5.0,
            parallax_px: 50.0,
            inlier_share: 0.9,
            static_share: 0.9,
            focal: Focal::Given,
            focal_sigma_percent: None,
            residual_px: 0.2,
            measured_share: 0.8,
        };
        let summary = GeometrySummary {
            camera_motion: "parallax".to_owned(),
            frontend: "classical".to_owned(),
            segmenter: "none".to_owned(),
            moving_share: 0.1,
            confidence: Some(confidence.clone()),
            ..GeometrySummary::default()
        };
        let asked = GeometryOptions::default();
        assert_eq!(summary.helpful_weights(&asked), Some(MASK_WEIGHTS));
        let change = |change: &dyn Fn(&mut GeometrySummary)| {
            let mut summary = summary.clone();
            change(&mut summary);
            summary.helpful_weights(&asked)
        };
        assert_eq!(change(&|s| s.moving_share = 0.0), None);
        assert_eq!(change(&|s| s.segmenter = "mobilesam".to_owned()), None);
        assert_eq!(change(&|s| s.given = vec!["masks".to_owned()]), None);
        let tripod = |s: &mut GeometrySummary| s.camera_motion = "static".to_owned();
        assert_eq!(change(&tripod), Some(DEPTH_WEIGHTS));
        let blind = |s: &mut GeometrySummary| {
            s.confidence.as_mut().unwrap().measured_share = 0.1;
        };
        assert_eq!(change(&blind), Some(DEPTH_WEIGHTS));
        let object = |cue: DistanceCue, frames: usize, sigma_percent: f64| DynamicObject {
            first_frame: 0,
            frames,
            share: 0.1,
            cue,
            sigma_percent,
        };
        let objects = vec![
            object(DistanceCue::Contact, 40, 6.0),
            object(DistanceCue::Assumed, 20, 50.0),
        ];
        let hovers = |s: &mut GeometrySummary| s.objects.clone_from(&objects);
        assert_eq!(change(&hovers), Some(DEPTH_WEIGHTS));
        let described = GeometrySummary {
            objects: objects.clone(),
            ..summary.clone()
        };
        assert_eq!(
            described.objects_description().as_deref(),
            Some(
                "distance of dynamic objects: 1 by the ground under them (to 6 %), 1 assumed (to 50 %)"
            )
        );
        assert_eq!(
            change(&|s| s.objects = objects[..1].to_vec()),
            Some(MASK_WEIGHTS)
        );
        let predicted = |s: &mut GeometrySummary| {
            tripod(s);
            s.frontend = "classical+moge".to_owned();
        };
        assert_eq!(change(&predicted), Some(MASK_WEIGHTS));
        // what the user did not want is not advised
        let by_hand = GeometryOptions {
            frontend: "classical".parse().unwrap(),
            segmenter: crate::settings::Segmenter::None,
            ..GeometryOptions::default()
        };
        assert_eq!(summary.helpful_weights(&by_hand), None);
    }
}
