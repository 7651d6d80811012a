//! The confidence of the geometry: numbers, a grade and one piece of advice.

use super::dense::DenseFrame;
use super::sparse::FocalSource;
use super::{CameraMotion, Motion, SparseReconstruction};
use m4_core::advice::{DEPTH, FIELD_OF_VIEW, INTRINSICS, MASKS};
use m4_core::median;
use serde::{Deserialize, Serialize};

/// How good geometry is likely to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// Expect depth of static regions within a few per cent.
    Good,
    /// Usable; one of the numbers is weak.
    Fair,
    /// Views from aside will be wrong.
    Poor,
}

impl Grade {
    /// Returns the grade as a word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Fair => "fair",
            Self::Poor => "poor",
        }
    }
}

/// Where the focal length comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Focal {
    /// Known from the user or the file.
    Given,
    /// Estimated from the clip.
    Estimated,
    /// A typical value.
    Assumed,
}

/// How far geometry can be trusted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Confidence {
    /// The overall grade.
    pub grade: Grade,
    /// What to do about it, where it is not good.
    pub advice: Option<String>,
    /// The angle under which the camera's path is seen from the points that it measured, median,
    /// degrees.
    pub parallax_deg: f64,
    /// The same as pixels of the frames.
    pub parallax_px: f64,
    /// Share of the tracks that are static with an error of less than a pixel.
    pub inlier_share: f64,
    /// Share of all pixels that are static.
    pub static_share: f64,
    /// Where the focal length comes from.
    pub focal: Focal,
    /// Standard deviation of an estimated focal length, per cent.
    pub focal_sigma_percent: Option<f64>,
    /// Median reprojection error of static regions, pixels.
    pub residual_px: f64,
    /// Share of the pixels whose depth was measured (or given) and not filled in.
    pub measured_share: f64,
}

/// Largest reprojection error of an inlier, pixels.
const INLIER_PX: f64 = 1.0;
/// Confidence of a pixel from which on its depth counts as measured.
const MEASURED: f32 = 0.5;
/// Views of a point that are compared.
const VIEWS: usize = 8;

/// What is known besides the numbers.
#[derive(Debug, Clone, Copy)]
pub struct Circumstances {
    /// How much the camera's motion reveals.
    pub camera_motion: CameraMotion,
    /// Masks were given.
    pub masks_given: bool,
    /// Two rigid worlds explain the clip about equally well.
    pub tied: bool,
    /// Depth was given.
    pub depth_given: bool,
    /// Depth was predicted by a network, from each frame alone.
    pub depth_predicted: bool,
}

impl Confidence {
    /// Grades a result; `known_depth` is the share of pixels whose depth was given, 0..1.
    pub fn of(
        sparse: &SparseReconstruction,
        focal: FocalSource,
        dense: &[DenseFrame],
        known_depth: Option<f64>,
        around: Circumstances,
    ) -> Self {
        let pixels = dense
            .iter()
            .map(|d| d.mask.data().len())
            .sum::<usize>()
            .max(1) as f64;
        let still = dense
            .iter()
            .flat_map(|d| d.mask.data())
            .filter(|&&m| m == 0)
            .count() as f64;
        let measured = dense
            .iter()
            .flat_map(|d| d.confidence.data())
            .filter(|&&c| c >= MEASURED);
        let measured = measured.count() as f64 / pixels;
        let judged = sparse
            .tracks
            .iter()
            .filter(|t| t.motion != Motion::Unknown)
            .count();
        let inliers = sparse.tracks.iter();
        let inliers = inliers.filter(|t| {
            t.motion == Motion::Static && t.point.is_some() && t.residual_px < INLIER_PX
        });
        let parallax_rad = parallax_rad(sparse);
        let focal_px = sparse.cameras.first().map_or(0.0, |c| c.intrinsics.fx);
        let (source, sigma) = match focal {
            FocalSource::Given => (Focal::Given, None),
            FocalSource::Estimated { sigma } => (Focal::Estimated, sigma.filter(|s| s.is_finite())),
            FocalSource::Assumed => (Focal::Assumed, None),
        };
        let mut confidence = Self {
            grade: Grade::Good,
            advice: None,
            parallax_deg: parallax_rad.to_degrees(),
            parallax_px: parallax_rad * focal_px,
            inlier_share: inliers.count() as f64 / judged.max(1) as f64,
            static_share: still / pixels,
            focal: source,
            focal_sigma_percent: sigma.map(|s| 100.0 * s),
            residual_px: sparse.residual_px,
            measured_share: known_depth.map_or(measured, |share| share.max(measured)),
        };
        (confidence.grade, confidence.advice) = confidence.judge(around);
        confidence
    }

