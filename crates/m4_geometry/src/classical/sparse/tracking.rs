//! Points followed through the whole clip.

use super::corners::{MIN_DISTANCE_PX, fill_empty_cells};
use super::klt::{Template, follow, inside};
use super::luma::{Pyramid, WorkingSize, luma};
use super::{SparseError, stopped};
use m4_core::{Progress, RgbImage};
use rayon::prelude::*;

/// Reach of the patch that is followed, working pixels: 5 for a side of 11. docs/spec/front-end.md 7.1 has a side of 21; 11 gave trajectories as good
/// or better, and is faster (docs/decisions/0001).
const RADIUS: usize = 5;
/// Levels of the pyramid, each half the size of the one below. 4: docs/spec/front-end.md 7.1.
const LEVELS: usize = 4;
/// Gauss-Newton steps per level.
const ITERATIONS: usize = 12;
/// A point followed to the next frame and back must return this close, working pixels. 0.7: docs/spec/front-end.md 7.1.
const MAX_ROUND_TRIP_PX: f32 = 0.7;
/// Least normalised cross-correlation of a patch with itself one frame later.
const MIN_CORRELATION: f32 = 0.7;
/// Positions are aligned to the patch of an earlier frame while it correlates this much.
const ANCHOR_CORRELATION: f32 = 0.92;
/// ... and while that moves the position by no more than this, working pixels.
const MAX_DRIFT_PX: f32 = 1.0;

/// One point followed through consecutive frames.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct RawTrack {
    /// Frame of the first observation.
    pub first: usize,
    /// Working pixels from the image centre, one entry per frame.
    pub seen: Vec<[f64; 2]>,
}

impl RawTrack {
    /// The observation in `frame`, if there is one.
    pub fn at(&self, frame: usize) -> Option<[f64; 2]> {
        self.seen.get(frame.checked_sub(self.first)?).copied()
    }

    /// One more than the last frame in which the point is seen.
    pub fn end(&self) -> usize {
        self.first + self.seen.len()
    }
}

/// A track that has not ended.
struct Live {
    first: usize,
    seen: Vec<[f32; 2]>,
    /// Appearance at the anchor; positions are aligned to it so that errors do not add up.
    anchor: Template,
}

/// Follows corners through all frames; tracks are ordered by first frame, then by cell.
///
/// # Errors
///
/// [`SparseError::Cancelled`].
pub(crate) fn track(
    frames: &[&RgbImage],
    size: WorkingSize,
    progress: &dyn Progress,
) -> Result<Vec<RawTrack>, SparseError> {
    let pyramid = |frame: &RgbImage| Pyramid::new(luma(frame, size), LEVELS);
    let mut done: Vec<RawTrack> = Vec::new();
    let mut live: Vec<Live> = Vec::new();
    let mut previous: Option<Pyramid> = None;
    let finish = |t: Live| RawTrack {
        first: t.first,
        seen: t.seen.iter().map(|&p| size.centred(p)).collect(),
    };
    // Pyramids of a few frames are made side by side; tracking itself goes frame by frame.
    for (batch_index, batch) in frames.chunks(BATCH).enumerate() {
        let pyramids: Vec<Pyramid> = batch.par_iter().map(|f| pyramid(f)).collect();
        for (i, current) in pyramids.into_iter().enumerate() {
            let frame = batch_index * BATCH + i;
            stopped(progress)?;
            if let Some(previous) = &previous {
                let moved: Vec<Option<([f32; 2], Option<Template>)>> =
                    live.par_iter().map(|t| step(t, previous, &current)).collect();
                let mut kept = Vec::with_capacity(live.len());
                for (mut t, moved) in live.into_iter().zip(moved) {
                    match moved {
                        Some((p, anchor)) => {
                            t.seen.push(p);
                            if let Some(anchor) = anchor {
                                t.anchor = anchor;
                            }
                            kept.push(t);
                        }
                        None => done.push(finish(t)),
                    }
                }
                live = without_collisions(kept, &mut done, finish);
            }
            if frame + 1 < frames.len() {
                let occupied: Vec<[f32; 2]> = live.iter().filter_map(|t| t.seen.last().copied()).collect();
                let found = fill_empty_cells(&current.levels[0], &occupied, RADIUS + 1);
                live.extend(found.into_iter().filter_map(|p| {
                    Some(Live {
                        first: frame,
                        seen: vec![p],
                        anchor: Template::new(&current.levels[0], p, RADIUS)?,
                    })
                }));
            }
            previous = Some(current);
            progress.update("tracking", frame + 1, frames.len(), &format!("{} points", live.len()));
        }
    }
    done.extend(live.into_iter().map(finish));
    done.retain(|t| t.seen.len() >= 2);
    // Tracks end in an order that says nothing; their beginnings are a better one.
    done.sort_by(|a, b| {
        let key = |t: &RawTrack| (t.first, t.seen[0][1], t.seen[0][0]);
        key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal)
    });
    Ok(done)
}

/// Pyramids held at a time.
const BATCH: usize = 8;

/// The position of `t` in `to`, and a new anchor where the old one no longer looks alike.
fn step(t: &Live, from: &Pyramid, to: &Pyramid) -> Option<([f32; 2], Option<Template>)> {
    let p = *t.seen.last()?;
    let (mut q, correlation) = follow(from, to, p, RADIUS, ITERATIONS)?;
    if correlation < MIN_CORRELATION {
        return None;
    }
    let (back, _) = follow(to, from, q, RADIUS, ITERATIONS)?;
    if (back[0] - p[0]).hypot(back[1] - p[1]) > MAX_ROUND_TRIP_PX {
        return None;
    }
    let (held, likeness) = t.anchor.align(&to.levels[0], q, ITERATIONS);
    let drift = (held[0] - q[0]).hypot(held[1] - q[1]);
    let anchor = if likeness >= ANCHOR_CORRELATION && drift <= MAX_DRIFT_PX {
        q = held;
        None
    } else {
        Some(Template::new(&to.levels[0], q, RADIUS)?)
    };
    inside(&to.levels[0], q, RADIUS).then_some((q, anchor))
}

/// Where two tracks have run together the younger one ends.
fn without_collisions(mut tracks: Vec<Live>, done: &mut Vec<RawTrack>, finish: impl Fn(Live) -> RawTrack) -> Vec<Live> {
    let reach = 0.5 * MIN_DISTANCE_PX;
    // Oldest first: `live` is in order of birth already, since new tracks are appended.
    let mut buckets: std::collections::BTreeMap<(i32, i32), Vec<[f32; 2]>> = std::collections::BTreeMap::new();
    let mut kept = Vec::with_capacity(tracks.len());
    for mut t in tracks.drain(..) {
        let Some(&p) = t.seen.last() else { continue };
        let key = ((p[0] / reach) as i32, (p[1] / reach) as i32);
        let taken = (-1..=1).any(|dy| {
            (-1..=1).any(|dx| {
                buckets
                    .get(&(key.0 + dx, key.1 + dy))
                    .is_some_and(|near| near.iter().any(|q| (q[0] - p[0]).hypot(q[1] - p[1]) < reach))
            })
        });
        if taken {
            t.seen.pop();
            done.push(finish(t));
        } else {
            buckets.entry(key).or_default().push(p);
            kept.push(t);
        }
    }
    kept
}
