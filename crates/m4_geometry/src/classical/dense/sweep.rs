//! Plane sweep: what each disparity costs at each pixel, and the disparity of least cost in
//! agreement with the pixels around.

use super::shot::Pair;
use fearless_simd::Level;
use m4_core::dispatch;

/// Cost of a disparity that no partner can judge, in half bits: that of random signatures.
const UNKNOWN: u8 = 22;
/// Brightness differences up to this are not told apart, 0..255.
const FLAT: f32 = 1.0;

/// Evenly spaced disparities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Range {
    pub least: f32,
    pub step: f32,
    pub count: usize,
}

impl Range {
    pub fn at(&self, index: f32) -> f32 {
        self.least + index * self.step
    }
}

/// The 24 comparisons of a pixel with the rest of its 5x5 neighbourhood (Zabih and Woodfill 1994).
pub(super) fn census(width: usize, height: usize, grey: &[f32]) -> Vec<u32> {
    let mut out = vec![0u32; width * height];
    for dy in -2isize..=2 {
        for dx in -2isize..=2 {
            if (dx, dy) == (0, 0) {
                continue;
            }
            for y in 0..height {
                let other = y.saturating_add_signed(dy).min(height - 1) * width;
                let row = y * width;
                for x in 0..width {
                    let o = grey[other + x.saturating_add_signed(dx).min(width - 1)];
                    out[row + x] = (out[row + x] << 1) | u32::from(o > grey[row + x] + FLAT);
                }
            }
        }
    }
    out
}

/// One partner: how to get there and its signatures.
pub(super) struct Partner<'a> {
    pub pair: Pair,
    pub census: &'a [u32],
}

/// `[height][width][count]` in half bits: twice the mean number of differing bits over the better
/// half of the partners that see the point, so that what hides it from some does not matter.
pub(super) fn cost_volume(
    width: usize,
    height: usize,
    census: &[u32],
    partners: &[Partner<'_>],
    range: &Range,
) -> Vec<u8> {
    let mut volume = vec![UNKNOWN; width * height * range.count];
    let partners = &partners[..partners.len().min(MAX_PARTNERS)];
    let size = [width, height];
    // compiled for each set of vector instructions; the arithmetic is the same on all
    dispatch!(Level::new(), _s => match partners.len() {
        0 => (),
        1 => fill::<1>(size, census, partners, range, &mut volume),
        2 => fill::<2>(size, census, partners, range, &mut volume),
        3 => fill::<3>(size, census, partners, range, &mut volume),
        4 => fill::<4>(size, census, partners, range, &mut volume),
        5 => fill::<5>(size, census, partners, range, &mut volume),
        _ => fill::<MAX_PARTNERS>(size, census, partners, range, &mut volume),
    });
    volume
}

/// Partners beyond these are not used.
const MAX_PARTNERS: usize = 6;

/// The pixel of a place outside of an image.
const OUTSIDE: u32 = u32::MAX;

/// Rounds a number to the nearest integer; arbitrary from four million on. As fast as an addition,
/// where `as` goes number by number.
#[inline(always)]
fn nearest(x: f32) -> u32 {
    /// Floats are the integers from four million below to four million above.
    const INTEGERS: f32 = 12_582_912.0;
    (x + INTEGERS).to_bits().wrapping_sub(INTEGERS.to_bits())
}

/// The costs of all pixels with `N` partners.
#[inline(always)]
fn fill<const N: usize>(
    [width, height]: [usize; 2],
    census: &[u32],
    partners: &[Partner<'_>],
    range: &Range,
    volume: &mut [u8],
) {
    let count = range.count;
    let mut costs: [Vec<u8>; N] = std::array::from_fn(|_| vec![u8::MAX; count]);
    let steps: Vec<f32> = (0..count).map(|k| k as f32).collect();
    let mut pixels = vec![OUTSIDE; count];
    let (right, bottom, stride) = (width as f32 - 0.5, height as f32 - 0.5, width as u32);
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            let mine = census[i];
            for (costs, partner) in costs.iter_mut().zip(partners) {
                let b = partner.pair.b;
                let [qx, qy, qz] = partner.pair.ray(x as f32, y as f32);
                let (qx, qy, qz) = (
                    qx + range.least * b[0],
                    qy + range.least * b[1],
                    qz + range.least * b[2],
                );
                let (sx, sy, sz) = (range.step * b[0], range.step * b[1], range.step * b[2]);
                for (pixel, &k) in pixels.iter_mut().zip(&steps) {
                    let z = 1.0 / (qz + k * sz);
                    let (u, v) = ((qx + k * sx) * z, (qy + k * sy) * z);
                    let inside = (z > 0.0) & (u >= -0.5) & (v >= -0.5) & (u < right) & (v < bottom);
                    let at = nearest(v).wrapping_mul(stride).wrapping_add(nearest(u));
                    *pixel = if inside { at } else { OUTSIDE };
                }
                for (cost, &pixel) in costs.iter_mut().zip(&pixels) {
                    let theirs = partner.census.get(pixel as usize);
                    *cost = theirs.map_or(u8::MAX, |theirs| (mine ^ theirs).count_ones() as u8);
                }
            }
            let out = &mut volume[i * count..(i + 1) * count];
            let costs: [&[u8]; N] = std::array::from_fn(|n| &costs[n][..out.len()]);
            for (k, out) in out.iter_mut().enumerate() {
                *out = better_half::<N>(std::array::from_fn(|n| costs[n][k]));
            }
        }
    }
}

