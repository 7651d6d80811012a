//! Converts between frames and seconds.

use m4_core::Scene;

/// Frames per second where a scene or a file does not say.
pub const DEFAULT_FPS: f64 = 30.0;

/// How long a frame of a scene lasts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Clock {
    /// Seconds from one frame to the next.
    pub step_s: f64,
    /// True where that was made up: [`DEFAULT_FPS`].
    pub assumed: bool,
}

impl Clock {
    /// The clock of a scene.
    pub fn of(scene: &Scene) -> Self {
        let steps = scene.time_frames.saturating_sub(1) as f64;
        match scene.duration_s {
            Some(s) if s > 0.0 && steps > 0.0 => Self {
                step_s: s / steps,
                assumed: false,
            },
            _ => Self {
                step_s: 1.0 / DEFAULT_FPS,
                assumed: true,
            },
        }
    }
}
