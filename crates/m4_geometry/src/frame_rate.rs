//! The rate of a clip: what depends on motion is stated in seconds and counted in frames here.

/// Frames per second, finite and above 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameRate(f64);

impl FrameRate {
    /// The rate of films, for a clip without times.
    pub const FILM: Self = Self(24.0);

    /// `per_second` frames per second; `None` unless it is finite and above 0.
    pub fn new(per_second: f64) -> Option<Self> {
        (per_second.is_finite() && per_second > 0.0).then_some(Self(per_second))
    }

    /// The mean rate of frames at these times, seconds; `None` for fewer than two different times.
    pub fn of_times(times_s: &[f64]) -> Option<Self> {
        let duration_s = times_s.last()? - times_s.first()?;
        Self::new((times_s.len() - 1) as f64 / duration_s)
    }

    /// A time in frames.
    pub(crate) fn exact(self, seconds: f64) -> f64 {
        seconds * self.0
    }

    /// The time of a number of frames.
    pub(crate) fn seconds(self, frames: usize) -> f64 {
        frames as f64 / self.0
    }

    /// The whole number of frames nearest to a time, at least 1.
    pub(crate) fn frames(self, seconds: f64) -> usize {
        self.exact(seconds).round().max(1.0) as usize
    }

    /// The different numbers of frames nearest to rising times.
    pub(crate) fn distances(self, seconds: &[f64]) -> Vec<usize> {
        let mut out: Vec<usize> = seconds.iter().map(|s| self.frames(*s)).collect();
        out.dedup();
        out
    }
}

#[cfg(test)]
mod tests {
    use super::FrameRate;

    #[test]
    fn seconds_become_frames() {
        let rate = FrameRate::of_times(&[1.0, 1.02, 1.04]).unwrap();
        assert_eq!((rate.frames(0.1), rate.frames(0.001)), (5, 1));
        assert_eq!(rate.distances(&[0.01, 0.02, 0.5]), [1, 25]);
        assert_eq!(FrameRate::new(f64::NAN), None);
        assert_eq!(FrameRate::of_times(&[3.0, 3.0]), None);
        assert_eq!(FrameRate::of_times(&[]), None);
    }
}
