//! Places that the camera comes back to: points of early frames in frames long after their tracks
//! have ended.
//!
//! Frames spread over the clip are compared, each with all earlier ones whose tracks have ended, by
//! binary descriptors of their points (BRIEF, Calonder et al. 2010). The points of the frames that
//! match best are aligned to the later image to a fraction of a pixel, as in tracking. Cameras
//! decide later which of them are right (`loops`).

use super::anchor::{Anchor, Warp};
use super::klt::inside;
use super::luma::{Pyramid, WorkingSize, halvings, luma};
use super::rotation::spread;
use super::tracking::{ANCHOR_CORRELATION, RawTrack};
use super::{SparseError, stopped};
use m4_core::nalgebra::Matrix2;
use m4_core::{CounterRng, Plane, Progress, RgbImage};
use rayon::prelude::*;

/// Frames that are compared, each with each: half a second apart in a minute.
const COMPARED: usize = 120;
/// Two frames with more than this share of their tracks in common show one view, not a place again.
const COMMON: f64 = 0.02;
/// Fewest points that match in two frames of one place.
pub(super) const LEAST_MATCHES: usize = 20;
/// Earlier frames whose points are aligned to a later one, at most.
const MOST_EARLIER: usize = 3;
/// Words of 64 comparisons in a descriptor.
const WORDS: usize = 4;
/// Reach of a descriptor, pixels at half the working size: 25 working pixels from side to side.
const REACH: i32 = 6;
/// Most bits in which descriptors of one point differ.
const MOST_BITS: u32 = 64;
/// ... and at most this share of the bits by which the second best differs.
const RATIO: f64 = 0.8;
/// A point that is aligned moves by no more than this, working pixels: corners of two frames lie a
/// few pixels apart.
const MOST_SHIFT_PX: f32 = 6.0;
/// How often a patch is aligned, each time from the last warp: the view differs by more than in
/// tracking.
const ALIGNMENTS: usize = 3;

/// A point of a frame and what surrounds it.
struct Described {
    track: usize,
    /// Pixel of the working size.
    at: [f32; 2],
    bits: [u64; WORDS],
}

/// Adds to `tracks` where their points are in frames that show the place again.
pub(super) fn find(
    frames: &[&RgbImage],
    size: WorkingSize,
    tracks: &mut [RawTrack],
    progress: &dyn Progress,
) -> Result<(), SparseError> {
    const PHASE: &str = "places seen again";
    progress.update(PHASE, 0, 1, "");
    let compared = spread(frames.len(), COMPARED);
    let pattern = pattern();
    let described: Vec<Vec<Described>> = compared
        .par_iter()
        .map(|&frame| describe(&luma(frames[frame], size), size, tracks, frame, &pattern))
        .collect();
    stopped(progress)?;
    let earlier: Vec<Vec<usize>> = (0..compared.len())
        .into_par_iter()
        .map(|b| most_alike(&described, b))
        .collect();
    stopped(progress)?;
    let sightings: Vec<Vec<(usize, [f64; 2])>> = (0..compared.len())
        .into_par_iter()
        .map(|b| {
            let mut sightings = Vec::new();
            if earlier[b].is_empty() {
                return sightings;
            }
            let pyramid = |i: usize| Pyramid::new(luma(frames[compared[i]], size));
            let later = pyramid(b);
            for &a in &earlier[b] {
                sightings.extend(aligned(
                    &pyramid(a),
                    &later,
                    &matches(&described[a], &described[b]),
                    size,
                ));
            }
            // the first one of a track is from the frame that is most alike
            sightings.sort_by_key(|(track, _)| *track);
            sightings.dedup_by_key(|(track, _)| *track);
            sightings
        })
        .collect();
    let mut places = 0;
    for (&frame, sightings) in compared.iter().zip(sightings) {
        places += usize::from(!sightings.is_empty());
        for (track, at) in sightings {
            // one of the few tracks that last until then has its place already
            if frame >= tracks[track].end() {
                tracks[track].again.push((frame, at));
            }
        }
    }
    progress.update(PHASE, 1, 1, &format!("in {places} frames"));
    stopped(progress)
}

