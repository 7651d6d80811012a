//! Edge-aware smoothing and filling: the fast global smoother (Min et al. 2014).

use fearless_simd::Level;
use m4_core::dispatch;

/// Rounds of row and column solves. Min et al.: 3.
const ROUNDS: i32 = 3;
/// Least coupling of neighbours: values pass even the hardest edge, so that filling has no holes.
const LEAST_COUPLING: f32 = 1e-4;
/// Rows of a single plane that are solved side by side: each is a chain of divisions, whose latency
/// others fill.
const ROWS: usize = 8;
/// The same of several planes, which have work of their own to fill it with.
const ROWS_OF_SEVERAL: usize = 2;

/// The couplings of an image, ready to smooth several planes.
pub(crate) struct Smoother {
    width: usize,
    height: usize,
    /// Between a pixel and the next in its row; 0 in the last column.
    right: Vec<f32>,
    /// Between a pixel and the one below; 0 in the last row.
    below: Vec<f32>,
}

impl Smoother {
    /// `sigma`: the colour difference (0..255, largest channel) over which the coupling falls by e.
    pub fn new(width: usize, height: usize, guide: &[[u8; 3]], sigma: f32) -> Self {
        // One entry a possible colour difference.
        let coupling: Vec<f32> = (0..256)
            .map(|d| (-(d as f32) / sigma).exp().max(LEAST_COUPLING))
            .collect();
        let couple = |a: [u8; 3], b: [u8; 3]| {
            let d = a
                .iter()
                .zip(&b)
                .map(|(a, b)| a.abs_diff(*b))
                .fold(0, u8::max);
            coupling[usize::from(d)]
        };
        let (right, below) = couplings(width, height, |i, j| couple(guide[i], guide[j]));
        Self {
            width,
            height,
            right,
            below,
        }
    }

    /// Lets next to nothing pass between neighbours whose values differ by more than `limit`: two
    /// surfaces. A pixel that is not known (`weight`
    /// 0) is of the surface of the [nearest](Self::nearest) known one, so that a gap beside an edge
    ///    does not let its two sides mix.
    pub fn cut(&mut self, values: &[f32], weight: &[f32], limit: f32) {
        let nearest = self.nearest(values, weight);
        for (couplings, next) in [(&mut self.right, 1), (&mut self.below, self.width)] {
            for (i, coupling) in couplings.iter_mut().enumerate().filter(|(_, c)| **c > 0.0) {
                if (nearest[i] - nearest[i + next]).abs() > limit {
                    *coupling = LEAST_COUPLING;
                }
            }
        }
    }

    /// The value of the nearest known pixel along a way of like colours; `values` where nothing is
    /// known at all. Distances are approximate: two scans there and back (Rosenfeld and Pfaltz
    /// 1966).
    fn nearest(&self, values: &[f32], weight: &[f32]) -> Vec<f32> {
        /// What a step costs beside the difference of its colours, which is 1 for one sigma. A
        /// third and ten times of it gave like depth.
        const STEP: f32 = 0.1;
        const SCANS: usize = 2;
        let cost =
            |couplings: &[f32]| -> Vec<f32> { couplings.iter().map(|c| STEP - c.ln()).collect() };
        // infinite at the rim, where the coupling is 0
        let (right, below) = (cost(&self.right), cost(&self.below));
        let (w, n) = (self.width, values.len());
        let mut nearest = values.to_vec();
        let mut way: Vec<f32> = weight
            .iter()
            .map(|w| if *w > 0.0 { 0.0 } else { f32::INFINITY })
            .collect();
        let mut pass = |i: usize, from: usize, cost: f32| {
            if way[from] + cost < way[i] {
                (way[i], nearest[i]) = (way[from] + cost, nearest[from]);
            }
        };
        for _ in 0..SCANS {
            for i in 1..n {
                pass(i, i - 1, right[i - 1]);
                if i >= w {
                    pass(i, i - w, below[i - w]);
                }
            }
            for i in (0..n.saturating_sub(1)).rev() {
                pass(i, i + 1, right[i]);
                if i + w < n {
                    pass(i, i + w, below[i]);
                }
            }
        }
        nearest
    }

