//! Normals of smoothed depth, and the gradient of the normal term, row by row. The definition is
//! `reference::normal_loss`.

use super::shape::Shape;
use crate::dba::Pinhole;
use crate::megasam::cvd::pairs::LANES;
use crate::megasam::cvd::reference::{blur_weights, reflect};

/// Planes and rows of one frame, used again and again.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Depth, blurred along rows and then along columns, plain; on the way back its gradient.
    smooth: Vec<f32>,
    along_rows: Vec<f32>,
    /// Gradients of points, `[height + 2][width + 2]` each: the replicated border is folded in at
    /// the end.
    points: [Vec<f32>; 3],
    /// `x / z` of rays, one a column and its border.
    ray_x: Vec<f32>,
    /// `y / z` of rays, one a row and its border.
    ray_y: Vec<f32>,
    padded: Vec<f32>,
    row: [Vec<f32>; 10],
}

/// Rays at pixels and one beyond, where they repeat the last.
fn rays(n: usize, focal: f64, centre: f64) -> impl Iterator<Item = f32> {
    (0..n + 2).map(move |i| {
        let at = i.clamp(1, n) - 1;
        ((at as f64 - centre) / focal) as f32
    })
}

impl Scratch {
    pub fn new(shape: Shape, lens: &Pinhole<f64>) -> Self {
        let (w, h) = (shape.width, shape.height);
        Self {
            smooth: vec![0.0; shape.plain()],
            along_rows: vec![0.0; shape.plain()],
            points: std::array::from_fn(|_| vec![0.0; (w + 2) * (h + 2)]),
            ray_x: rays(w, lens.fx, lens.cx).collect(),
            ray_y: rays(h, lens.fy, lens.cy).collect(),
            padded: vec![0.0; w + 4],
            row: std::array::from_fn(|_| vec![0.0; w + 2]),
        }
    }

    /// Blurs depth; `disparity` is a bordered plane.
    #[inline(always)]
    fn blur(&mut self, shape: Shape, disparity: &[f32]) {
        let (w, h, k) = (shape.width, shape.height, blur_weights().map(|k| k as f32));
        for y in 0..h {
            let disparity = &disparity[shape.tap_row(y)..][..w];
            let padded = &mut self.padded[..w + 4];
            let middle = &mut padded[2..w + 2];
            for x in 0..w {
                middle[x] = 1.0 / disparity[x];
            }
            for side in [0, 1, w + 2, w + 3] {
                padded[side] = padded[reflect(side as isize - 2, w) + 2];
            }
            let [a, b, c, d, e] = shifted5(padded, w);
            let out = &mut self.along_rows[y * shape.stride..][..w];
            for x in 0..w {
                out[x] = k[0] * (a[x] + e[x]) + k[1] * (b[x] + d[x]) + k[2] * c[x];
            }
        }
        for y in 0..h {
            let row =
                |dy: isize| &self.along_rows[reflect(y as isize + dy, h) * shape.stride..][..w];
            let [a, b, c, d, e] = [row(-2), row(-1), row(0), row(1), row(2)];
            let out = &mut self.smooth[y * shape.stride..][..w];
            for x in 0..w {
                out[x] = k[0] * (a[x] + e[x]) + k[1] * (b[x] + d[x]) + k[2] * c[x];
            }
        }
    }

