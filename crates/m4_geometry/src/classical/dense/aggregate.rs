//! Semi-global aggregation of a cost volume along eight directions (Hirschmueller 2008).

/// Penalty of a disparity step of one between neighbours, census bits (Hirschmueller 2008, P1).
const SMALL_STEP: i16 = 6;
/// Penalty of a larger step on a flat image, census bits (P2); divided by the brightness step, never below [`SMALL_STEP`].
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

/// The disparity of least aggregated cost a pixel, `[height][width]`: index into the range, with a fraction.
pub(super) fn aggregate(width: usize, height: usize, count: usize, volume: &[u8], grey: &[f32]) -> Vec<f32> {
    let mut total = vec![0i16; width * height * count];
    for downwards in [true, false] {
        pass(width, height, count, volume, grey, downwards, &mut total);
    }
    winner(count, &total)
}

/// Adds four directions: along the row, and from the three neighbours in the previous row.
fn pass(width: usize, height: usize, count: usize, volume: &[u8], grey: &[f32], downwards: bool, total: &mut [i16]) {
    let fresh = || Path { values: vec![FAR; count + 2], least: 0 };
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
            let step_back = |n: usize, size: usize| {
                if downwards { n.checked_sub(1) } else { (n + 1 < size).then_some(n + 1) }
            };
            let ahead = |n: usize, size: usize| {
                if downwards { (n + 1 < size).then_some(n + 1) } else { n.checked_sub(1) }
            };
            let large = |j: usize| {
                let fade = 1.0 / (1.0 + (grey[i] - grey[j]).abs() / EDGE);
                ((f32::from(LARGE_STEP) * fade) as i16).max(SMALL_STEP)
            };
            match step_back(x, width) {
                Some(px) => extend(cost, &left, SMALL_STEP, large(y * width + px), &mut here, out),
                None => extend(cost, &start, 0, 0, &mut here, out),
            }
            std::mem::swap(&mut left, &mut here);
            let py = step_back(y, height);
            let columns = [Some(x), step_back(x, width), ahead(x, width)];
            for (direction, column) in columns.into_iter().enumerate() {
                let target = &mut current[direction][x];
                match (py, column) {
                    (Some(py), Some(px)) => {
                        let p2 = large(py * width + px);
                        extend(cost, &before[direction][px], SMALL_STEP, p2, target, out);
                    }
                    _ => extend(cost, &start, 0, 0, target, out),
                }
            }
        }
        std::mem::swap(&mut before, &mut current);
    }
}

/// One step of equation 13: `cost + min(same, neighbour + p1, least + p2) - least`.
fn extend(cost: &[u8], from: &Path, p1: i16, p2: i16, to: &mut Path, total: &mut [i16]) {
    let n = cost.len();
    // A start holds FAR everywhere and a least of 0, so `least + p2` wins and the cost is plain.
    let jump = from.least + p2;
    let (down, same, up) = (&from.values[..n], &from.values[1..=n], &from.values[2..n + 2]);
    let values = &mut to.values[1..=n];
    let mut least = i16::MAX;
    for d in 0..n {
        let best = same[d].min(down[d] + p1).min(up[d] + p1).min(jump);
        let value = i16::from(cost[d]) + best - from.least;
        values[d] = value;
        total[d] += value;
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
            let (a, b, c) = (f32::from(cost[best - 1]), f32::from(least), f32::from(cost[best + 1]));
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
    use super::aggregate;

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
        let grey: Vec<f32> = (0..w * h).map(|i| if i % w < 6 { 20.0 } else { 220.0 }).collect();
        let mut volume = vec![20u8; w * h * n];
        for i in 0..w * h {
            volume[i * n + if i % w < 6 { 3 } else { 11 }] = 2;
        }
        let index = aggregate(w, h, n, &volume, &grey);
        for (i, k) in index.iter().enumerate() {
            let want = if i % w < 6 { 3.0 } else { 11.0 };
            assert!((k - want).abs() < 0.3, "pixel {i}: {k} where {want} was expected");
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
