//! Parses the scene time of a camera path.

use m4_core::Scene;
use std::fmt;
use std::str::FromStr;

/// Frames a second where the scene does not say.
pub const DEFAULT_FPS: f64 = 30.0;

/// A moment, as people write it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Moment {
    /// `12` or `12.5`: frames of the training video, counted from 0.
    Frames(f64),
    /// `1.5s`: seconds from the first frame.
    Seconds(f64),
}

/// Time along a camera path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimePath {
    /// `source`: every camera at its own moment.
    Source,
    /// `freeze@T`: one moment for all.
    Freeze(Moment),
    /// `play`: from the first frame at the speed of the source, over and over.
    Play,
}

/// Errors of parsing times.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TimeError {
    /// The text has none of the known forms.
    #[error(
        "{0:?} is not a time; write source, play or freeze@T, where T is a frame number (12.5), or seconds with the suffix s (1.5s)"
    )]
    Form(String),
    /// The text is not a time.
    #[error(
        "{0:?} is not a time; write a frame number (12.5), or seconds with the suffix s (1.5s)"
    )]
    Moment(String),
    /// Before the first or after the last frame.
    #[error(
        "{moment} lies outside the scene, which has frames 0 to {last}{}",
        seconds_of(duration_s)
    )]
    Outside {
        /// The moment asked for.
        moment: Moment,
        /// The last frame.
        last: usize,
        /// Length of the clip, where known.
        duration_s: Option<f64>,
    },
    /// Seconds in a scene that has none.
    #[error(
        "{moment} is unknown: the scene does not state its duration in seconds; write a frame number, 0 to {last}"
    )]
    NoDuration {
        /// The moment asked for.
        moment: Moment,
        /// The last frame.
        last: usize,
    },
}

fn seconds_of(duration_s: &Option<f64>) -> String {
    duration_s.map_or_else(String::new, |s| format!(" (0s to {s:.3}s)"))
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Frames(t) => write!(f, "frame {t}"),
            Self::Seconds(s) => write!(f, "{s}s"),
        }
    }
}

impl FromStr for Moment {
    type Err = TimeError;

    fn from_str(text: &str) -> Result<Self, TimeError> {
        parse_moment(text.trim()).ok_or_else(|| TimeError::Moment(text.to_owned()))
    }
}

impl FromStr for TimePath {
    type Err = TimeError;

    fn from_str(text: &str) -> Result<Self, TimeError> {
        let form = || TimeError::Form(text.to_owned());
        if text == "source" {
            return Ok(Self::Source);
        }
        if text == "play" {
            return Ok(Self::Play);
        }
        let t = text.strip_prefix("freeze@").ok_or_else(form)?;
        Ok(Self::Freeze(parse_moment(t.trim()).ok_or_else(form)?))
    }
}

fn parse_moment(text: &str) -> Option<Moment> {
    let (number, seconds) = match text.strip_suffix('s') {
        Some(number) => (number, true),
        None => (text, false),
    };
    let value: f64 = number.parse().ok().filter(|v: &f64| v.is_finite())?;
    Some(if seconds {
        Moment::Seconds(value)
    } else {
        Moment::Frames(value)
    })
}

/// The duration of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// Time runs from 0 to one less than this, frames.
    pub time_frames: usize,
    /// Seconds from the first to the last frame, where known.
    pub duration_s: Option<f64>,
}

impl Span {
    /// That of a scene.
    pub fn of(scene: &Scene) -> Self {
        Self {
            time_frames: scene.time_frames,
            duration_s: scene.duration_s,
        }
    }

    fn last(&self) -> usize {
        self.time_frames.saturating_sub(1)
    }

