//! The presentation time of a frame: the edit list of a track (ISO/IEC 14496-12, 8.6.6).

/// One entry of an edit list.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edit {
    /// Ticks of the movie; 0 = to the end of the track.
    pub duration: u64,
    /// Ticks of the track where the part starts; -1 = nothing is shown.
    pub media_time: i64,
    /// Speed, 1 = as filmed.
    pub rate: f64,
}

/// Maps ticks of a track to seconds of the presentation.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    parts: Vec<Part>,
    ticks_per_s: f64,
}

/// A stretch of the track that is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Part {
    /// Ticks of the track.
    from: f64,
    /// Ticks of the track, not included.
    to: f64,
    /// Seconds.
    shown_at: f64,
    rate: f64,
}

impl Timeline {
    /// `movie_scale` and `track_scale` are ticks per second, above 0.
    pub fn new(edits: &[Edit], movie_scale: u32, track_scale: u32) -> Self {
        let (movie, track) = (f64::from(movie_scale.max(1)), f64::from(track_scale.max(1)));
        let mut parts = Vec::new();
        let mut shown_at = 0.0;
        for edit in edits {
            let length_s = edit.duration as f64 / movie;
            if edit.media_time >= 0 && edit.rate > 0.0 {
                let from = edit.media_time as f64;
                // The duration was rounded to ticks of the movie: a frame that starts within one of
                // the end belongs to what was cut away.
                let to = from + (length_s - 1.0 / movie) * track * edit.rate;
                let to = if edit.duration == 0 { f64::INFINITY } else { to.max(from + 1.0) };
                parts.push(Part { from, to, shown_at, rate: edit.rate });
            }
            shown_at += length_s;
        }
        if parts.is_empty() {
            parts.push(Part { from: f64::NEG_INFINITY, to: f64::INFINITY, shown_at: 0.0, rate: 1.0 });
        }
        Self { parts, ticks_per_s: track }
    }

    /// Seconds at which the frame of composition time `ticks` is shown (first); `None` when it is cut
    /// away. The origin means nothing: only differences do.
    pub fn shown_s(&self, ticks: i64) -> Option<f64> {
        let ticks = ticks as f64;
        let part = self.parts.iter().find(|p| ticks >= p.from && ticks < p.to)?;
        let origin = if part.from.is_finite() { part.from } else { 0.0 };
        Some(part.shown_at + (ticks - origin) / self.ticks_per_s / part.rate)
    }
}

#[cfg(test)]
mod tests {
    use super::{Edit, Timeline};

    fn edit(duration: u64, media_time: i64, rate: f64) -> Edit {
        Edit { duration, media_time, rate }
    }

    #[test]
    fn edit_list_delays_and_cuts_shift_frames() {
        let timeline = Timeline::new(&[edit(500, -1, 1.0), edit(1000, 24_000, 1.0)], 1000, 12_000);
        assert_eq!(timeline.shown_s(23_500), None);
        assert_eq!(timeline.shown_s(24_000), Some(0.5));
        assert_eq!(timeline.shown_s(35_500), Some(0.5 + 11.5 / 12.0));
        assert_eq!(timeline.shown_s(36_000), None);
    }

    #[test]
    fn slow_motion_stretches_a_part() {
        let timeline = Timeline::new(&[edit(600, 0, 1.0), edit(600, 600, 0.25)], 600, 600);
        assert_eq!(timeline.shown_s(300), Some(0.5));
        assert_eq!(timeline.shown_s(660), Some(1.0 + 60.0 / 600.0 * 4.0));
    }

    #[test]
    fn clips_without_edit_lists_keep_all_frames() {
        let timeline = Timeline::new(&[], 600, 600);
        assert_eq!(timeline.shown_s(-300), Some(-0.5));
        let open = Timeline::new(&[edit(0, 1024, 1.0)], 600, 12_288);
        assert_eq!(open.shown_s(1024), Some(0.0));
        assert_eq!(open.shown_s(1 << 40).map(f64::is_finite), Some(true));
    }
}
