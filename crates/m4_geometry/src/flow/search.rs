//! Images at halving sizes, and inverse search: each patch of the first image is aligned to the
//! second by Gauss-Newton with the Hessian of the first (Kroeger et al. 2016, section 2.1), then
//! patches are averaged (section 2.2).

use m4_core::Flow;

/// Side of a patch, pixels. Kroeger et al. and the specification: 8.
const PATCH_PX: usize = 8;
/// Distance of patches, pixels. Specification: 4.
const STRIDE_PX: usize = 4;
/// Gauss-Newton steps per patch and level. Kroeger et al.: 12.
const ITERATIONS: usize = 12;
/// A step shorter than this ends the search, pixels.
const SMALL_STEP_PX: f32 = 0.01;

/// Pixels of replicated border on every side: a patch may leave the image by this much.
const BORDER: usize = 16;

pub(super) struct Level {
    pub width: usize,
    pub height: usize,
    /// `[height][width]`, 0..255.
    pub image: Vec<f32>,
    /// `[height + 2 BORDER][width + 2 BORDER]`.
    padded: Vec<f32>,
    /// `[height][width]`: central differences.
    pub dx: Vec<f32>,
    pub dy: Vec<f32>,
}

/// The image at halving sizes, finest first, until its shorter side is below 24 px.
pub(super) fn pyramid(width: usize, height: usize, image: &[f32]) -> Vec<Level> {
    let mut levels = vec![Level::new(width, height, smooth(width, height, image))];
    while let Some(last) = levels.last() {
        let (w, h) = (last.width / 2, last.height / 2);
        if w.min(h) < 12 {
            break;
        }
        let mean = |i: usize| {
            let (p, i) = (&last.image, 2 * (i / w) * last.width + 2 * (i % w));
            0.25 * (p[i] + p[i + 1] + p[i + last.width] + p[i + last.width + 1])
        };
        levels.push(Level::new(w, h, (0..w * h).map(mean).collect()));
    }
    levels
}

/// A 1-6-1 blur each way: enough to make central differences meaningful.
fn smooth(width: usize, height: usize, image: &[f32]) -> Vec<f32> {
    let pass = |source: &[f32], step: usize, at: &dyn Fn(usize) -> (usize, usize)| -> Vec<f32> {
        (0..source.len())
            .map(|i| {
                let (position, n) = at(i);
                let before = if position > 0 {
                    source[i - step]
                } else {
                    source[i]
                };
                let after = if position + 1 < n {
                    source[i + step]
                } else {
                    source[i]
                };
                0.125 * (before + after) + 0.75 * source[i]
            })
            .collect()
    };
    let rows = pass(image, 1, &|i| (i % width, width));
    pass(&rows, width, &|i| (i / width, height))
}

impl Level {
    fn new(width: usize, height: usize, image: Vec<f32>) -> Self {
        let padded_width = width + 2 * BORDER;
        let mut padded = vec![0.0; padded_width * (height + 2 * BORDER)];
        for (y, row) in padded.chunks_exact_mut(padded_width).enumerate() {
            let source = y.saturating_sub(BORDER).min(height - 1) * width;
            let source = &image[source..source + width];
            row[..BORDER].fill(source[0]);
            row[BORDER..BORDER + width].copy_from_slice(source);
            row[BORDER + width..].fill(source[width - 1]);
        }
        let (dx, dy) = gradient(width, height, &image);
        Self {
            width,
            height,
            image,
            padded,
            dx,
            dy,
        }
    }
}

/// Central differences, one-sided halves at the edge.
pub(super) fn gradient(width: usize, height: usize, image: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let (mut dx, mut dy) = (vec![0.0; image.len()], vec![0.0; image.len()]);
    for y in 0..height {
        let (above, below) = (y.saturating_sub(1) * width, (y + 1).min(height - 1) * width);
        let row = y * width;
        for x in 0..width {
            dx[row + x] =
                0.5 * (image[row + (x + 1).min(width - 1)] - image[row + x.saturating_sub(1)]);
            dy[row + x] = 0.5 * (image[below + x] - image[above + x]);
        }
    }
    (dx, dy)
}

struct Patch {
    x: usize,
    y: usize,
    /// Inverse of the Hessian; `None` where the patch is too flat to be aligned.
    inverse: Option<[f32; 3]>,
    /// Sums of the gradient: brightness offsets are projected out.
    sum: [f32; 2],
}

struct Search<'a> {
    a: &'a Level,
    b: &'a Level,
    difference: [[f32; PATCH_PX]; PATCH_PX],
}