    /// The moment in frames.
    ///
    /// # Errors
    ///
    /// [`TimeError`] if it lies outside the scene, or counts seconds that the scene does not know.
    pub fn frames(&self, moment: Moment) -> Result<f64, TimeError> {
        let last = self.last();
        let t = match (moment, self.duration_s) {
            (Moment::Frames(t), _) => t,
            (Moment::Seconds(s), Some(duration_s)) if duration_s > 0.0 => {
                s / duration_s * last as f64
            }
            (Moment::Seconds(_), _) => return Err(TimeError::NoDuration { moment, last }),
        };
        // The last moment written in seconds may land a rounding error behind the last frame.
        if (-1e-6..=last as f64 + 1e-3).contains(&t) {
            Ok(t.clamp(0.0, last as f64))
        } else {
            let duration_s = self.duration_s;
            Err(TimeError::Outside {
                moment,
                last,
                duration_s,
            })
        }
    }
}

impl TimePath {
    /// The moment of each camera in frames, given each camera's own and their number per second.
    ///
    /// # Errors
    ///
    /// [`TimeError`] if a moment lies outside `span`, or counts seconds that it does not know.
    pub fn moments(&self, own: &[f64], fps: f64, span: &Span) -> Result<Vec<f64>, TimeError> {
        let n = own.len();
        match *self {
            Self::Source => Ok(own.to_vec()),
            Self::Freeze(moment) => Ok(vec![span.frames(moment)?; n]),
            Self::Play => {
                let last = span.last() as f64;
                let per_s = match span.duration_s {
                    Some(duration_s) if duration_s > 0.0 => last / duration_s,
                    _ => DEFAULT_FPS,
                };
                // The last frame lasts as long as the others before the first one comes again.
                let moment = |i: usize| (i as f64 * per_s / fps) % (last + 1.0);
                Ok((0..n).map(|i| moment(i).min(last)).collect())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Moment, Span, TimeError, TimePath};

    const SPAN: Span = Span {
        time_frames: 31,
        duration_s: Some(3.0),
    };

    #[test]
    fn every_form_is_read() {
        let read = |text: &str| text.parse::<TimePath>().unwrap();
        assert_eq!(read("source"), TimePath::Source);
        assert_eq!(read("freeze@12.5"), TimePath::Freeze(Moment::Frames(12.5)));
        assert_eq!(read("freeze@1.5s"), TimePath::Freeze(Moment::Seconds(1.5)));
        for bad in [
            "",
            "now",
            "freeze",
            "freeze@",
            "freeze@x",
            "1..2",
            "freeze@nan",
            "freeze@1ms",
        ] {
            assert!(
                matches!(bad.parse::<TimePath>(), Err(TimeError::Form(_))),
                "{bad}"
            );
        }
    }

    #[test]
    fn single_times_are_parsed() {
        assert_eq!("1.5s".parse(), Ok(Moment::Seconds(1.5)));
        assert_eq!(" 7 ".parse(), Ok(Moment::Frames(7.0)));
        for bad in ["", "s", "inf", "1..2", "freeze@2"] {
            assert!(
                matches!(bad.parse::<Moment>(), Err(TimeError::Moment(_))),
                "{bad}"
            );
        }
    }

    #[test]
    fn moments_are_frames_within_the_scene() {
        let own = [0.0, 1.0, 2.0];
        let at = |text: &str| text.parse::<TimePath>().unwrap().moments(&own, 20.0, &SPAN);
        assert_eq!(at("source").unwrap(), own);
        assert_eq!(at("freeze@1s").unwrap(), [10.0; 3]);
        assert_eq!(at("play").unwrap(), [0.0, 0.5, 1.0]);
        let long = TimePath::Play.moments(&[0.0; 70], 20.0, &SPAN).unwrap();
        assert_eq!(
            (long[60], long[61], long[62], long[64]),
            (30.0, 30.0, 0.0, 1.0)
        );
        assert!(matches!(
            at("freeze@31"),
            Err(TimeError::Outside { last: 30, .. })
        ));
        assert!(matches!(at("freeze@-1"), Err(TimeError::Outside { .. })));
        let unknown = Span {
            duration_s: None,
            ..SPAN
        };
        let seconds = "freeze@1s"
            .parse::<TimePath>()
            .unwrap()
            .moments(&own, 20.0, &unknown);
        assert!(matches!(seconds, Err(TimeError::NoDuration { .. })));
    }
}
