//! How frames are shown: which side is up, and when.

use m4_core::{Plane, RgbImage};
use mp4_atom::{ElstEntry, Matrix};

/// Where the stored image's columns and rows go on the display.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Orientation {
    /// Stored columns become displayed rows.
    transpose: bool,
    /// Displayed columns run against the stored axis they come from.
    flip_x: bool,
    /// Displayed rows run against the stored axis they come from.
    flip_y: bool,
}

impl Orientation {
    /// From the display matrix of a track (`x' = a x + c y`, `y' = b x + d y`, y down); `None` if
    /// not one of the eight up to scale.
    pub fn from_matrix(&Matrix { a, b, c, d, .. }: &Matrix) -> Option<Self> {
        // Rounding of turned matrices leaves a few units where 0 is meant (65536 = 1).
        let small = |v: i32| v.unsigned_abs() < 1024;
        if small(b) && small(c) && !small(a) && !small(d) {
            Some(Self {
                transpose: false,
                flip_x: a < 0,
                flip_y: d < 0,
            })
        } else if small(a) && small(d) && !small(b) && !small(c) {
            // x' follows y with the sign of c, y' follows x with the sign of b.
            Some(Self {
                transpose: true,
                flip_x: c < 0,
                flip_y: b < 0,
            })
        } else {
            None
        }
    }

    /// True when width and height change places.
    pub fn swaps_sides(self) -> bool {
        self.transpose
    }

    /// The image as it is displayed.
    pub fn apply(self, image: RgbImage) -> RgbImage {
        if self == Self::default() {
            return image;
        }
        let (w, h) = image.size();
        let (width, height) = if self.transpose { (h, w) } else { (w, h) };
        Plane::from_fn(width, height, |x, y| {
            let x = if self.flip_x { width - 1 - x } else { x };
            let y = if self.flip_y { height - 1 - y } else { y };
            image[if self.transpose { (y, x) } else { (x, y) }]
        })
    }
}

/// Maps ticks of a track to seconds of the presentation.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    parts: Vec<Edit>,
    ticks_per_s: f64,
}

/// A stretch of the track that is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Edit {
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
    pub fn new(edits: &[ElstEntry], movie_scale: u32, track_scale: u32) -> Self {
        let (movie, track) = (f64::from(movie_scale.max(1)), f64::from(track_scale.max(1)));
        let mut parts = Vec::new();
        let mut shown_at = 0.0;
        for edit in edits {
            let length_s = edit.segment_duration as f64 / movie;
            let rate = f64::from(edit.media_rate.integer())
                + f64::from(edit.media_rate.decimal().cast_unsigned()) / 65536.0;
            if let Some(from) = edit.media_time.filter(|_| rate > 0.0) {
                let from = from as f64;
                // The duration was rounded to ticks of the movie: a frame that starts within one of
                // the end belongs to what was cut away.
                let to = from + (length_s - 1.0 / movie) * track * rate;
                let to = if edit.segment_duration == 0 {
                    f64::INFINITY
                } else {
                    to.max(from + 1.0)
                };
                parts.push(Edit {
                    from,
                    to,
                    shown_at,
                    rate,
                });
            }
            shown_at += length_s;
        }
        if parts.is_empty() {
            parts.push(Edit {
                from: f64::NEG_INFINITY,
                to: f64::INFINITY,
                shown_at: 0.0,
                rate: 1.0,
            });
        }
        Self {
            parts,
            ticks_per_s: track,
        }
    }

    /// Seconds at which the frame of composition time `ticks` is shown; `None` when cut away. Only
    /// differences count.
    pub fn shown_s(&self, ticks: i64) -> Option<f64> {
        let ticks = ticks as f64;
        let part = self
            .parts
            .iter()
            .find(|p| ticks >= p.from && ticks < p.to)?;
        let origin = if part.from.is_finite() {
            part.from
        } else {
            0.0
        };
        Some(part.shown_at + (ticks - origin) / self.ticks_per_s / part.rate)
    }
}

#[cfg(test)]
mod tests {
    use super::{Orientation, Timeline};
    use mp4_atom::{ElstEntry, FixedPoint, Matrix};

    #[test]
    fn other_display_matrices_have_no_orientation() {
        let whole = Matrix {
            a: 46341,
            b: 46341,
            u: 0,
            c: -46341,
            d: 46341,
            v: 0,
            x: 0,
            y: 0,
            w: 1 << 30,
        };
        assert_eq!(Orientation::from_matrix(&whole), None);
        assert_eq!(
            Orientation::from_matrix(&Matrix {
                a: 0,
                b: 0,
                c: 0,
                d: 0,
                ..whole
            }),
            None
        );
    }

    /// Rates in quarters.
    fn edit(segment_duration: u64, media_time: Option<u64>, rate: i16) -> ElstEntry {
        let media_rate = FixedPoint::new(rate / 4, rate % 4 * 0x4000);
        ElstEntry {
            segment_duration,
            media_time,
            media_rate,
        }
    }

    #[test]
    fn edit_lists_shift_cut_and_stretch_frames() {
        let delayed = Timeline::new(
            &[edit(500, None, 4), edit(1000, Some(24_000), 4)],
            1000,
            12_000,
        );
        let slow = Timeline::new(&[edit(600, Some(0), 4), edit(600, Some(600), 1)], 600, 600);
        let whole = Timeline::new(&[], 600, 600);
        let open = Timeline::new(&[edit(0, Some(1024), 4)], 600, 12_288);
        for (timeline, ticks, want_s) in [
            (&delayed, 23_500, None),
            (&delayed, 24_000, Some(0.5)),
            (&delayed, 35_500, Some(0.5 + 11.5 / 12.0)),
            (&delayed, 36_000, None),
            (&slow, 300, Some(0.5)),
            (&slow, 660, Some(1.0 + 60.0 / 600.0 * 4.0)),
            (&whole, -300, Some(-0.5)),
            (&open, 1024, Some(0.0)),
            (&open, 1_000_000, Some((1_000_000.0 - 1024.0) / 12_288.0)),
        ] {
            assert_eq!(timeline.shown_s(ticks), want_s, "{timeline:?} {ticks}");
        }
    }
}
