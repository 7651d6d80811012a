//! The options of camera paths.

use super::{CameraPath, Moment, SwingConfig};
use crate::Refusal;
use serde::{Deserialize, Serialize};

/// Options of the user; `None` leaves the choice to [`PathConfig`] and the scene.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PathOptions {
    /// Length of the video, seconds.
    pub seconds: Option<f64>,
    /// The moment of the source whose camera a path starts from; for the bullet, where time is frozen;
    /// for the source and its like, the one image that is wanted.
    pub at: Option<Moment>,
    /// Times the motion that the scene is good for; below 0 the other way round.
    pub amount: Option<f64>,
    /// Greatest turn to either side, degrees.
    pub degrees: Option<f64>,
    /// Standard deviation of the smoothing, seconds.
    pub smooth_s: Option<f64>,
    /// From 0, the source, to 1, all of the smoothing.
    pub strength: Option<f64>,
    /// Seconds for which time is frozen.
    pub hold_s: Option<f64>,
}

/// Defaults of the camera paths. Lengths are shares of the median depth of dynamic regions (of everything, where
/// nothing does) in the image of the camera where the path starts, so that they do not depend on the unit of the scene. Limits of
/// turns are narrow, because dynamic regions were seen from one side alone at each moment, wherever the camera was before and after:
/// beyond 6 degrees the pinwheel of the examples begins to come apart (ours, judged by eye).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PathConfig {
    /// The swing; two of its periods are rendered.
    pub swing: SwingConfig,
    /// Length of a swing, seconds.
    pub seconds: f64,
    /// Smallest and greatest turn of a bullet to either side, degrees: the reach of the source camera is used within these limits.
    pub side_deg: [f64; 2],
    /// Turn of a bullet up and down, as a share of the turn to the side.
    pub up_share: f64,
    /// Seconds for which a bullet path freezes time.
    pub hold_s: f64,
    /// Seconds in which time slows down before, and speeds up after.
    pub ease_s: f64,
    /// Standard deviation of the smoothing, seconds.
    pub smooth_s: f64,
    /// Furthest that the smoothed camera leaves the source, as a share of the distance.
    pub stray: f64,
    /// Furthest that it turns away from the source, degrees.
    pub stray_deg: f64,
}

impl Default for PathConfig {
    fn default() -> Self {
        Self {
            swing: SwingConfig::default(),
            seconds: 4.0,
            side_deg: [4.0, 6.0],
            up_share: 0.3,
            hold_s: 4.0,
            ease_s: 0.4,
            smooth_s: 0.5,
            stray: 0.08,
            stray_deg: 5.0,
        }
    }
}

impl CameraPath {
    /// The options that mean something for this path.
    pub fn takes(&self) -> &'static [&'static str] {
        match self {
            Self::Train => &["--at"],
            Self::Source => &["--seconds", "--at"],
            Self::Stabilised => &["--seconds", "--at", "--smooth-s", "--strength"],
            Self::Swing => &["--seconds", "--at", "--amount", "--degrees"],
            Self::Bullet => &["--seconds", "--at", "--amount", "--degrees", "--hold-s"],
            Self::File(_) => &["--seconds"],
        }
    }
}

impl PathOptions {
    /// Refuses what means nothing for the path, and numbers that cannot work.
    pub fn check(&self, path: &CameraPath) -> Result<(), Refusal> {
        let given = [
            ("--seconds", self.seconds.is_some()),
            ("--at", self.at.is_some()),
            ("--amount", self.amount.is_some()),
            ("--degrees", self.degrees.is_some()),
            ("--smooth-s", self.smooth_s.is_some()),
            ("--strength", self.strength.is_some()),
            ("--hold-s", self.hold_s.is_some()),
        ];
        let known = path.takes();
        if let Some((option, _)) = given.into_iter().find(|(name, given)| *given && !known.contains(name)) {
            return Err(unused(option, &path.to_string(), known));
        }
        let numbers = [
            ("--seconds", self.seconds, 0.01, 3600.0, "0.01 to 3600 seconds"),
            ("--amount", self.amount, -10.0, 10.0, "a factor from -10 to 10"),
            ("--degrees", self.degrees, -60.0, 60.0, "at most 60 degrees"),
            ("--smooth-s", self.smooth_s, 0.02, 10.0, "0.02 to 10 seconds"),
            ("--strength", self.strength, 0.0, 1.0, "0 to 1"),
            ("--hold-s", self.hold_s, 0.1, 600.0, "0.1 to 600 seconds"),
        ];
        for (option, value, least, most, expected) in numbers {
            if let Some(value) = value.filter(|v| !(*v >= least && *v <= most)) {
                let message = format!("{option} is {value}; {expected} was expected");
                return Err(Refusal::usage(message));
            }
        }
        Ok(())
    }
}

/// The refusal of an option that the path `path` has no use for; `known` are those that it takes.
pub(super) fn unused(option: &str, path: &str, known: &[&str]) -> Refusal {
    let takes = match known {
        [] => "none of these options".to_owned(),
        known => known.join(", "),
    };
    Refusal::usage(format!("{option} has no meaning for the camera path {path}; it takes {takes}"))
}
