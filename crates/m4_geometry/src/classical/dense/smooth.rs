//! Edge-aware smoothing and filling: the fast global smoother (Min et al. 2014).

/// Rounds of row and column solves. Min et al.: 3.
const ROUNDS: i32 = 3;
/// Least coupling of neighbours: values pass even the hardest edge, so that filling has no holes.
const LEAST_COUPLING: f32 = 1e-4;
/// Rows that are solved side by side: each is a chain of divisions, whose latency others fill.
const ROWS: usize = 8;

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
        let coupling: Vec<f32> = (0..256).map(|d| (-(d as f32) / sigma).exp().max(LEAST_COUPLING)).collect();
        let couple = |a: [u8; 3], b: [u8; 3]| {
            let d = a.iter().zip(&b).map(|(a, b)| a.abs_diff(*b)).fold(0, u8::max);
            coupling[usize::from(d)]
        };
        let (right, below) = couplings(width, height, |i, j| couple(guide[i], guide[j]));
        Self { width, height, right, below }
    }

    /// Approximately minimises `sum (u - f)^2 + lambda sum coupling (u_i - u_j)^2`.
    pub fn smooth(&self, values: &mut [f32], lambda: f32) {
        let (w, h) = (self.width, self.height);
        let mut ratio = vec![0.0f32; h.max(ROWS) * w];
        for round in 1..=ROUNDS {
            let l = 1.5 * 4f32.powi(ROUNDS - round) / (4f32.powi(ROUNDS) - 1.0) * lambda;
            let several = (values.chunks_mut(ROWS * w), self.right.chunks(ROWS * w));
            for (rows, right) in several.0.zip(several.1) {
                match rows.len() / w {
                    ROWS => solve_rows::<ROWS>(rows, right, l, &mut ratio),
                    _ => rows
                        .chunks_exact_mut(w)
                        .zip(right.chunks_exact(w))
                        .for_each(|(row, right)| solve_rows::<1>(row, right, l, &mut ratio)),
                }
            }
            self.solve_columns(values, l, &mut ratio);
        }
    }

    /// Weighted fill: values are averaged along the image with `weight`; returns the averages and how
    /// much weight reached each pixel.
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

    /// Weighted fill by planes: at each pixel the value of the plane that fits `values` with `weight` around it, as far as the image's edges let
    /// them pass (local regression). Slopes shrink to 0 where too little weight, too close together, determines them.
    pub fn planes(&self, values: &[f32], weight: &[f32], lambda: f32) -> Vec<f32> {
        /// Square of the noise of a value over the usual slope, pixels: a quarter of a step of the sweep against its range over the image.
        const NOISE_PX2: f32 = 2.0;
        let (w, unit) = (self.width, lambda.sqrt());
        let at = |p: usize| [(p % w) as f32 / unit, (p / w) as f32 / unit];
        let moment = |f: &dyn Fn([f32; 2], f32) -> f32| {
            let mut plane: Vec<f32> =
                weight.iter().zip(values).enumerate().map(|(p, (w, v))| w * f(at(p), *v)).collect();
            self.smooth(&mut plane, lambda);
            plane
        };
        let total = moment(&|_, _| 1.0);
        let [x, y, v] = [moment(&|p, _| p[0]), moment(&|p, _| p[1]), moment(&|_, v| v)];
        let [xx, xy, yy] = [moment(&|p, _| p[0] * p[0]), moment(&|p, _| p[0] * p[1]), moment(&|p, _| p[1] * p[1])];
        let [xv, yv] = [moment(&|p, v| p[0] * v), moment(&|p, v| p[1] * v)];
        let fit = |p: usize| {
            let total = total[p].max(1e-20);
            let mean = |sum: &[f32]| sum[p] / total;
            let ridge = NOISE_PX2 / (lambda * lambda * total);
            let (mx, my, mv) = (mean(&x), mean(&y), mean(&v));
            let (vx, vy) = ((mean(&xx) - mx * mx).max(0.0) + ridge, (mean(&yy) - my * my).max(0.0) + ridge);
            let cross = mean(&xy) - mx * my;
            let (cx, cy) = (mean(&xv) - mx * mv, mean(&yv) - my * mv);
            let determinant = (vx * vy - cross * cross).max(ridge * ridge);
            let [px, py] = at(p);
            mv + ((cx * vy - cy * cross) * (px - mx) + (cy * vx - cx * cross) * (py - my)) / determinant
        };
        (0..values.len()).map(fit).collect()
    }

    /// All columns at once, row by row: the Thomas algorithm with a row as its scalar.
    fn solve_columns(&self, u: &mut [f32], l: f32, ratio: &mut [f32]) {
        let (w, h) = (self.width, self.height);
        for y in 0..h {
            for x in 0..w {
                let i = y * w + x;
                let after = l * self.below[i];
                let (before, carried, above) =
                    if y > 0 { (l * self.below[i - w], ratio[i - w], u[i - w]) } else { (0.0, 0.0, 0.0) };
                let pivot = 1.0 / (1.0 + before + after - before * carried);
                ratio[i] = after * pivot;
                u[i] = (u[i] + before * above) * pivot;
            }
        }
        for y in (0..h.saturating_sub(1)).rev() {
            for x in 0..w {
                let i = y * w + x;
                u[i] += ratio[i] * u[i + w];
            }
        }
    }
}