/// Twice the mean of the smaller half of `costs`, of six at most, among those that are not
/// `u8::MAX`; [`UNKNOWN`] if all are. Without branches.
#[inline(always)]
fn better_half<const N: usize>(costs: [u8; N]) -> u8 {
    // the three least, in order
    let (mut a, mut b, mut c, mut count) = (u8::MAX, u8::MAX, u8::MAX, 0u8);
    for cost in costs {
        let (not_a, not_b) = (a.max(cost), b.max(a.max(cost)));
        (a, b, c) = (a.min(cost), b.min(not_a), c.min(not_b));
        count += u8::from(cost != u8::MAX);
    }
    let [one, two, three] = [
        u16::from(a),
        u16::from(a) + u16::from(b),
        u16::from(a) + u16::from(b) + u16::from(c),
    ];
    // the half of 1 or 2, of 3 or 4, of 5 or 6 partners
    let mean = if count <= 2 { 2 * one } else { two };
    let mean = if count <= 4 { mean } else { 2 * three / 3 };
    if count == 0 { UNKNOWN } else { mean as u8 }
}

/// Penalty of a disparity step of one between neighbours, census bits (Hirschmueller 2008, P1).
const SMALL_STEP: i16 = 6;
/// Penalty of a larger step on a flat image, census bits (P2); divided by the brightness step,
/// never below [`SMALL_STEP`].
const LARGE_STEP: i16 = 40;
/// Brightness step that halves the large penalty, 0..255.
const EDGE: f32 = 10.0;
/// Above every path cost, and small enough to have a penalty added.
const FAR: i16 = 8000;

struct Path {
    /// One value a disparity, with one of `FAR` on either side.
    values: Vec<i16>,
    least: i16,
}

/// Semi-global aggregation along eight directions (Hirschmueller 2008): the disparity of least
/// aggregated cost a pixel, `[height][width]`: index into the range, with a fraction.
pub(super) fn aggregate(
    width: usize,
    height: usize,
    count: usize,
    volume: &[u8],
    grey: &[f32],
) -> Vec<f32> {
    let mut total = vec![0i16; width * height * count];
    dispatch!(Level::new(), _s => pass::<true>(width, height, count, volume, grey, &mut total));
    dispatch!(Level::new(), _s => pass::<false>(width, height, count, volume, grey, &mut total));
    winner(count, &total)
}

