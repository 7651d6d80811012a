//! Points followed through the whole clip, from the strongest Shi-Tomasi corner of every empty
//! cell.

use super::anchor::{Anchor, Warp};
use super::klt::{RADIUS, follow, inside};
use super::luma::{Pyramid, WorkingSize, luma};
use super::{SparseError, stopped};
use m4_core::nalgebra::Matrix2;
use m4_core::{Plane, Progress, RgbImage};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A point followed to the next frame and back must return this close, working pixels. 0.7:
/// docs/spec/front-end.md 7.1.
const MAX_ROUND_TRIP_PX: f32 = 0.7;
/// Least normalised cross-correlation of a patch with itself one frame later.
const MIN_CORRELATION: f32 = 0.7;
/// Positions are aligned to the first appearance of the point while it correlates this much.
pub(super) const ANCHOR_CORRELATION: f32 = 0.85;
/// ... and while that moves the position by no more than this, working pixels.
const MAX_DRIFT_PX: f32 = 1.0;

/// One point followed through consecutive frames.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct RawTrack {
    pub first: usize,
    /// Working pixels from the image centre, one entry per frame.
    pub seen: Vec<[f64; 2]>,
    /// Frames after the end that show the point again, in order, and where; working pixels from the
    /// image centre.
    pub again: Vec<(usize, [f64; 2])>,
}

impl RawTrack {
    pub fn at(&self, frame: usize) -> Option<[f64; 2]> {
        self.seen.get(frame.checked_sub(self.first)?).copied()
    }

    /// One more than the last frame in which the point is seen.
    pub fn end(&self) -> usize {
        self.first + self.seen.len()
    }

    /// All positions with their frames, those after the end too.
    pub fn positions_mut(&mut self) -> impl Iterator<Item = (usize, &mut [f64; 2])> {
        let again = self.again.iter_mut().map(|(frame, at)| (*frame, at));
        (self.first..).zip(&mut self.seen).chain(again)
    }
}

/// A track that has not ended.
struct Live {
    first: usize,
    seen: Vec<[f32; 2]>,
    /// First appearance, or a later one where that no longer looks alike; positions are aligned to
    /// it so that errors do not add up.
    anchor: Anchor,
    /// From the anchor to the last frame.
    linear: Matrix2<f32>,
}