    /// Approximately minimises `sum (u - f)^2 + lambda sum coupling (u_i - u_j)^2`.
    pub fn smooth(&self, values: &mut [f32], lambda: f32) {
        self.solve::<ROWS, 1>(values.as_chunks_mut().0, lambda);
    }

    /// The same of `N` planes at once, `[height][width][N]`, in half the time: they share the
    /// pivots.
    fn smooth_several<const N: usize>(&self, values: &mut [[f32; N]], lambda: f32) {
        self.solve::<ROWS_OF_SEVERAL, N>(values, lambda);
    }

    fn solve<const M: usize, const N: usize>(&self, values: &mut [[f32; N]], lambda: f32) {
        // compiled for each set of vector instructions; the arithmetic is the same on all
        dispatch!(Level::new(), _s => self.solve_rounds::<M, N>(values, lambda));
    }

    #[inline(always)]
    fn solve_rounds<const M: usize, const N: usize>(&self, values: &mut [[f32; N]], lambda: f32) {
        let (w, h) = (self.width, self.height);
        let mut ratio = vec![0.0f32; h.max(M) * w];
        for round in 1..=ROUNDS {
            let l = 1.5 * 4f32.powi(ROUNDS - round) / (4f32.powi(ROUNDS) - 1.0) * lambda;
            for (rows, right) in values.chunks_mut(M * w).zip(self.right.chunks(M * w)) {
                if rows.len() == M * w {
                    solve_rows::<M, N>(rows, right, l, &mut ratio);
                } else {
                    let rows = rows.chunks_exact_mut(w).zip(right.chunks_exact(w));
                    rows.for_each(|(row, right)| solve_rows::<1, N>(row, right, l, &mut ratio));
                }
            }
            self.solve_columns(values, l, &mut ratio);
        }
    }

    /// Weighted fill: values are averaged along the image with `weight`; returns the averages and
    /// how much weight reached each pixel.
    pub fn fill(&self, values: &[f32], weight: &[f32], lambda: f32) -> (Vec<f32>, Vec<f32>) {
        let mut sum: Vec<f32> = values.iter().zip(weight).map(|(v, w)| v * w).collect();
        let mut reach = weight.to_vec();
        self.smooth(&mut sum, lambda);
        self.smooth(&mut reach, lambda);
        for (s, r) in sum.iter_mut().zip(&reach) {
            *s /= r.max(1e-20);
        }
        (sum, reach)
    }

    /// Weighted fill by planes: at each pixel the value of the plane that fits `values` with
    /// `weight` around it, as far as the image's edges let them pass (local regression). Slopes
    /// shrink to 0 where too little weight, too close together, determines them.
    pub fn planes(&self, values: &[f32], weight: &[f32], lambda: f32) -> Vec<f32> {
        /// Square of the noise of a value over the usual slope, pixels: a quarter of a step of the
        /// sweep against its range over the image.
        const NOISE_PX2: f32 = 2.0;
        let (w, unit) = (self.width, lambda.sqrt());
        let at = |p: usize| [(p % w) as f32 / unit, (p / w) as f32 / unit];
        let moments = |(p, (v, weight)): (usize, (&f32, &f32))| {
            let [x, y] = at(p);
            [1.0, x, y, *v, x * x, x * y, y * y, x * v, y * v].map(|moment| weight * moment)
        };
        let mut sums: Vec<[f32; 9]> = values.iter().zip(weight).enumerate().map(moments).collect();
        self.smooth_several(&mut sums, lambda);
        let fit = |(p, &[total, x, y, v, xx, xy, yy, xv, yv]): (usize, &[f32; 9])| {
            let total = total.max(1e-20);
            let [mx, my, mv, xx, xy, yy, xv, yv] =
                [x, y, v, xx, xy, yy, xv, yv].map(|sum| sum / total);
            let ridge = NOISE_PX2 / (lambda * lambda * total);
            let (vx, vy) = (
                (xx - mx * mx).max(0.0) + ridge,
                (yy - my * my).max(0.0) + ridge,
            );
            let cross = xy - mx * my;
            let (cx, cy) = (xv - mx * mv, yv - my * mv);
            let determinant = (vx * vy - cross * cross).max(ridge * ridge);
            let [px, py] = at(p);
            mv + ((cx * vy - cy * cross) * (px - mx) + (cy * vx - cx * cross) * (py - my))
                / determinant
        };
        sums.iter().enumerate().map(fit).collect()
    }