    /// The worst of the findings, and what helps against it; of several that are as bad, the first.
    fn judge(&self, around: Circumstances) -> (Grade, Option<String>) {
        let low = |value: f64, fair: f64, poor: f64| {
            if value < poor {
                Grade::Poor
            } else if value < fair {
                Grade::Fair
            } else {
                Grade::Good
            }
        };
        let high = |value: f64, fair: f64, poor: f64| low(-value, -fair, -poor);
        let parallax = around.camera_motion == CameraMotion::Parallax;
        let crowded = self.static_share < 0.5 && !around.masks_given;
        let crowd = format!(
            "dynamic objects fill the frame: {MASKS}, or film with more of the surroundings"
        );
        let motion = match around.camera_motion {
            CameraMotion::Static | CameraMotion::RotationOnly if around.depth_predicted => (
                Grade::Fair,
                format!("without parallax depth is a network's guess: film while walking sideways, or {DEPTH}"),
            ),
            CameraMotion::Static => (
                Grade::Poor,
                format!("the camera is static, so depth is a placeholder: film while walking sideways, or {DEPTH}"),
            ),
            CameraMotion::RotationOnly => (
                Grade::Poor,
                format!("the camera only rotates, so depth is a placeholder: film while walking sideways, or {DEPTH}"),
            ),
            CameraMotion::Parallax => (
                low(self.parallax_deg, 2.0, 0.7),
                "the camera moves little compared with the distance of what it sees: film while walking sideways"
                    .to_owned(),
            ),
        };
        let few =
            "few points can be tracked: film slower, in more light, with textured objects in view"
                .to_owned();
        let tracks = (
            low(self.inlier_share, 0.4, 0.15),
            if crowded { crowd.clone() } else { few },
        );
        let focal = match (self.focal, self.focal_sigma_percent) {
            (Focal::Assumed, _) => (
                Grade::Fair,
                format!("the field of view is a guess: {FIELD_OF_VIEW}"),
            ),
            (Focal::Estimated, Some(sigma)) => (
                high(sigma, 3.0, 10.0),
                format!("the clip says little about the field of view: {FIELD_OF_VIEW}"),
            ),
            _ => (Grade::Good, String::new()),
        };
        let residual = (
            high(self.residual_px, 0.75, 1.5),
            format!(
                "points do not stay where they should: film without zoom and with a short exposure, or {INTRINSICS}"
            ),
        );
        let measured = (
            low(self.measured_share, 0.35, 0.1),
            format!(
                "little of the depth was measured, the rest is filled in: film textured objects while walking sideways, or {DEPTH}"
            ),
        );
        let tied = (
            if around.tied {
                Grade::Poor
            } else {
                Grade::Good
            },
            format!(
                "two parts of the image move against each other, and either may be the static one: {MASKS}, or film with \
                 more of the surroundings"
            ),
        );
        let all = [
            (true, tied),
            (!around.depth_given, motion),
            (parallax, tracks),
            (true, focal),
            (parallax, residual),
            (
                !around.masks_given,
                (low(self.static_share, 0.6, 0.35), crowd),
            ),
            (parallax && !around.depth_given, measured),
        ];
        let findings: Vec<_> = all
            .into_iter()
            .filter_map(|(counts, finding)| counts.then_some(finding))
            .collect();
        let worst = findings
            .iter()
            .map(|(grade, _)| *grade)
            .max()
            .unwrap_or(Grade::Good);
        let advice = findings
            .iter()
            .find(|(grade, _)| *grade == worst && worst != Grade::Good);
        (worst, advice.map(|(_, advice)| (*advice).to_owned()))
    }

    /// Returns a one-line summary.
    pub fn description(&self) -> String {
        let focal = match (self.focal, self.focal_sigma_percent) {
            (Focal::Given, _) => "focal length given".to_owned(),
            (Focal::Estimated, Some(sigma)) => format!("focal length within {sigma:.1} %"),
            (Focal::Estimated, None) => "focal length estimated".to_owned(),
            (Focal::Assumed, _) => "focal length assumed".to_owned(),
        };
        format!(
            "confidence {}: parallax {:.0} px ({:.1} degrees), {:.0} % of tracks fit, {:.0} % of pixels are static, {focal}, \
             poses to {:.2} px, {:.0} % of depth measured",
            self.grade.name(),
            self.parallax_px,
            self.parallax_deg,
            100.0 * self.inlier_share,
            100.0 * self.static_share,
            self.residual_px,
            100.0 * self.measured_share
        )
    }
}

