//! The time limit of a run.

use minute4d::{Error, Settings};
use std::time::{Duration, Instant};

/// Reserve for reading back, page and preview: share of the time left when training starts, and its
/// maximum in seconds.
const RESERVE: f64 = 0.25;
const MOST_RESERVE_S: f64 = 120.0;

/// The start and the time limit of a run.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Clock {
    started: Instant,
    limit: Option<Duration>,
}

impl Clock {
    /// Starts now.
    pub fn start(settings: &Settings) -> Self {
        let seconds = settings.limit.time_s;
        let limit = Duration::try_from_secs_f64(seconds)
            .ok()
            .filter(|_| seconds > 0.0);
        Self {
            started: Instant::now(),
            limit,
        }
    }

    /// Returns the end of the time limit.
    pub fn end(&self) -> Option<Instant> {
        self.started.checked_add(self.limit?)
    }

    /// Returns true after the limit is reached.
    pub fn is_over(&self) -> bool {
        self.end().is_some_and(|end| Instant::now() >= end)
    }

    /// Returns the time by which training that starts now must end.
    pub fn end_of_training(&self) -> Option<Instant> {
        let left_s = self
            .end()?
            .saturating_duration_since(Instant::now())
            .as_secs_f64();
        let reserve_s = (RESERVE * left_s).min(MOST_RESERVE_S);
        Some(Instant::now() + Duration::from_secs_f64(left_s - reserve_s))
    }

    /// Returns the same failure, or "time is up" if only the clock asked to stop.
    pub fn blame(&self, error: Error, stage: &'static str, asked_to_stop: bool) -> Error {
        match self.limit {
            Some(limit) if error.is_stop() && !asked_to_stop && self.is_over() => {
                Error::TimeLimit {
                    stage,
                    seconds: limit.as_secs_f64(),
                }
            }
            _ => error,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Clock;
    use minute4d::{Category, Error, Settings};

    fn clock(time_s: f64) -> Clock {
        let mut settings = Settings::fast();
        settings.limit.time_s = time_s;
        Clock::start(&settings)
    }

    #[test]
    fn no_limit_never_expires() {
        for none in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let clock = clock(none);
            assert!(clock.end().is_none() && clock.end_of_training().is_none() && !clock.is_over());
        }
    }

    #[test]
    fn training_leaves_time_for_the_rest() {
        let clock = clock(1000.0);
        let (end, training) = (clock.end().unwrap(), clock.end_of_training().unwrap());
        let reserve_s = (end - training).as_secs_f64();
        assert!((119.0..=121.0).contains(&reserve_s), "{reserve_s}");
    }

    #[test]
    fn stop_without_a_request_is_the_time_limit() {
        let stop = || Error::Stopped {
            stage: "geometry",
            saved: true,
        };
        let over = clock(1e-9);
        assert_eq!(
            over.blame(stop(), "geometry", false).category(),
            Category::TryAgain
        );
        assert_eq!(
            over.blame(stop(), "geometry", true).category(),
            Category::Stopped
        );
        assert_eq!(
            clock(1000.0).blame(stop(), "geometry", false).category(),
            Category::Stopped
        );
    }
}