/// Follows corners through all frames; tracks are ordered by first frame, then by cell.
pub(crate) fn track(
    frames: &[&RgbImage],
    size: WorkingSize,
    progress: &dyn Progress,
) -> Result<Vec<RawTrack>, SparseError> {
    let mut done: Vec<RawTrack> = Vec::new();
    let mut live: Vec<Live> = Vec::new();
    let mut previous: Option<Pyramid> = None;
    let finish = |t: Live| RawTrack {
        first: t.first,
        seen: t.seen.iter().map(|&p| size.centred(p)).collect(),
        again: Vec::new(),
    };
    // Pyramids of a few frames are made side by side; tracking itself goes frame by frame.
    for (batch_index, batch) in frames.chunks(BATCH).enumerate() {
        let pyramids: Vec<Pyramid> = batch
            .par_iter()
            .map(|frame| Pyramid::new(luma(frame, size)))
            .collect();
        for (i, current) in pyramids.into_iter().enumerate() {
            let frame = batch_index * BATCH + i;
            stopped(progress)?;
            if let Some(previous) = &previous {
                let moved: Vec<Option<Step>> = live
                    .par_iter()
                    .map(|t| step(t, previous, &current))
                    .collect();
                let mut survivors = Vec::with_capacity(live.len());
                for (mut t, moved) in live.into_iter().zip(moved) {
                    let Some(Step { at, linear, anchor }) = moved else {
                        done.push(finish(t));
                        continue;
                    };
                    t.seen.push(at);
                    t.linear = linear;
                    t.anchor = anchor.unwrap_or(t.anchor);
                    survivors.push(t);
                }
                live = without_collisions(survivors, &mut done, finish);
            }
            if frame + 1 < frames.len() {
                let occupied: Vec<[f32; 2]> =
                    live.iter().filter_map(|t| t.seen.last().copied()).collect();
                let corners = fill_empty_cells(&current.levels[0], &occupied);
                live.extend(corners.into_iter().filter_map(|p| {
                    let anchor = Anchor::new(&current.fine, p)?;
                    Some(Live {
                        first: frame,
                        seen: vec![p],
                        anchor,
                        linear: Matrix2::identity(),
                    })
                }));
            }
            previous = Some(current);
            progress.update(
                "tracking",
                frame + 1,
                frames.len(),
                &format!("{} points", live.len()),
            );
        }
    }
    done.extend(live.into_iter().map(finish));
    done.retain(|t| t.seen.len() >= 2);
    // Tracks end in an order that says nothing; their beginnings are a better one.
    done.sort_by(|a, b| {
        let key = |t: &RawTrack| (t.first, t.seen[0][1], t.seen[0][0]);
        key(a)
            .partial_cmp(&key(b))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    Ok(done)
}

/// Pyramids held at a time.
const BATCH: usize = 8;

/// Where a track goes in the next frame.
struct Step {
    at: [f32; 2],
    linear: Matrix2<f32>,
    /// A new one where the old one no longer looks alike.
    anchor: Option<Anchor>,
}

/// The step of `t` to frame `to`; `None` where the point is lost.
fn step(t: &Live, from: &Pyramid, to: &Pyramid) -> Option<Step> {
    let p = *t.seen.last()?;
    let (q, correlation) = follow(&from.levels, &to.levels, p)?;
    if correlation < MIN_CORRELATION {
        return None;
    }
    let plane = &to.levels[0];
    let (held, likeness) = t.anchor.align(
        &to.fine,
        Warp {
            linear: t.linear,
            at: q,
        },
    );
    let drift = (held.at[0] - q[0]).hypot(held.at[1] - q[1]);
    if likeness >= ANCHOR_CORRELATION && drift <= MAX_DRIFT_PX {
        return inside(plane, held.at).then_some(Step {
            at: held.at,
            linear: held.linear,
            anchor: None,
        });
    }
    let (back, _) = follow(&to.levels, &from.levels, q)?;
    let returns = (back[0] - p[0]).hypot(back[1] - p[1]) <= MAX_ROUND_TRIP_PX;
    let anchor = Some(Anchor::new(&to.fine, q)?);
    (returns && inside(plane, q)).then_some(Step {
        at: q,
        linear: Matrix2::identity(),
        anchor,
    })
}

/// Where two tracks have run together the younger one ends.
fn without_collisions(
    tracks: Vec<Live>,
    done: &mut Vec<RawTrack>,
    finish: impl Fn(Live) -> RawTrack,
) -> Vec<Live> {
    let reach = 0.5 * MIN_DISTANCE_PX;
    // Oldest first: new tracks are appended.
    let mut buckets: BTreeMap<(i32, i32), Vec<[f32; 2]>> = BTreeMap::new();
    let mut survivors = Vec::with_capacity(tracks.len());
    for mut t in tracks {
        let Some(&p) = t.seen.last() else { continue };
        let key = ((p[0] / reach) as i32, (p[1] / reach) as i32);
        let occupied = (-1..=1).any(|dy| {
            (-1..=1).any(|dx| {
                buckets.get(&(key.0 + dx, key.1 + dy)).is_some_and(|near| {
                    near.iter()
                        .any(|q| (q[0] - p[0]).hypot(q[1] - p[1]) < reach)
                })
            })
        });
        if occupied {
            t.seen.pop();
            done.push(finish(t));
        } else {
            buckets.entry(key).or_default().push(p);
            survivors.push(t);
        }
    }
    survivors
}

/// Side of the cells that hold at least one track each, where there is texture, working pixels. 16
/// gives about 700 tracks on 480x360.
const CELL_PX: usize = 16;
/// New corners keep this distance from existing tracks, working pixels.
const MIN_DISTANCE_PX: f32 = 6.0;
/// Corners weaker than this share of the strongest one are not used. Shi and Tomasi use 0.01 to
/// 0.1; lower because cells already spread the corners.
const QUALITY: f32 = 0.001;
/// Corners with a lesser eigenvalue below this (squared grey levels) are noise.
const MIN_RESPONSE: f32 = 2.0;

/// The lesser eigenvalue of the mean structure tensor over 5x5 pixels, in squared grey levels per
/// pixel (Shi and Tomasi 1994); 0 within 3 pixels of the border.
fn response(luma: &Plane<f32>) -> Plane<f32> {
    const RADIUS: usize = 2;
    let (w, h) = luma.size();
    let mut out = Plane::filled(w, h, 0.0);
    let border = RADIUS + 1;
    if w <= 2 * border || h <= 2 * border {
        return out;
    }
    // Columns of the tensor summed over 5 rows, then over 5 columns.
    let gradient = |x: usize, y: usize| {
        let dx = 0.5 * (luma[(x + 1, y)] - luma[(x - 1, y)]);
        let dy = 0.5 * (luma[(x, y + 1)] - luma[(x, y - 1)]);
        [dx * dx, dx * dy, dy * dy]
    };
    let products: Vec<Vec<[f32; 3]>> = (1..h - 1)
        .map(|y| (1..w - 1).map(|x| gradient(x, y)).collect())
        .collect();
    let mut columns = vec![[0.0_f32; 3]; w - 2];
    for y in border..h - border {
        for (x, sum) in columns.iter_mut().enumerate() {
            *sum = [0.0; 3];
            for row in &products[y - 1 - RADIUS..y + RADIUS] {
                for k in 0..3 {
                    sum[k] += row[x][k];
                }
            }
        }
        let line = out.row_mut(y);
        for x in border..w - border {
            let mut t = [0.0_f32; 3];
            for column in &columns[x - 1 - RADIUS..x + RADIUS] {
                for k in 0..3 {
                    t[k] += column[k];
                }
            }
            let (mean, half_difference) = (0.5 * (t[0] + t[2]), 0.5 * (t[0] - t[2]));
            line[x] = (mean - (half_difference * half_difference + t[1] * t[1]).sqrt()) / 25.0;
        }
    }
    out
}

/// New corners in the cells that hold none of `occupied` (pixel coordinates), at least
/// [`MIN_DISTANCE_PX`] away from all of them, with their patches inside; in order of cells.
pub(crate) fn fill_empty_cells(luma: &Plane<f32>, occupied: &[[f32; 2]]) -> Vec<[f32; 2]> {
    const MARGIN: usize = RADIUS + 1;
    let (w, h) = luma.size();
    let response = response(luma);
    let (columns, rows) = (w.div_ceil(CELL_PX), h.div_ceil(CELL_PX));
    let cell = |p: [f32; 2]| {
        let along = |v: f32, n: usize| ((v.max(0.0) as usize) / CELL_PX).min(n - 1);
        along(p[1], rows) * columns + along(p[0], columns)
    };
    let mut cells: Vec<Vec<[f32; 2]>> = vec![Vec::new(); columns * rows];
    for &p in occupied {
        cells[cell(p)].push(p);
    }
    let strongest = response.data().iter().copied().fold(0.0_f32, f32::max);
    let threshold = (QUALITY * strongest).max(MIN_RESPONSE);
    let near = |cells: &[Vec<[f32; 2]>], p: [f32; 2], cx: usize, cy: usize| {
        (cy.saturating_sub(1)..(cy + 2).min(rows))
            .flat_map(|y| {
                (cx.saturating_sub(1)..(cx + 2).min(columns)).map(move |x| y * columns + x)
            })
            .any(|c| {
                cells[c]
                    .iter()
                    .any(|q| (q[0] - p[0]).hypot(q[1] - p[1]) < MIN_DISTANCE_PX)
            })
    };
    let mut corners = Vec::new();
    for cy in 0..rows {
        for cx in 0..columns {
            if !cells[cy * columns + cx].is_empty() {
                continue;
            }
            let mut best: Option<(f32, [f32; 2])> = None;
            for y in (cy * CELL_PX).max(MARGIN)..((cy + 1) * CELL_PX).min(h.saturating_sub(MARGIN))
            {
                for x in
                    (cx * CELL_PX).max(MARGIN)..((cx + 1) * CELL_PX).min(w.saturating_sub(MARGIN))
                {
                    let value = response[(x, y)];
                    let p = [x as f32, y as f32];
                    if value >= threshold
                        && best.is_none_or(|(b, _)| value > b)
                        && !near(&cells, p, cx, cy)
                    {
                        best = Some((value, p));
                    }
                }
            }
            if let Some((_, p)) = best {
                cells[cy * columns + cx].push(p);
                corners.push(p);
            }
        }
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::{fill_empty_cells, response, track};
    use crate::classical::sparse::luma::WorkingSize;
    use m4_core::{Plane, Silent};

    fn squares() -> Plane<f32> {
        Plane::from_fn(96, 96, |x, y| {
            if (x / 24 + y / 24) % 2 == 0 {
                30.0
            } else {
                200.0
            }
        })
    }

    #[test]
    fn corners_answer_and_edges_do_not() {
        let r = response(&squares());
        assert!(r[(24, 24)] > 100.0, "{}", r[(24, 24)]);
        assert!(r[(36, 24)] < 1e-2 && r[(36, 36)] < 1e-2);
    }

    #[test]
    fn occupied_cells_stay_as_they_are() {
        let all = fill_empty_cells(&squares(), &[]);
        assert!(all.len() >= 9, "{all:?}");
        assert!(fill_empty_cells(&squares(), &all).is_empty());
        let flat = Plane::filled(96, 96, 128.0);
        assert!(fill_empty_cells(&flat, &[]).is_empty());
    }

    /// A wall that the camera approaches and turns at: scale and rotation change by a third, a
    /// patch is soon unlike its first appearance.
    #[test]
    fn positions_do_not_drift_while_the_view_changes() {
        const FRAMES: usize = 30;
        let centre = [79.5_f64, 59.5];
        let view = |t: usize| {
            let (sine, cosine) = (0.012 * t as f64).sin_cos();
            (1.0 + 0.011 * t as f64, sine, cosine)
        };
        let at = |t: usize, u: [f64; 2]| {
            let (scale, s, c) = view(t);
            [
                centre[0] + scale * (c * u[0] - s * u[1]),
                centre[1] + scale * (s * u[0] + c * u[1]),
            ]
        };
        let back = |t: usize, p: [f64; 2]| {
            let (scale, s, c) = view(t);
            let d = [(p[0] - centre[0]) / scale, (p[1] - centre[1]) / scale];
            [c * d[0] + s * d[1], c * d[1] - s * d[0]]
        };
        let value = |u: [f64; 2]| {
            let wave = |a: f64, b: f64, c: f64| (a * u[0] + b * u[1] + c).sin();
            128.0
                + 40.0 * wave(0.35, 0.1, 0.3) * wave(-0.1, 0.4, 1.0)
                + 35.0 * wave(0.13, -0.17, 0.0)
                + 20.0 * wave(0.6, 0.5, 2.0)
        };
        let frames: Vec<_> = (0..FRAMES)
            .map(|t| {
                Plane::from_fn(160, 120, |x, y| {
                    [value(back(t, [x as f64, y as f64])) as u8; 3]
                })
            })
            .collect();
        let tracks = track(
            &frames.iter().collect::<Vec<_>>(),
            WorkingSize::new(160, 120, 640),
            &Silent,
        )
        .expect("tracks");
        let mut off: Vec<f64> = Vec::new();
        for t in tracks.iter().filter(|t| t.first == 0 && t.end() == FRAMES) {
            // Working pixels from the image centre.
            let pixel = |p: [f64; 2]| [p[0] + centre[0], p[1] + centre[1]];
            let want = at(FRAMES - 1, back(0, pixel(t.seen[0])));
            let got = pixel(t.seen[FRAMES - 1]);
            off.push((got[0] - want[0]).hypot(got[1] - want[1]));
        }
        off.sort_by(f64::total_cmp);
        assert!(off.len() >= 20, "{} tracks last", off.len());
        assert!(
            off[off.len() / 2] < 0.05,
            "median {} px",
            off[off.len() / 2]
        );
    }
}