/// `f` of every pixel and the next in its row, and of every pixel and the one below; 0 at the rim.
pub(super) fn couplings(width: usize, height: usize, f: impl Fn(usize, usize) -> f32) -> (Vec<f32>, Vec<f32>) {
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

/// Solves `(1 + l (c_before + c_after)) u - l c_before u_before - l c_after u_after = f` in place, in each of `N` rows.
fn solve_rows<const N: usize>(u: &mut [f32], right: &[f32], l: f32, ratio: &mut [f32]) {
    let w = u.len() / N;
    let (mut before, mut carried, mut last) = ([0.0; N], [0.0; N], [0.0; N]);
    for (x, ratio) in ratio.as_chunks_mut::<N>().0[..w].iter_mut().enumerate() {
        let after: [f32; N] = std::array::from_fn(|k| l * right[k * w + x]);
        let value: [f32; N] = std::array::from_fn(|k| u[k * w + x]);
        for k in 0..N {
            let pivot = 1.0 / (1.0 + before[k] + after[k] - before[k] * carried[k]);
            ratio[k] = after[k] * pivot;
            last[k] = (value[k] + before[k] * last[k]) * pivot;
        }
        (0..N).for_each(|k| u[k * w + x] = last[k]);
        (before, carried) = (after, *ratio);
    }
    for x in (0..w.saturating_sub(1)).rev() {
        let ratio = &ratio.as_chunks::<N>().0[x];
        for k in 0..N {
            last[k] = u[k * w + x] + ratio[k] * last[k];
            u[k * w + x] = last[k];
        }
    }
}

/// Mean over 5x5 pixels, fewer at the rim.
pub(super) fn box_blur(width: usize, height: usize, values: &mut [f32]) {
    const REACH: usize = 2;
    let reach = |i: usize, n: usize| i.saturating_sub(REACH)..(i + REACH + 1).min(n);
    let mut rows = vec![0.0f32; values.len()];
    for y in 0..height {
        let row = &values[y * width..(y + 1) * width];
        for (x, out) in rows[y * width..(y + 1) * width].iter_mut().enumerate() {
            let part = &row[reach(x, width)];
            *out = part.iter().sum::<f32>() / part.len() as f32;
        }
    }
    for y in 0..height {
        let window = reach(y, height);
        let share = 1.0 / window.len() as f32;
        let target = &mut values[y * width..(y + 1) * width];
        target.fill(0.0);
        for v in window {
            for (t, r) in target.iter_mut().zip(&rows[v * width..(v + 1) * width]) {
                *t += share * r;
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
        assert!((sum - 1.0).abs() < 1e-4 && dot[40] < 0.9, "{sum} {}", dot[40]);
    }

    #[test]
    fn planes_go_on_where_nothing_is_known() {
        let (w, h) = (40, 30);
        let smoother = Smoother::new(w, h, &vec![[90; 3]; w * h], 10.0);
        let slanted: Vec<f32> = (0..w * h).map(|p| 1.0 + 0.02 * (p % w) as f32 - 0.01 * (p / w) as f32).collect();
        let weight: Vec<f32> = (0..w * h).map(|p| f32::from(u8::from((10..30).contains(&(p % w))))).collect();
        let filled = smoother.planes(&slanted, &weight, 900.0);
        for (p, (found, expected)) in filled.iter().zip(&slanted).enumerate() {
            assert!((found - expected).abs() < 0.02, "pixel {}, {}: {found} instead of {expected}", p % w, p / w);
        }
        let flat = smoother.fill(&slanted, &weight, 900.0).0;
        assert!((flat[0] - slanted[0]).abs() > 0.1, "a constant fill is no plane");
    }

    #[test]
    fn values_fill_their_own_side_of_an_edge() {
        let (w, h) = (20, 8);
        let guide: Vec<[u8; 3]> = (0..w * h).map(|i| if i % w < 10 { [0; 3] } else { [200; 3] }).collect();
        let smoother = Smoother::new(w, h, &guide, 10.0);
        let (mut values, mut weight) = (vec![0.0; w * h], vec![0.0; w * h]);
        for (i, v) in [(3 * w + 2, 1.0), (5 * w + 17, 5.0)] {
            (values[i], weight[i]) = (v, 1.0);
        }
        let (filled, _) = smoother.fill(&values, &weight, 500.0);
        assert!((filled[7 * w + 8] - 1.0).abs() < 0.2, "{}", filled[7 * w + 8]);
        assert!((filled[11] - 5.0).abs() < 0.2, "{}", filled[11]);
    }
}