/// Adds four directions: along the row, and from the three neighbours in the previous row. The pass
/// downwards comes first: it sets the total without reading it, since memory that is read before it
/// is written costs an interrupt of every core for each page.
#[inline(always)]
fn pass<const DOWNWARDS: bool>(
    width: usize,
    height: usize,
    count: usize,
    volume: &[u8],
    grey: &[f32],
    total: &mut [i16],
) {
    let downwards = DOWNWARDS;
    let fresh = || Path {
        values: vec![FAR; count + 2],
        least: 0,
    };
    let rows = |n: usize| (0..n).map(|_| fresh()).collect::<Vec<Path>>();
    // [direction][column]; the row before and the row being made.
    let mut before: [Vec<Path>; 3] = std::array::from_fn(|_| rows(width));
    let mut current: [Vec<Path>; 3] = std::array::from_fn(|_| rows(width));
    let (mut left, mut here) = (fresh(), fresh());
    let start = fresh();
    for k in 0..height {
        let y = if downwards { k } else { height - 1 - k };
        for m in 0..width {
            let x = if downwards { m } else { width - 1 - m };
            let i = y * width + x;
            let cost = &volume[i * count..(i + 1) * count];
            let out = &mut total[i * count..(i + 1) * count];
            let beside = |n: usize, size: usize, back: bool| {
                if back {
                    n.checked_sub(1)
                } else {
                    (n + 1 < size).then_some(n + 1)
                }
            };
            let before_x = beside(x, width, downwards);
            let large = |j: usize| {
                let fade = 1.0 / (1.0 + (grey[i] - grey[j]).abs() / EDGE);
                ((f32::from(LARGE_STEP) * fade) as i16).max(SMALL_STEP)
            };
            match before_x {
                Some(px) => extend::<DOWNWARDS>(
                    cost,
                    &left,
                    SMALL_STEP,
                    large(y * width + px),
                    &mut here,
                    out,
                ),
                None => extend::<DOWNWARDS>(cost, &start, 0, 0, &mut here, out),
            }
            std::mem::swap(&mut left, &mut here);
            let py = beside(y, height, downwards);
            let columns = [Some(x), before_x, beside(x, width, !downwards)];
            for (direction, column) in columns.into_iter().enumerate() {
                let target = &mut current[direction][x];
                match (py, column) {
                    (Some(py), Some(px)) => {
                        let p2 = large(py * width + px);
                        extend::<false>(cost, &before[direction][px], SMALL_STEP, p2, target, out);
                    }
                    _ => extend::<false>(cost, &start, 0, 0, target, out),
                }
            }
        }
        std::mem::swap(&mut before, &mut current);
    }
}

/// One step of equation 13: `cost + min(same, neighbour + p1, least + p2) - least`; sets or adds to
/// the total.
#[inline(always)]
fn extend<const SETS: bool>(
    cost: &[u8],
    from: &Path,
    p1: i16,
    p2: i16,
    to: &mut Path,
    total: &mut [i16],
) {
    let n = cost.len();
    // A start holds FAR everywhere and a least of 0, so `least + p2` wins and the cost is plain.
    let jump = from.least + p2;
    let (down, same, up) = (
        &from.values[..n],
        &from.values[1..=n],
        &from.values[2..n + 2],
    );
    let values = &mut to.values[1..=n];
    let mut least = i16::MAX;
    for d in 0..n {
        let best = same[d].min(down[d] + p1).min(up[d] + p1).min(jump);
        let value = i16::from(cost[d]) + best - from.least;
        values[d] = value;
        total[d] = if SETS { value } else { total[d] + value };
        least = least.min(value);
    }
    to.least = least;
}