/// Where patches begin along a side of `n` pixels, at least [`PATCH_PX`].
fn positions(n: usize) -> Vec<usize> {
    let last = n - PATCH_PX;
    let mut out: Vec<usize> = (0..=last).step_by(STRIDE_PX).collect();
    if !last.is_multiple_of(STRIDE_PX) {
        out.push(last);
    }
    out
}

/// The flow of `start` after inverse search; as it is where the images are smaller than a patch.
#[inline(always)]
pub(super) fn search(a: &Level, b: &Level, start: Flow) -> Flow {
    if a.width.min(a.height) < PATCH_PX {
        return start;
    }
    let (xs, ys) = (positions(a.width), positions(a.height));
    let mut search = Search {
        a,
        b,
        difference: [[0.0; PATCH_PX]; PATCH_PX],
    };
    let patches: Vec<Patch> = ys
        .iter()
        .flat_map(|&y| xs.iter().map(move |&x| (x, y)))
        .map(|(x, y)| Patch::new(a, x, y))
        .collect();
    let centre = (PATCH_PX / 2) as f32 - 0.5;
    let mut flow: Vec<[f32; 2]> = patches
        .iter()
        .map(|p| {
            let (u, v) = start.at(p.x as f32 + centre, p.y as f32 + centre);
            [u, v]
        })
        .collect();
    let initial = flow.clone();
    let mut cost: Vec<f32> = patches
        .iter()
        .zip(&flow)
        .map(|(p, &f)| search.cost(p, f))
        .collect();
    let columns = xs.len();
    // Forwards, candidates from left and above; then backwards, from right and below.
    for backwards in [false, true] {
        for k in 0..patches.len() {
            let i = if backwards { patches.len() - 1 - k } else { k };
            let (column, row) = (i % columns, i / columns);
            let neighbours = if backwards {
                [
                    (column + 1 < columns).then(|| i + 1),
                    (row + 1 < ys.len()).then(|| i + columns),
                ]
            } else {
                [(column > 0).then(|| i - 1), (row > 0).then(|| i - columns)]
            };
            let mut improved = !backwards;
            for j in neighbours.into_iter().flatten() {
                let c = search.cost(&patches[i], flow[j]);
                if c < cost[i] {
                    (flow[i], cost[i], improved) = (flow[j], c, true);
                }
            }
            if improved {
                let candidate = search.descend(&patches[i], flow[i]);
                let moved = (candidate[0] - initial[i][0]).hypot(candidate[1] - initial[i][1]);
                let c = search.cost(&patches[i], candidate);
                if c < cost[i] && moved < 2.0 * PATCH_PX as f32 {
                    (flow[i], cost[i]) = (candidate, c);
                }
            }
        }
    }
    average(&mut search, &patches, &flow)
}

/// A row of a patch that begins at `from`.
#[inline(always)]
fn row<const N: usize>(plane: &[f32], from: usize) -> &[f32; N] {
    plane[from..]
        .first_chunk()
        .expect("patches lie inside of their planes")
}

