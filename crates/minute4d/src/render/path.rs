//! Which cameras look, and when.

use super::{SwingConfig, swing};
use crate::Error;
use m4_io::trajectory;
use m4_scene::{Camera, Exposure, Scene};
use std::path::PathBuf;

/// A row of cameras.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraPath {
    /// `train`: those that took the video, with their exposures.
    Train,
    /// `swing`: an arc about what the middle camera sees.
    Swing,
    /// `test:TRANSFORMS` or a transforms file: those listed there, in the scene's world.
    File(PathBuf),
}

impl CameraPath {
    /// The path of that name; a name that is none of the words is a file.
    #[must_use]
    pub fn named(name: &str) -> Self {
        match name {
            "train" => Self::Train,
            "swing" => Self::Swing,
            _ => Self::File(name.strip_prefix("test:").unwrap_or(name).into()),
        }
    }

    /// Its cameras; `distance` gives the z-depth of what a camera looks at, for the swing.
    ///
    /// # Errors
    ///
    /// [`Error::ReadTrajectory`] for a file that cannot be used.
    pub fn stops(
        &self,
        scene: &Scene,
        swing_config: &SwingConfig,
        distance: impl FnOnce(&Stop) -> f64,
    ) -> Result<Vec<Stop>, Error> {
        let source = scene.source.iter().map(|s| Stop {
            camera: s.camera,
            t: s.t,
            exposure: s.exposure,
        });
        match self {
            Self::Train => Ok(source.collect()),
            Self::Swing => {
                let Some(middle) = source.clone().nth(scene.source.len() / 2) else {
                    return Ok(Vec::new());
                };
                let cameras = swing(
                    &middle.camera,
                    distance(&middle),
                    2 * swing_config.period_frames,
                    swing_config,
                );
                let turned = cameras.into_iter().map(|camera| Stop { camera, ..middle });
                Ok(turned.collect())
            }
            Self::File(path) => {
                let listed = trajectory::read(path, scene.time_frames)?;
                let stops = listed.into_iter().map(|(camera, t)| Stop {
                    camera,
                    t,
                    exposure: Exposure::IDENTITY,
                });
                Ok(stops.collect())
            }
        }
    }
}

/// A camera on a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// Lens and pose.
    pub camera: Camera,
    /// Its own moment, frames.
    pub t: f64,
    /// Colour correction of what it sees.
    pub exposure: Exposure,
}