fn winner(count: usize, total: &[i16]) -> Vec<f32> {
    let one = |cost: &[i16]| {
        let (mut best, mut least) = (0, i16::MAX);
        for (d, &c) in cost.iter().enumerate() {
            if c < least {
                (best, least) = (d, c);
            }
        }
        let mut index = best as f32;
        if best > 0 && best + 1 < count {
            // The vertex of the parabola through the three costs.
            let (a, b, c) = (
                f32::from(cost[best - 1]),
                f32::from(least),
                f32::from(cost[best + 1]),
            );
            let bend = a + c - 2.0 * b;
            if bend > 0.0 {
                index += (0.5 * (a - c) / bend).clamp(-0.5, 0.5);
            }
        }
        index
    };
    total.chunks_exact(count).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::{
        MAX_PARTNERS, Pair, Partner, Range, UNKNOWN, aggregate, better_half, census, cost_volume,
    };
    use m4_core::CounterRng;

    #[test]
    fn a_signature_ignores_brightness_and_contrast() {
        let image: Vec<f32> = (0..20 * 15).map(|i| (i * 7919 % 97) as f32).collect();
        let brighter: Vec<f32> = image.iter().map(|v| 2.0 * v + 20.0).collect();
        let (a, b) = (census(20, 15, &image), census(20, 15, &brighter));
        let differing: u32 = a.iter().zip(&b).map(|(a, b)| (a ^ b).count_ones()).sum();
        // Steps of exactly one are told apart only when they are doubled.
        assert!(differing < 300 * 24 / 50, "{differing}");
        assert!(census(20, 15, &vec![5.0; 300]).iter().all(|&c| c == 0));
    }

    #[test]
    fn partners_that_do_not_see_a_point_do_not_count() {
        const NONE: u8 = u8::MAX;
        assert_eq!(better_half([2, 20, 4, 19]), 6);
        assert_eq!(better_half([NONE, 20, 4, NONE]), 8);
        assert_eq!(better_half([NONE; 4]), UNKNOWN);
        assert_eq!(better_half([7]), 14);
        assert_eq!(better_half([24, 5, 6, NONE, 7, 24]), 12);
    }

    /// What [`super::cost_volume`] says of one pixel and disparity, by its definition.
    fn cost(
        size: [usize; 2],
        census: &[u32],
        partners: &[Partner<'_>],
        at: [usize; 2],
        disparity: f32,
    ) -> u8 {
        let [w, h] = size;
        let mut costs: Vec<u32> = partners
            .iter()
            .filter_map(|partner| {
                let p = partner.pair.project(at[0] as f32, at[1] as f32, disparity);
                let (u, v) = ((p.x + 0.5).floor(), (p.y + 0.5).floor());
                let inside =
                    p.disparity > 0.0 && u >= 0.0 && v >= 0.0 && u < w as f32 && v < h as f32;
                inside.then(|| {
                    (census[at[1] * w + at[0]] ^ partner.census[v as usize * w + u as usize])
                        .count_ones()
                })
            })
            .collect();
        costs.sort_unstable();
        let half = costs.len().div_ceil(2);
        if half == 0 {
            UNKNOWN
        } else {
            (2 * costs[..half].iter().sum::<u32>() / half as u32) as u8
        }
    }

    #[test]
    fn costs_are_those_of_the_definition_for_every_number_of_partners() {
        let (w, h) = (31, 17);
        let mut rng = CounterRng::new(7, 0, 0);
        let mut signatures =
            || -> Vec<u32> { (0..w * h).map(|_| rng.below(1 << 24) as u32).collect() };
        let own = signatures();
        let others: Vec<Vec<u32>> = (0..MAX_PARTNERS).map(|_| signatures()).collect();
        // a shift of 3 and -2 pixels per unit of disparity, and a camera that also goes ahead
        let pair = |n: usize| Pair {
            a: [[1.0, 0.0, 0.2371], [0.0, 1.0, 0.3117], [0.0, 0.0, 1.0]],
            b: [
                3.0 - n as f32,
                n as f32 - 2.0,
                if n.is_multiple_of(2) { 0.0 } else { -0.2 },
            ],
        };
        let partners: Vec<Partner<'_>> = others
            .iter()
            .enumerate()
            .map(|(n, census)| Partner {
                pair: pair(n),
                census,
            })
            .collect();
        let range = Range {
            least: 0.5,
            step: 0.5,
            count: 19,
        };
        let mut unknown = 0;
        for n in 0..=MAX_PARTNERS {
            let volume = cost_volume(w, h, &own, &partners[..n], &range);
            for (i, &actual) in volume.iter().enumerate() {
                let (k, p) = (i % range.count, i / range.count);
                let wanted = cost(
                    [w, h],
                    &own,
                    &partners[..n],
                    [p % w, p / w],
                    range.at(k as f32),
                );
                assert_eq!(actual, wanted, "{n} partners, pixel {p}, disparity {k}");
                unknown += usize::from(n == MAX_PARTNERS && actual == UNKNOWN);
            }
        }
        assert!(unknown < w * h * range.count / 2, "{unknown}");
    }

    #[test]
    fn neighbours_outvote_a_wrong_pixel() {
        let (w, h, n) = (9, 7, 16);
        let mut volume = vec![20u8; w * h * n];
        for i in 0..w * h {
            volume[i * n + 5] = 4;
        }
        let odd = 3 * w + 4;
        volume[odd * n + 5] = 8;
        volume[odd * n + 12] = 2;
        let index = aggregate(w, h, n, &volume, &vec![100.0; w * h]);
        assert!(index.iter().all(|&k| (k - 5.0).abs() < 0.01), "{index:?}");
    }

    #[test]
    fn a_step_at_an_edge_stays() {
        let (w, h, n) = (12, 8, 16);
        let grey: Vec<f32> = (0..w * h)
            .map(|i| if i % w < 6 { 20.0 } else { 220.0 })
            .collect();
        let mut volume = vec![20u8; w * h * n];
        for i in 0..w * h {
            volume[i * n + if i % w < 6 { 3 } else { 11 }] = 2;
        }
        let index = aggregate(w, h, n, &volume, &grey);
        for (i, k) in index.iter().enumerate() {
            let want = if i % w < 6 { 3.0 } else { 11.0 };
            assert!(
                (k - want).abs() < 0.3,
                "pixel {i}: {k} where {want} was expected"
            );
        }
    }

    #[test]
    fn fractions_come_from_the_parabola() {
        let volume: Vec<u8> = [9u8, 4, 1, 2, 8].to_vec();
        let index = aggregate(1, 1, 5, &volume, &[0.0]);
        // (4 - 2) / (4 + 2 - 2) / 2 past the least.
        assert!((index[0] - 2.25).abs() < 1e-6, "{}", index[0]);
    }
}