/// Pairs of places that a descriptor compares, pixels from the point.
fn pattern() -> Vec<[[i32; 2]; 2]> {
    let mut rng = CounterRng::new(0, 0, 0);
    let mut place = || {
        let reach = f64::from(REACH);
        [0.0; 2].map(|_: f64| (0.45 * reach * rng.normal()).round().clamp(-reach, reach) as i32)
    };
    (0..64 * WORDS).map(|_| [place(), place()]).collect()
}

fn describe(
    image: &Plane<f32>,
    size: WorkingSize,
    tracks: &[RawTrack],
    frame: usize,
    pattern: &[[[i32; 2]; 2]],
) -> Vec<Described> {
    let levels = halvings(image.clone());
    let small = &levels[levels.len().min(2) - 1];
    let (w, h) = (small.width() as i32, small.height() as i32);
    let unit = small.width() as f32 / image.width() as f32;
    let describe = |(track, t): (usize, &RawTrack)| {
        let at = size.pixel(t.at(frame)?);
        let [x, y] = at.map(|v| (v * unit).round() as i32);
        let within = x >= REACH && y >= REACH && x + REACH < w && y + REACH < h;
        let value = |[dx, dy]: [i32; 2]| small[((x + dx) as usize, (y + dy) as usize)];
        let word = |k: usize| {
            let pairs = pattern[64 * k..64 * (k + 1)].iter();
            pairs.fold(0, |word, [a, b]| {
                word << 1 | u64::from(value(*a) < value(*b))
            })
        };
        within.then(|| Described {
            track,
            at,
            bits: std::array::from_fn(word),
        })
    };
    tracks.iter().enumerate().filter_map(describe).collect()
}

/// The earlier frames that have most points in common with frame `b` although their tracks have
/// ended.
fn most_alike(described: &[Vec<Described>], b: usize) -> Vec<usize> {
    let later = &described[b];
    let mut alike: Vec<(usize, usize)> = (0..b)
        .filter_map(|a| {
            // both are in order of tracks
            let common = described[a]
                .iter()
                .filter(|p| later.binary_search_by_key(&p.track, |q| q.track).is_ok())
                .count();
            if common as f64 > COMMON * later.len() as f64 {
                return None;
            }
            let n = matches(&described[a], later).len();
            (n >= LEAST_MATCHES).then_some((n, a))
        })
        .collect();
    alike.sort_by_key(|&(n, a)| (std::cmp::Reverse(n), a));
    alike
        .into_iter()
        .take(MOST_EARLIER)
        .map(|(_, a)| a)
        .collect()
}

/// Points that are each other's most alike, clearly more so than the second.
fn matches<'a>(a: &'a [Described], b: &'a [Described]) -> Vec<(&'a Described, &'a Described)> {
    let bits = |p: &Described, q: &Described| -> u32 {
        p.bits
            .iter()
            .zip(&q.bits)
            .map(|(p, q)| (p ^ q).count_ones())
            .sum()
    };
    // of each of `b`: the fewest bits, and whose they are
    let mut back = vec![(u32::MAX, 0); b.len()];
    let forward: Vec<Option<usize>> = a
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let (mut best, mut second, mut at) = (u32::MAX, u32::MAX, 0);
            for (j, q) in b.iter().enumerate() {
                let n = bits(p, q);
                if n < back[j].0 {
                    back[j] = (n, i);
                }
                if n < best {
                    (best, second, at) = (n, best, j);
                } else {
                    second = second.min(n);
                }
            }
            (best <= MOST_BITS && f64::from(best) < RATIO * f64::from(second)).then_some(at)
        })
        .collect();
    let pairs = forward.into_iter().enumerate();
    pairs
        .filter_map(|(i, j)| j.filter(|&j| back[j].1 == i).map(|j| (&a[i], &b[j])))
        .collect()
}