    /// All columns at once, row by row: the Thomas algorithm with a row as its scalar.
    #[inline(always)]
    fn solve_columns<const N: usize>(&self, u: &mut [[f32; N]], l: f32, ratio: &mut [f32]) {
        let w = self.width;
        let first = ratio[..w].iter_mut().zip(&mut u[..w]).zip(&self.below);
        for ((ratio, u), below) in first {
            let pivot = 1.0 / (1.0 + l * below);
            *ratio = l * below * pivot;
            u.iter_mut().for_each(|u| *u *= pivot);
        }
        for (y, below) in self.below.chunks_exact(w).enumerate().skip(1) {
            let (before, here) = (&self.below[(y - 1) * w..y * w], y * w..(y + 1) * w);
            let (carried, ratio) = ratio[..here.end].split_at_mut(here.start);
            let (above, u) = u[..here.end].split_at_mut(here.start);
            let (carried, above) = (&carried[here.start - w..], &above[here.start - w..]);
            let rows = ratio
                .iter_mut()
                .zip(u)
                .zip(carried)
                .zip(above)
                .zip(before)
                .zip(below);
            for (((((ratio, u), carried), above), before), below) in rows {
                let (before, after) = (l * before, l * below);
                let pivot = 1.0 / (1.0 + before + after - before * carried);
                *ratio = after * pivot;
                u.iter_mut()
                    .zip(above)
                    .for_each(|(u, above)| *u = (*u + before * above) * pivot);
            }
        }
        for y in (0..self.height.saturating_sub(1)).rev() {
            let (u, below) = u[y * w..].split_at_mut(w);
            for ((u, below), ratio) in u.iter_mut().zip(&*below).zip(&ratio[y * w..]) {
                u.iter_mut()
                    .zip(below)
                    .for_each(|(u, below)| *u += ratio * below);
            }
        }
    }
}

/// `f` of every pixel and the next in its row, and of every pixel and the one below; 0 at the rim.
pub(crate) fn couplings(
    width: usize,
    height: usize,
    f: impl Fn(usize, usize) -> f32,
) -> (Vec<f32>, Vec<f32>) {
    let (mut right, mut below) = (vec![0.0; width * height], vec![0.0; width * height]);
    for y in 0..height {
        let row = y * width..(y + 1) * width;
        for i in row.clone() {
            if i + 1 < row.end {
                right[i] = f(i, i + 1);
            }
            if y + 1 < height {
                below[i] = f(i, i + width);
            }
        }
    }
    (right, below)
}

/// Solves `(1 + l (c_before + c_after)) u - l c_before u_before - l c_after u_after = f` in place,
/// in each of `M` rows of `N` planes.
#[inline(always)]
fn solve_rows<const M: usize, const N: usize>(
    u: &mut [[f32; N]],
    right: &[f32],
    l: f32,
    ratio: &mut [f32],
) {
    let w = u.len() / M;
    let (mut before, mut carried, mut last) = ([0.0; M], [0.0; M], [[0.0; N]; M]);
    for (x, ratio) in ratio.as_chunks_mut::<M>().0[..w].iter_mut().enumerate() {
        let after: [f32; M] = std::array::from_fn(|k| l * right[k * w + x]);
        let value: [[f32; N]; M] = std::array::from_fn(|k| u[k * w + x]);
        for k in 0..M {
            let pivot = 1.0 / (1.0 + before[k] + after[k] - before[k] * carried[k]);
            ratio[k] = after[k] * pivot;
            last[k] = std::array::from_fn(|n| (value[k][n] + before[k] * last[k][n]) * pivot);
        }
        (0..M).for_each(|k| u[k * w + x] = last[k]);
        (before, carried) = (after, *ratio);
    }
    for x in (0..w.saturating_sub(1)).rev() {
        let ratio = &ratio.as_chunks::<M>().0[x];
        for k in 0..M {
            last[k] = std::array::from_fn(|n| u[k * w + x][n] + ratio[k] * last[k][n]);
            u[k * w + x] = last[k];
        }
    }
}