    /// The Sobel gradients of the points of row `y`, into rows 0..3 (along x) and 3..6 (along y).
    #[inline(always)]
    fn slopes(&mut self, shape: Shape, y: usize) {
        let (w, h) = (shape.width, shape.height);
        let [x0, x1, x2, y0, y1, y2, sum_y, sum_z, fall_y, fall_z] = &mut self.row;
        let row = |i: usize| &self.smooth[(i.clamp(1, h) - 1) * shape.stride..][..w];
        // rows y - 1, y, y + 1 are i = y, y + 1, y + 2 with the border
        let (above, here, below) = (row(y), row(y + 1), row(y + 2));
        let [ra, rh, rb] = [self.ray_y[y], self.ray_y[y + 1], self.ray_y[y + 2]];
        {
            let [sum_y, sum_z, fall_y, fall_z] =
                [&mut *sum_y, &mut *sum_z, &mut *fall_y, &mut *fall_z].map(|row| &mut row[1..=w]);
            for x in 0..w {
                let (a, m, b) = (above[x], here[x], below[x]);
                sum_z[x] = a + 2.0 * m + b;
                fall_z[x] = b - a;
                sum_y[x] = ra * a + 2.0 * rh * m + rb * b;
                fall_y[x] = rb * b - ra * a;
            }
        }
        for row in [&mut *sum_y, &mut *sum_z, &mut *fall_y, &mut *fall_z] {
            row[0] = row[1];
            row[w + 1] = row[w];
        }
        let ([la, lm, lb], [sa, _, sb], [ya, _, yb]) = (
            shifted3(&self.ray_x, w),
            shifted3(sum_z, w),
            shifted3(sum_y, w),
        );
        let ([fa, fm, fb], [ga, gm, gb]) = (shifted3(fall_z, w), shifted3(fall_y, w));
        slope_rows(
            la,
            lm,
            lb,
            sa,
            sb,
            fa,
            fm,
            fb,
            &mut x0[..w],
            &mut x2[..w],
            &mut y0[..w],
            &mut y2[..w],
        );
        let (x1, y1) = (&mut x1[..w], &mut y1[..w]);
        for x in 0..w {
            x1[x] = 0.125 * (yb[x] - ya[x]);
            y1[x] = 0.125 * (ga[x] + 2.0 * gm[x] + gb[x]);
        }
    }

    /// The unit normals of a bordered plane of disparity times `weight` (plain), as plain planes.
    #[inline(always)]
    pub fn weighted_normals(
        &mut self,
        shape: Shape,
        disparity: &[f32],
        weight: &[f32],
        out: &mut [Vec<f32>; 3],
    ) {
        self.blur(shape, disparity);
        let w = shape.width;
        for y in 0..shape.height {
            self.slopes(shape, y);
            let [a0, a1, a2, b0, b1, b2, ..] = &self.row;
            let weight = &weight[y * shape.stride..][..w];
            let [n0, n1, n2] = out.each_mut().map(|p| &mut p[y * shape.stride..][..w]);
            for x in 0..w {
                let n = cross([a0[x], a1[x], a2[x]], [b0[x], b1[x], b2[x]]);
                let scale = weight[x] / length(n);
                (n0[x], n1[x], n2[x]) = (n[0] * scale, n[1] * scale, n[2] * scale);
            }
        }
    }

    /// The sum of `weight (1 - n . n_initial)` over the frame, given `weight n_initial`; leaves the
    /// gradient with respect to depth in the plane that [`Self::by_depth`] reads.
    #[inline(always)]
    pub fn normal_term(&mut self, shape: Shape, disparity: &[f32], wanted: &[Vec<f32>; 3]) -> f64 {
        self.blur(shape, disparity);
        let (w, h) = (shape.width, shape.height);
        for plane in &mut self.points {
            plane.fill(0.0);
        }
        let mut loss = 0.0;
        for y in 0..h {
            self.slopes(shape, y);
            let [a0, a1, a2, b0, b1, b2, losses, ..] = &mut self.row;
            let (a0, a1, a2) = (&mut a0[..w], &mut a1[..w], &mut a2[..w]);
            let (b0, b1, b2) = (&mut b0[..w], &mut b1[..w], &mut b2[..w]);
            let losses = &mut losses[..w];
            let [n0, n1, n2] = wanted.each_ref().map(|p| &p[y * shape.stride..][..w]);
            normal_row(a0, a1, a2, b0, b1, b2, losses, n0, n1, n2);
            loss += sum(losses);
            self.spread_slopes(shape, y);
        }
        self.fold(shape);
        loss
    }