/// Median over all points of the widest angle between the rays to the cameras that saw them.
fn parallax_rad(sparse: &SparseReconstruction) -> f64 {
    let mut angles: Vec<f64> = Vec::new();
    for track in &sparse.tracks {
        let Some(point) = track.point else { continue };
        let last = track.observations.len().saturating_sub(1);
        let step = (last / (VIEWS - 1)).max(1);
        let frames = (0..=last).step_by(step).chain([last]);
        let cameras = frames.filter_map(|k| sparse.cameras.get(track.first_frame + k));
        let rays: Vec<_> = cameras.map(|c| (point - c.centre()).normalize()).collect();
        let pairs = rays
            .iter()
            .enumerate()
            .flat_map(|(i, a)| rays[..i].iter().map(move |b| (a, b)));
        let widest = pairs
            .map(|(a, b)| a.cross(b).norm().atan2(a.dot(b)))
            .fold(0.0, f64::max);
        angles.push(widest);
    }
    median(&mut angles).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::{
        CameraMotion, Circumstances, Confidence, DEPTH, FIELD_OF_VIEW, Focal, Grade, MASKS,
    };

    const FINE: Confidence = Confidence {
        grade: Grade::Good,
        advice: None,
        parallax_deg: 8.0,
        parallax_px: 60.0,
        inlier_share: 0.8,
        static_share: 0.9,
        focal: Focal::Estimated,
        focal_sigma_percent: Some(0.5),
        residual_px: 0.2,
        measured_share: 0.8,
    };
    const MOVING: Circumstances = Circumstances {
        camera_motion: CameraMotion::Parallax,
        masks_given: false,
        tied: false,
        depth_given: false,
        depth_predicted: false,
    };

    #[test]
    fn each_weak_number_has_its_grade_and_advice() {
        assert_eq!(FINE.judge(MOVING), (Grade::Good, None));
        let weak =
            |change: &dyn Fn(&mut Confidence), around: Circumstances, grade: Grade, word: &str| {
                let mut c = FINE.clone();
                change(&mut c);
                let (actual, advice) = c.judge(around);
                let advice = advice.unwrap_or_default();
                assert!(
                    actual == grade && advice.contains(word),
                    "{actual:?} {advice} for {c:?}"
                );
            };
        let tied = Circumstances {
            tied: true,
            ..MOVING
        };
        weak(&|_| (), tied, Grade::Poor, MASKS);
        weak(&|c| c.parallax_deg = 1.0, MOVING, Grade::Fair, "sideways");
        weak(&|c| c.parallax_deg = 0.1, MOVING, Grade::Poor, "sideways");
        weak(&|c| c.inlier_share = 0.1, MOVING, Grade::Poor, "light");
        weak(
            &|c| (c.inlier_share, c.static_share) = (0.1, 0.4),
            MOVING,
            Grade::Poor,
            MASKS,
        );
        weak(
            &|c| c.focal_sigma_percent = Some(20.0),
            MOVING,
            Grade::Poor,
            FIELD_OF_VIEW,
        );
        weak(&|c| c.residual_px = 1.0, MOVING, Grade::Fair, "zoom");
        weak(&|c| c.static_share = 0.5, MOVING, Grade::Fair, MASKS);
        weak(&|c| c.measured_share = 0.2, MOVING, Grade::Fair, DEPTH);
        let tripod = Circumstances {
            camera_motion: CameraMotion::Static,
            ..MOVING
        };
        weak(
            &|c| c.focal = Focal::Assumed,
            tripod,
            Grade::Poor,
            "is static",
        );
        let predicted = Circumstances {
            depth_predicted: true,
            ..tripod
        };
        weak(&|_| {}, predicted, Grade::Fair, "a network's guess");
        let with_depth = Circumstances {
            depth_given: true,
            ..tripod
        };
        weak(
            &|c| c.focal = Focal::Assumed,
            with_depth,
            Grade::Fair,
            FIELD_OF_VIEW,
        );
    }
}