/// Tracks of the earlier frame with their places in the later one, working pixels from the centre.
fn aligned(
    earlier: &Pyramid,
    later: &Pyramid,
    matches: &[(&Described, &Described)],
    size: WorkingSize,
) -> Vec<(usize, [f64; 2])> {
    let align = |(p, q): &(&Described, &Described)| {
        let anchor = Anchor::new(&earlier.fine, p.at)?;
        let mut warp = Warp {
            linear: Matrix2::identity(),
            at: q.at,
        };
        let mut likeness = 0.0;
        for _ in 0..ALIGNMENTS {
            (warp, likeness) = anchor.align(&later.fine, warp);
        }
        let shift = (warp.at[0] - q.at[0]).hypot(warp.at[1] - q.at[1]);
        let good = likeness >= ANCHOR_CORRELATION
            && shift <= MOST_SHIFT_PX
            && inside(&later.levels[0], warp.at);
        good.then(|| (p.track, size.centred(warp.at)))
    };
    let points: Vec<_> = matches.iter().filter_map(align).collect();
    if points.len() < LEAST_MATCHES {
        return Vec::new();
    }
    points
}

#[cfg(test)]
mod tests {
    use super::find;
    use crate::classical::sparse::luma::WorkingSize;
    use crate::classical::sparse::tracking::track;
    use m4_core::{Plane, RgbImage, Silent};

    const FRAMES: usize = 44;

    /// Where the left border of frame `t` is on the wall, pixels: there and back.
    fn border(t: usize) -> f64 {
        9.3 * t.min(FRAMES - 1 - t) as f64
    }

    /// Smooth noise in 0..=1 of which no two parts look alike, `cell` pixels wide.
    fn noise(u: f64, v: f64, cell: f64) -> f64 {
        let lattice = |i: f64, j: f64| {
            let h = ((i * 12.9898 + j * 78.233 + cell).sin() * 43_758.545_3).fract();
            h.abs()
        };
        let (i, j) = ((u / cell).floor(), (v / cell).floor());
        let soft = |t: f64| t * t * (3.0 - 2.0 * t);
        let (a, b) = (soft(u / cell - i), soft(v / cell - j));
        let row = |j: f64| lattice(i, j) * (1.0 - a) + lattice(i + 1.0, j) * a;
        row(j) * (1.0 - b) + row(j + 1.0) * b
    }

    fn wall(t: usize) -> RgbImage {
        Plane::from_fn(160, 120, |x, y| {
            let (u, v) = (x as f64 + border(t), y as f64);
            [(30.0 + 120.0 * noise(u, v, 7.0) + 80.0 * noise(u, v, 19.0)) as u8; 3]
        })
    }

    #[test]
    fn points_of_a_wall_are_found_again_on_the_way_back() {
        let frames: Vec<RgbImage> = (0..FRAMES).map(wall).collect();
        let frames: Vec<&RgbImage> = frames.iter().collect();
        let size = WorkingSize::new(160, 120, 640);
        let mut tracks = track(&frames, size, &Silent).expect("tracks");
        find(&frames, size, &mut tracks, &Silent).expect("sightings");
        let mut errors = Vec::new();
        for track in &tracks {
            for &(frame, at) in &track.again {
                assert!(frame >= track.end(), "{frame} within a track");
                let from = track.seen[0];
                let want = from[0] + border(track.first) - border(frame);
                errors.push((at[0] - want).hypot(at[1] - from[1]));
            }
        }
        errors.sort_by(f64::total_cmp);
        let n = errors.len();
        assert!(n >= 40, "{n} sightings");
        let [median, most] = [errors[n / 2], errors[9 * n / 10]];
        assert!(median < 0.1 && most < 1.0, "{median} {most}");
    }
}