    /// The transpose of [`Self::slopes`]: adds rows 0..6 of gradients to the points around row `y`.
    #[inline(always)]
    fn spread_slopes(&mut self, shape: Shape, y: usize) {
        let w = shape.width;
        let [a0, a1, a2, b0, b1, b2, along, across, ..] = &mut self.row;
        let terms = [(&*a0, &*b0), (&*a1, &*b1), (&*a2, &*b2)];
        for ((a, b), points) in terms.into_iter().zip(&mut self.points) {
            // outside the row there is nothing
            let (a, b) = (&a[..w], &b[..w]);
            along.fill(0.0);
            across.fill(0.0);
            add_scaled(&mut along[2..w + 2], a, 0.125);
            add_scaled(&mut along[..w], a, -0.125);
            add_scaled(&mut across[..w], b, 0.125);
            add_scaled(&mut across[1..=w], b, 0.25);
            add_scaled(&mut across[2..w + 2], b, 0.125);
            let (top, rest) = points[y * (w + 2)..].split_at_mut(w + 2);
            let (middle, bottom) = rest.split_at_mut(w + 2);
            let (along, across, top) = (&along[..w + 2], &across[..w + 2], &mut top[..w + 2]);
            let (middle, bottom) = (&mut middle[..w + 2], &mut bottom[..w + 2]);
            for x in 0..w + 2 {
                top[x] += along[x] - across[x];
                middle[x] += 2.0 * along[x];
                bottom[x] += along[x] + across[x];
            }
        }
    }

    /// Borders into the pixels that they repeat, points into depth along their rays, and the blur
    /// backwards.
    #[inline(always)]
    fn fold(&mut self, shape: Shape) {
        let (w, h, k) = (shape.width, shape.height, blur_weights().map(|k| k as f32));
        let stride = w + 2;
        for points in &mut self.points {
            let (first, second) = points.split_at_mut(stride);
            add_scaled(&mut second[..stride], first, 1.0);
            let (before, last) = points.split_at_mut((h + 1) * stride);
            add_scaled(&mut before[h * stride..], last, 1.0);
            for row in points.chunks_exact_mut(stride) {
                row[1] += row[0];
                row[w] += row[w + 1];
            }
        }
        self.along_rows.fill(0.0);
        for y in 0..h {
            let [px, py, pz] = self
                .points
                .each_ref()
                .map(|p| &p[(y + 1) * stride + 1..][..w]);
            let (rx, ry) = (&self.ray_x[1..=w], self.ray_y[y + 1]);
            let along = &mut self.smooth[y * shape.stride..][..w];
            for x in 0..w {
                along[x] = rx[x] * px[x] + ry * py[x] + pz[x];
            }
            for (dy, k) in (-2..=2).zip(k) {
                let out = &mut self.along_rows[reflect(y as isize + dy, h) * shape.stride..][..w];
                add_scaled(out, along, k);
            }
        }
        for y in 0..h {
            let row = &self.along_rows[y * shape.stride..][..w];
            let padded = &mut self.padded[..w + 4];
            padded.fill(0.0);
            for (shift, k) in k.into_iter().enumerate() {
                add_scaled(&mut padded[shift..shift + w], row, k);
            }
            for side in [0, 1, w + 2, w + 3] {
                padded[reflect(side as isize - 2, w) + 2] += padded[side];
            }
            self.smooth[y * shape.stride..][..w].copy_from_slice(&padded[2..w + 2]);
        }
    }

    /// Row `y` of what [`Self::normal_term`] left.
    #[inline(always)]
    pub fn by_depth(&self, shape: Shape, y: usize) -> &[f32] {
        &self.smooth[y * shape.stride..][..shape.width]
    }
}

/// A row of `w + 4` as five rows of `w`.
#[inline(always)]
fn shifted5(row: &[f32], w: usize) -> [&[f32]; 5] {
    [
        &row[..w],
        &row[1..w + 1],
        &row[2..w + 2],
        &row[3..w + 3],
        &row[4..w + 4],
    ]
}

/// A row of `w + 2` as three rows of `w`.
#[inline(always)]
fn shifted3(row: &[f32], w: usize) -> [&[f32]; 3] {
    [&row[..w], &row[1..w + 1], &row[2..w + 2]]
}

