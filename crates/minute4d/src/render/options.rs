//! The options of camera paths.

use super::{CameraPath, Moment};
use crate::Refusal;

/// Options of the user; `None` leaves the choice to the path and the scene.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PathOptions {
    /// Length of the video, seconds.
    pub seconds: Option<f64>,
    /// The moment of the source whose camera a path starts from; for the bullet, where time is
    /// frozen; for the source and its like, the one image that is wanted.
    pub at: Option<Moment>,
    /// Greatest turn to either side, degrees; below 0 the other way round.
    pub degrees: Option<f64>,
}

impl CameraPath {
    /// The options that mean something for this path.
    fn takes(&self) -> &'static [&'static str] {
        match self {
            Self::Train => &["at"],
            Self::Source | Self::Stabilised => &["seconds", "at"],
            Self::Swing | Self::Bullet => &["seconds", "at", "degrees"],
            Self::File(_) => &["seconds"],
        }
    }
}

impl PathOptions {
    /// Refuses what means nothing for the path, and numbers that cannot work.
    pub fn check(&self, path: &CameraPath) -> Result<(), Refusal> {
        let choices = [
            ("seconds", self.seconds.is_some()),
            ("at", self.at.is_some()),
            ("degrees", self.degrees.is_some()),
        ];
        let options = path.takes();
        if let Some((option, _)) = choices
            .into_iter()
            .find(|(name, present)| *present && !options.contains(name))
        {
            return Err(unused(option, &path.to_string(), options));
        }
        let numbers = [
            (
                "seconds",
                self.seconds,
                0.01,
                3600.0,
                "0.01 to 3600 seconds",
            ),
            ("degrees", self.degrees, -60.0, 60.0, "at most 60 degrees"),
        ];
        for (option, value, least, most, expected) in numbers {
            if let Some(value) = value.filter(|v| !(*v >= least && *v <= most)) {
                let message = format!("{option} = {value}; {expected} was expected");
                return Err(Refusal::usage(message));
            }
        }
        Ok(())
    }
}

/// The refusal of an option that the path `path` does not take; it takes `options`.
pub(super) fn unused(option: &str, path: &str, options: &[&str]) -> Refusal {
    let takes = match options {
        [] => "none of these options".to_owned(),
        names => names.join(", "),
    };
    Refusal::usage(format!(
        "the option {option} has no meaning for the camera path {path}; it takes {takes}"
    ))
}