/// Mean over `SIDE` x `SIDE` pixels (odd), fewer at the rim.
pub(crate) fn box_blur<const SIDE: usize>(width: usize, height: usize, values: &mut [f32]) {
    dispatch!(Level::new(), _s => blur::<SIDE>(width, height, values));
}

#[inline(always)]
fn blur<const SIDE: usize>(width: usize, height: usize, values: &mut [f32]) {
    let far = SIDE / 2;
    let reach = |i: usize, n: usize| i.saturating_sub(far)..(i + far + 1).min(n);
    let mut rows = vec![0.0f32; values.len()];
    for (row, out) in values.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        if let Some(inside) = (width + 1).checked_sub(SIDE) {
            let shifted: [&[f32]; SIDE] = std::array::from_fn(|k| &row[k..k + inside]);
            for (x, out) in out[far..far + inside].iter_mut().enumerate() {
                *out = shifted.iter().map(|row| row[x]).sum::<f32>() / SIDE as f32;
            }
        }
        for x in (0..width).filter(|x| *x < far || x + far >= width) {
            let part = &row[reach(x, width)];
            out[x] = part.iter().sum::<f32>() / part.len() as f32;
        }
    }
    for (y, target) in values.chunks_exact_mut(width).enumerate() {
        let window = reach(y, height);
        let share = 1.0 / window.len() as f32;
        let row = |y: usize| &rows[y * width..(y + 1) * width];
        if window.len() == SIDE {
            let around: [&[f32]; SIDE] = std::array::from_fn(|k| row(window.start + k));
            for (x, t) in target.iter_mut().enumerate() {
                *t = share * around.iter().map(|row| row[x]).sum::<f32>();
            }
        } else {
            target.fill(0.0);
            for y in window {
                target
                    .iter_mut()
                    .zip(row(y))
                    .for_each(|(t, r)| *t += share * r);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Smoother;

    #[test]
    fn smoothing_preserves_constants_and_the_mean() {
        let (w, h) = (13, 9);
        let guide: Vec<[u8; 3]> = (0..w * h).map(|i| [(i * 37 % 101) as u8; 3]).collect();
        let smoother = Smoother::new(w, h, &guide, 20.0);
        let mut flat = vec![3.0; w * h];
        smoother.smooth(&mut flat, 100.0);
        assert!(flat.iter().all(|v| (v - 3.0).abs() < 1e-4));
        let mut dot = vec![0.0; w * h];
        dot[40] = 1.0;
        smoother.smooth(&mut dot, 100.0);
        let sum: f32 = dot.iter().sum();
        assert!(
            (sum - 1.0).abs() < 1e-4 && dot[40] < 0.9,
            "{sum} {}",
            dot[40]
        );
    }

    #[test]
    fn planes_go_on_where_nothing_is_known() {
        let (w, h) = (40, 30);
        let smoother = Smoother::new(w, h, &vec![[90; 3]; w * h], 10.0);
        let slanted: Vec<f32> = (0..w * h)
            .map(|p| 1.0 + 0.02 * (p % w) as f32 - 0.01 * (p / w) as f32)
            .collect();
        let weight: Vec<f32> = (0..w * h)
            .map(|p| f32::from(u8::from((10..30).contains(&(p % w)))))
            .collect();
        let filled = smoother.planes(&slanted, &weight, 900.0);
        for (p, (actual, expected)) in filled.iter().zip(&slanted).enumerate() {
            assert!(
                (actual - expected).abs() < 0.02,
                "pixel {}, {}: {actual} instead of {expected}",
                p % w,
                p / w
            );
        }
        let flat = smoother.fill(&slanted, &weight, 900.0).0;
        assert!(
            (flat[0] - slanted[0]).abs() > 0.1,
            "a constant fill is no plane"
        );
    }

    #[test]
    fn nothing_passes_between_two_surfaces_of_one_colour() {
        let (w, h) = (20, 8);
        let step: Vec<f32> = (0..w * h)
            .map(|p| if p % w < 10 { 1.0 } else { 2.0 })
            .collect();
        let weight = vec![1.0; w * h];
        let filled = |smoother: &Smoother| smoother.fill(&step, &weight, 100.0).0;
        let mut smoother = Smoother::new(w, h, &vec![[90; 3]; w * h], 10.0);
        assert!((filled(&smoother)[9] - 1.0).abs() > 0.2, "one surface");
        smoother.cut(&step, &weight, 0.5);
        assert!(
            filled(&smoother)
                .iter()
                .zip(&step)
                .all(|(actual, expected)| (actual - expected).abs() < 0.01)
        );
        // where nothing is known, nothing is cut
        let mut smoother = Smoother::new(w, h, &vec![[90; 3]; w * h], 10.0);
        smoother.cut(&vec![0.0; w * h], &vec![0.0; w * h], 0.5);
        assert!((filled(&smoother)[9] - 1.0).abs() > 0.2);
    }

    #[test]
    fn a_gap_belongs_to_the_side_of_its_colour() {
        let (w, h) = (24, 10);
        // known are columns 0 to 7, near, and 16 to 23, far; the colour changes at column 10
        let values: Vec<f32> = (0..w * h)
            .map(|p| if p % w < 12 { 2.0 } else { 1.0 })
            .collect();
        let weight: Vec<f32> = (0..w * h)
            .map(|p| f32::from(u8::from(!(8..16).contains(&(p % w)))))
            .collect();
        let guide: Vec<[u8; 3]> = (0..w * h)
            .map(|p| if p % w < 10 { [90; 3] } else { [115; 3] })
            .collect();
        let mut smoother = Smoother::new(w, h, &guide, 10.0);
        let mixed = smoother.fill(&values, &weight, 900.0).0;
        smoother.cut(&values, &weight, 0.5);
        let filled = smoother.fill(&values, &weight, 900.0).0;
        for (p, actual) in filled.iter().enumerate() {
            let expected = if p % w < 10 { 2.0 } else { 1.0 };
            assert!(
                (actual - expected).abs() < 0.02,
                "pixel {}, {}: {actual}",
                p % w,
                p / w
            );
        }
        assert!(
            mixed
                .iter()
                .enumerate()
                .any(|(p, v)| p % w >= 16 && (v - 1.0).abs() > 0.05),
            "the colour alone lets it mix"
        );
    }

    #[test]
    fn values_fill_their_own_side_of_an_edge() {
        let (w, h) = (20, 8);
        let guide: Vec<[u8; 3]> = (0..w * h)
            .map(|i| if i % w < 10 { [0; 3] } else { [200; 3] })
            .collect();
        let smoother = Smoother::new(w, h, &guide, 10.0);
        let (mut values, mut weight) = (vec![0.0; w * h], vec![0.0; w * h]);
        for (i, v) in [(3 * w + 2, 1.0), (5 * w + 17, 5.0)] {
            (values[i], weight[i]) = (v, 1.0);
        }
        let (filled, _) = smoother.fill(&values, &weight, 500.0);
        assert!(
            (filled[7 * w + 8] - 1.0).abs() < 0.2,
            "{}",
            filled[7 * w + 8]
        );
        assert!((filled[11] - 5.0).abs() < 0.2, "{}", filled[11]);
    }
}