/// The Sobel gradients of x and z of points from sums (s) and differences (f) of three rows of
/// depth and the rays (l). Like [`normal_row`] a function of its own so that the compiler knows
/// that no slices overlap, which it needs for vectors.
#[inline(always)]
fn slope_rows(
    la: &[f32],
    lm: &[f32],
    lb: &[f32],
    sa: &[f32],
    sb: &[f32],
    fa: &[f32],
    fm: &[f32],
    fb: &[f32],
    x0: &mut [f32],
    x2: &mut [f32],
    y0: &mut [f32],
    y2: &mut [f32],
) {
    let n = x0.len();
    let (la, lm, lb, sa, sb) = (&la[..n], &lm[..n], &lb[..n], &sa[..n], &sb[..n]);
    let (fa, fm, fb) = (&fa[..n], &fm[..n], &fb[..n]);
    let (x2, y0, y2) = (&mut x2[..n], &mut y0[..n], &mut y2[..n]);
    for x in 0..n {
        x0[x] = 0.125 * (lb[x] * sb[x] - la[x] * sa[x]);
        x2[x] = 0.125 * (sb[x] - sa[x]);
        y0[x] = 0.125 * (la[x] * fa[x] + 2.0 * lm[x] * fm[x] + lb[x] * fb[x]);
        y2[x] = 0.125 * (fa[x] + 2.0 * fm[x] + fb[x]);
    }
}

/// Slopes along x (a) and y (b) become the gradients with respect to them; n is the wanted normal
/// times its weight.
#[inline(always)]
fn normal_row(
    a0: &mut [f32],
    a1: &mut [f32],
    a2: &mut [f32],
    b0: &mut [f32],
    b1: &mut [f32],
    b2: &mut [f32],
    losses: &mut [f32],
    n0: &[f32],
    n1: &[f32],
    n2: &[f32],
) {
    let w = losses.len();
    let (a0, a1, a2) = (&mut a0[..w], &mut a1[..w], &mut a2[..w]);
    let (b0, b1, b2) = (&mut b0[..w], &mut b1[..w], &mut b2[..w]);
    let (n0, n1, n2) = (&n0[..w], &n1[..w], &n2[..w]);
    for x in 0..w {
        let (a, b) = ([a0[x], a1[x], a2[x]], [b0[x], b1[x], b2[x]]);
        let n = cross(a, b);
        let scale = 1.0 / length(n);
        let unit = [n[0] * scale, n[1] * scale, n[2] * scale];
        let wanted = [n0[x], n1[x], n2[x]];
        let weight = (wanted[0] * wanted[0] + wanted[1] * wanted[1] + wanted[2] * wanted[2]).sqrt();
        let cosine = unit[0] * wanted[0] + unit[1] * wanted[1] + unit[2] * wanted[2];
        losses[x] = weight - cosine;
        let g = [
            (unit[0] * cosine - wanted[0]) * scale,
            (unit[1] * cosine - wanted[1]) * scale,
            (unit[2] * cosine - wanted[2]) * scale,
        ];
        [a0[x], a1[x], a2[x]] = cross(b, g);
        [b0[x], b1[x], b2[x]] = cross(g, a);
    }
}

/// `out += factor row`.
#[inline(always)]
fn add_scaled(out: &mut [f32], row: &[f32], factor: f32) {
    for (out, &value) in out.iter_mut().zip(row) {
        *out += factor * value;
    }
}

#[inline(always)]
fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// At least 1e-12, as the definition has it.
#[inline(always)]
fn length(v: [f32; 3]) -> f32 {
    let square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    (if square > 1e-24 { square } else { 1e-24 }).sqrt()
}

/// The sum of a row, in sixteen lanes that are added in order.
#[inline(always)]
pub(super) fn sum(row: &[f32]) -> f64 {
    let mut lanes = [0.0f32; LANES];
    let chunks = row.chunks_exact(LANES);
    let mut total: f64 = chunks.remainder().iter().map(|&v| f64::from(v)).sum();
    for chunk in chunks {
        for k in 0..LANES {
            lanes[k] += chunk[k];
        }
    }
    total += lanes.iter().map(|&v| f64::from(v)).sum::<f64>();
    total
}