/// Sums of the lanes, in pairs.
#[inline(always)]
fn total(lanes: [f32; PATCH_PX]) -> f32 {
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

impl Patch {
    #[inline(always)]
    fn new(a: &Level, x: usize, y: usize) -> Self {
        // lane by lane
        let mut sums = [[0.0f32; PATCH_PX]; 5];
        for j in 0..PATCH_PX {
            let from = (y + j) * a.width + x;
            let (dx, dy): (&[f32; PATCH_PX], &[f32; PATCH_PX]) =
                (row(&a.dx, from), row(&a.dy, from));
            for i in 0..PATCH_PX {
                let (gx, gy) = (dx[i], dy[i]);
                for (sum, add) in sums.iter_mut().zip([gx * gx, gx * gy, gy * gy, gx, gy]) {
                    sum[i] += add;
                }
            }
        }
        let [xx, xy, yy, sx, sy] = sums.map(total);
        let n = (PATCH_PX * PATCH_PX) as f32;
        let (xx, xy, yy) = (xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n);
        // A little of the trace keeps the step along an edge finite.
        let damp = 0.01 * (xx + yy) + 1e-3 * n;
        let det = (xx + damp) * (yy + damp) - xy * xy;
        let inverse =
            (xx + yy > 0.5 * n).then(|| [(yy + damp) / det, -xy / det, (xx + damp) / det]);
        Self {
            x,
            y,
            inverse,
            sum: [sx, sy],
        }
    }
}

impl Search<'_> {
    /// Fills `difference` with `b(x + f) - a(x)` and returns its mean.
    #[inline(always)]
    fn sample(&mut self, patch: &Patch, f: [f32; 2]) -> f32 {
        let b = self.b;
        let stride = b.width + 2 * BORDER;
        let limit = |v: f32, n: usize| {
            v.max(0.0)
                .min((n + 2 * BORDER - PATCH_PX - 1) as f32 - 1e-3)
        };
        let x = limit(patch.x as f32 + f[0] + BORDER as f32, b.width);
        let y = limit(patch.y as f32 + f[1] + BORDER as f32, b.height);
        let (ix, iy) = (x as usize, y as usize);
        let (fx, fy) = (x - ix as f32, y - iy as f32);
        let (w00, w10) = ((1.0 - fx) * (1.0 - fy), fx * (1.0 - fy));
        let (w01, w11) = ((1.0 - fx) * fy, fx * fy);
        let mut sums = [0.0f32; PATCH_PX];
        for j in 0..PATCH_PX {
            let top: &[f32; PATCH_PX + 1] = row(&b.padded, (iy + j) * stride + ix);
            let bottom: &[f32; PATCH_PX + 1] = row(&b.padded, (iy + j + 1) * stride + ix);
            let a: &[f32; PATCH_PX] = row(&self.a.image, (patch.y + j) * self.a.width + patch.x);
            for i in 0..PATCH_PX {
                let value = w00 * top[i] + w10 * top[i + 1] + w01 * bottom[i] + w11 * bottom[i + 1];
                self.difference[j][i] = value - a[i];
                sums[i] += self.difference[j][i];
            }
        }
        total(sums) / (PATCH_PX * PATCH_PX) as f32
    }

    /// Sum of squared differences after removal of their mean.
    #[inline(always)]
    fn cost(&mut self, patch: &Patch, f: [f32; 2]) -> f32 {
        let mean = self.sample(patch, f);
        let mut squares = [0.0f32; PATCH_PX];
        for difference in &self.difference {
            squares
                .iter_mut()
                .zip(difference)
                .for_each(|(square, d)| *square += d * d);
        }
        total(squares) - mean * mean * (PATCH_PX * PATCH_PX) as f32
    }

    #[inline(always)]
    fn descend(&mut self, patch: &Patch, start: [f32; 2]) -> [f32; 2] {
        let Some([ixx, ixy, iyy]) = patch.inverse else {
            return start;
        };
        let mut f = start;
        for _ in 0..ITERATIONS {
            let mean = self.sample(patch, f);
            let (mut bx, mut by) = ([0.0f32; PATCH_PX], [0.0f32; PATCH_PX]);
            for (j, d) in self.difference.iter().enumerate() {
                let from = (patch.y + j) * self.a.width + patch.x;
                let (gx, gy): (&[f32; PATCH_PX], &[f32; PATCH_PX]) =
                    (row(&self.a.dx, from), row(&self.a.dy, from));
                for i in 0..PATCH_PX {
                    bx[i] += gx[i] * d[i];
                    by[i] += gy[i] * d[i];
                }
            }
            let (bx, by) = (
                total(bx) - patch.sum[0] * mean,
                total(by) - patch.sum[1] * mean,
            );
            let (du, dv) = (ixx * bx + ixy * by, ixy * bx + iyy * by);
            f = [f[0] - du, f[1] - dv];
            if du * du + dv * dv < SMALL_STEP_PX * SMALL_STEP_PX {
                break;
            }
        }
        if f[0].is_finite() && f[1].is_finite() {
            f
        } else {
            start
        }
    }
}

/// The mean of the patches over a pixel, weighted by how well each explains it.
#[inline(always)]
fn average(search: &mut Search<'_>, patches: &[Patch], flow: &[[f32; 2]]) -> Flow {
    let (width, height) = (search.a.width, search.a.height);
    let mut out = Flow::zero(width, height);
    let mut weight = vec![0.0f32; width * height];
    for (patch, &f) in patches.iter().zip(flow) {
        let mean = search.sample(patch, f);
        for (j, difference) in search.difference.iter().enumerate() {
            let from = (patch.y + j) * width + patch.x;
            let u = &mut out.u[from..][..PATCH_PX];
            let v = &mut out.v[from..][..PATCH_PX];
            let weight = &mut weight[from..][..PATCH_PX];
            for i in 0..PATCH_PX {
                let w = 1.0 / (difference[i] - mean).abs().max(1.0);
                weight[i] += w;
                u[i] += w * f[0];
                v[i] += w * f[1];
            }
        }
    }
    for ((u, v), w) in out.u.iter_mut().zip(&mut out.v).zip(&weight) {
        *u /= w;
        *v /= w;
    }
    out
}
