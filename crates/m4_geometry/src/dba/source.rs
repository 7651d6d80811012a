//! All edges of one source frame: its share of the reduced system.
//!
//! The disparities of a frame meet the poses of that frame and of its targets only. Per block of
//! pixels the rows `F = w J_target Jz` of all its edges are formed, scaled by `Q = 1/C` and
//! multiplied with themselves; nothing is kept from block to block but sums. The source's own rows
//! are `M_e F_e` summed over the edges (`M = -Ad(G_ij)^T`), so they are applied to the sums and
//! never to pixels.

use super::lanes::{
    BLOCK, EdgeBlock, EdgeConstants, Lane, PAIR, Rays, Row, dot, linearise, load, outer_products,
    three_by_three,
};
use super::options::{DbaOptions, depth_prior, stepped_disparity};
use super::problem::{Factor, Geometry, source_from_target};
use fearless_simd::{Level, Simd};
use m4_core::dispatch;
use m4_core::nalgebra::{DMatrix, DVector, Matrix6, Vector6};

/// What all sources share.
pub(super) struct Context<'a> {
    pub geometry: &'a Geometry<f32>,
    pub eta: &'a [Vec<f32>],
    pub rays: Rays,
    pub options: &'a DbaOptions,
    pub level: Level,
}

/// A source frame and its edges, in the order of the problem.
pub(super) struct Source<'a> {
    pub frame: usize,
    pub edges: Vec<&'a Factor<f32>>,
}

/// The share of one source: rows and columns are the source, then the target of every edge (six
/// each), then the focal parameter where it is free.
pub(super) struct SourceSums {
    /// Frame of each group of six.
    pub frames: Vec<usize>,
    /// Curvature with the disparities eliminated.
    pub matrix: DMatrix<f64>,
    /// Gradient with the disparities eliminated.
    pub rhs: DVector<f64>,
    /// Diagonal before the elimination: what damping scales with.
    pub diagonal: DVector<f64>,
    /// Sums of `w |r|^2` and of `w`.
    pub squares: (f64, f64),
}

/// Pose and focal sums of one edge.
#[derive(Clone, Copy, Default)]
struct EdgeSums {
    h: Matrix6<f64>,
    v: Vector6<f64>,
    focal_h: Vector6<f64>,
    focal: f64,
    focal_v: f64,
    squares: (f64, f64),
}

impl EdgeSums {
    #[inline(always)]
    fn add<S: Simd>(&mut self, s: S, block: &EdgeBlock, focal: bool) {
        let [j0, j1, j2, j3, j4, j5] = &block.j;
        // Three weighted rows at a time, against the rows of poses up to them, and the residual.
        for (a, [x, y, z]) in [(0, [j0, j1, j2]), (3, [j3, j4, j5])] {
            let mut weighted = [[0.0_f32; PAIR]; 3];
            for l in 0..PAIR {
                weighted[0][l] = block.w[l] * x[l];
                weighted[1][l] = block.w[l] * y[l];
                weighted[2][l] = block.w[l] * z[l];
            }
            let rows = weighted.each_ref();
            for (b, columns) in [(0, [j0, j1, j2]), (3, [j3, j4, j5])] {
                if b <= a {
                    let part = three_by_three(s, rows, columns);
                    for r in 0..3 {
                        for c in 0..3 {
                            self.h[(a + r, b + c)] += f64::from(part[r][c]);
                        }
                    }
                }
            }
            for r in 0..3 {
                self.v[a + r] += dot(s, rows[r], &block.r);
                if focal {
                    self.focal_h[a + r] += dot(s, rows[r], &block.jf);
                }
            }
        }
        let mut weighted: Row = [0.0; PAIR];
        if focal {
            for l in 0..PAIR {
                weighted[l] = block.w[l] * block.jf[l];
            }
            self.focal += dot(s, &weighted, &block.jf);
            self.focal_v += dot(s, &weighted, &block.r);
        }
        for l in 0..PAIR {
            weighted[l] = block.w[l] * block.r[l];
        }
        self.squares.0 += dot(s, &weighted, &block.r);
        self.squares.1 += dot(s, &block.w, &[1.0; PAIR]);
    }
}

/// Curvature and gradient of the disparities of one block.
pub(super) struct Curvature {
    pub c: Lane,
    pub b: Lane,
}

impl Curvature {
    pub(super) const ZERO: Self = Self {
        c: [0.0; BLOCK],
        b: [0.0; BLOCK],
    };

    #[inline(always)]
    pub(super) fn add(&mut self, block: &EdgeBlock) {
        for l in 0..BLOCK {
            let (gu, gv) = (
                block.w[l] * block.jz[l],
                block.w[BLOCK + l] * block.jz[BLOCK + l],
            );
            self.c[l] += gu * block.jz[l] + gv * block.jz[BLOCK + l];
            self.b[l] += gu * block.r[l] + gv * block.r[BLOCK + l];
        }
    }

    /// Adds the prior; the curvature becomes its inverse, 0 for pixels that pad the block.
    #[inline(always)]
    pub(super) fn invert(
        &mut self,
        context: &Context<'_>,
        frame: usize,
        start: usize,
        disparity: &Lane,
    ) {
        let (eta, sensor) = (
            load(&context.eta[frame], start),
            load(&context.geometry.sensor[frame], start),
        );
        let alpha = context.options.prior_alpha.map(|a| a as f32);
        let count = (context.geometry.grid.len() - start).min(BLOCK);
        for l in 0..BLOCK {
            let (c, b) = depth_prior(alpha, eta[l], disparity[l], sensor[l]);
            self.b[l] += b;
            self.c[l] = if l < count {
                1.0 / (self.c[l] + c)
            } else {
                0.0
            };
        }
    }
}

impl Source<'_> {
    pub(super) fn constants(&self, context: &Context<'_>) -> Vec<EdgeConstants> {
        let g = context.geometry;
        let edges = self.edges.iter();
        edges
            .map(|f| EdgeConstants::new(g, f.source, f.target, context.options))
            .collect()
    }

    /// This source's share of the reduced system.
    pub(super) fn reduce(&self, context: &Context<'_>) -> SourceSums {
        let free = context.options.free;
        let count = self.edges.len();
        // The focal row has two empty ones below it, since products are formed three rows at a
        // time.
        let rows = 6 * count + if free.focal() { 3 } else { 0 };
        let mut sums = vec![EdgeSums::default(); count];
        let mut products = if free.depth() {
            DMatrix::zeros(rows, rows)
        } else {
            DMatrix::zeros(0, 0)
        };
        let mut shift = DVector::zeros(if free.depth() { rows } else { 0 });
        dispatch!(context.level, s => self.sweep(s, context, &mut sums, &mut products, &mut shift));
        self.assemble(context, &sums, &products, &shift)
    }

    #[inline(always)]
    fn sweep<S: Simd>(
        &self,
        s: S,
        context: &Context<'_>,
        sums: &mut [EdgeSums],
        products: &mut DMatrix<f64>,
        shift: &mut DVector<f64>,
    ) {
        let (geometry, free) = (context.geometry, context.options.free);
        let constants = self.constants(context);
        let mut block = EdgeBlock::new();
        let mut f = vec![[0.0_f32; BLOCK]; shift.len()];
        let mut qf = f.clone();
        let focal_row = 6 * self.edges.len();
        for start in (0..geometry.grid.len()).step_by(BLOCK) {
            let disparity = load(&geometry.disparity[self.frame], start);
            let mut curvature = Curvature::ZERO;
            if free.focal() {
                f[focal_row] = [0.0; BLOCK];
            }
            for (e, edge) in self.edges.iter().enumerate() {
                linearise(
                    &constants[e],
                    &edge.target_px,
                    &edge.weight,
                    &context.rays,
                    &disparity,
                    start,
                    &mut block,
                );
                sums[e].add(s, &block, free.focal());
                if !free.depth() {
                    continue;
                }
                curvature.add(&block);
                for l in 0..PAIR {
                    block.w[l] *= block.jz[l];
                }
                for a in 0..6 {
                    let row = &mut f[6 * e + a];
                    for l in 0..BLOCK {
                        row[l] =
                            block.w[l] * block.j[a][l] + block.w[BLOCK + l] * block.j[a][BLOCK + l];
                    }
                }
                if free.focal() {
                    let row = &mut f[focal_row];
                    for l in 0..BLOCK {
                        row[l] +=
                            block.w[l] * block.jf[l] + block.w[BLOCK + l] * block.jf[BLOCK + l];
                    }
                }
            }
            if free.depth() {
                curvature.invert(context, self.frame, start, &disparity);
                for (row, scaled) in f.iter().zip(&mut qf) {
                    for l in 0..BLOCK {
                        scaled[l] = row[l] * curvature.c[l];
                    }
                }
                outer_products(s, &qf, &f, products);
                for (row, sum) in qf.iter().zip(shift.iter_mut()) {
                    *sum += dot(s, row, &curvature.b);
                }
            }
        }
    }

    /// Puts the sums of pixels into place.
    fn assemble(
        &self,
        context: &Context<'_>,
        sums: &[EdgeSums],
        products: &DMatrix<f64>,
        shift: &DVector<f64>,
    ) -> SourceSums {
        let free = context.options.free;
        let count = self.edges.len();
        let n = 6 * (count + 1);
        let size = n + usize::from(free.focal());
        let (mut h, mut v) = (
            DMatrix::<f64>::zeros(size, size),
            DVector::<f64>::zeros(size),
        );
        // The source's rows out of those of the targets.
        let mut gather = DMatrix::<f64>::zeros(6, shift.len());
        let mut squares = (0.0, 0.0);
        for (e, (edge, s)) in self.edges.iter().zip(sums).enumerate() {
            let m = source_from_target(&context.geometry.relative(edge.source, edge.target));
            let mut hjj = s.h;
            hjj.fill_upper_triangle_with_lower_triangle();
            let (at, hij) = (6 * (e + 1), m * hjj);
            h.fixed_view_mut::<6, 6>(at, at).copy_from(&hjj);
            h.fixed_view_mut::<6, 6>(0, at).copy_from(&hij);
            h.fixed_view_mut::<6, 6>(at, 0).copy_from(&hij.transpose());
            let mut own = h.fixed_view_mut::<6, 6>(0, 0);
            own += hij * m.transpose();
            v.fixed_rows_mut::<6>(at).copy_from(&s.v);
            let mut own = v.fixed_rows_mut::<6>(0);
            own += m * s.v;
            if free.focal() {
                let source = m * s.focal_h;
                for a in 0..6 {
                    h[(n, at + a)] = s.focal_h[a];
                    h[(at + a, n)] = s.focal_h[a];
                    h[(n, a)] += source[a];
                    h[(a, n)] += source[a];
                }
                h[(n, n)] += s.focal;
                v[n] += s.focal_v;
            }
            if free.depth() {
                gather.fixed_view_mut::<6, 6>(0, 6 * e).copy_from(&m);
            }
            squares = (squares.0 + s.squares.0, squares.1 + s.squares.1);
        }
        let diagonal = h.diagonal();
        if free.depth() {
            // Without the two empty rows below the focal row.
            let rows = size - 6;
            let full = {
                let mut full = products.view((0, 0), (rows, rows)).into_owned();
                full.fill_upper_triangle_with_lower_triangle();
                full
            };
            let gather = gather.columns(0, rows);
            let source = gather * &full;
            let mut part = h.view_mut((6, 6), (rows, rows));
            part -= &full;
            let mut part = h.view_mut((0, 6), (6, rows));
            part -= &source;
            let mut part = h.view_mut((6, 0), (rows, 6));
            part -= source.transpose();
            let mut part = h.view_mut((0, 0), (6, 6));
            part -= &source * gather.transpose();
            let shift = shift.rows(0, rows);
            let mut part = v.rows_mut(0, 6);
            part -= gather * shift;
            let mut part = v.rows_mut(6, rows);
            part -= shift;
        }
        let targets = self.edges.iter().map(|f| f.target);
        SourceSums {
            frames: std::iter::once(self.frame).chain(targets).collect(),
            matrix: h,
            rhs: v,
            diagonal,
            squares,
        }
    }
}

impl Source<'_> {
    /// The disparities after the step: `poses[frame]` holds the twist of every frame, zero where it
    /// is fixed.
    pub(super) fn substitute(
        &self,
        context: &Context<'_>,
        twists: &[Vector6<f64>],
        focal: f64,
    ) -> Vec<f32> {
        let mut out = vec![0.0; context.geometry.grid.len()];
        let changes: Vec<[f32; 6]> = self
            .edges
            .iter()
            .map(|f| {
                let g = context.geometry.relative(f.source, f.target);
                let y = twists[f.target] - g.adjoint() * twists[f.source];
                std::array::from_fn(|a| y[a] as f32)
            })
            .collect();
        dispatch!(context.level, _s => self.substitute_blocks(context, &changes, focal as f32, &mut out));
        out
    }

    #[inline(always)]
    fn substitute_blocks(
        &self,
        context: &Context<'_>,
        changes: &[[f32; 6]],
        focal: f32,
        out: &mut [f32],
    ) {
        let constants = self.constants(context);
        let mut block = EdgeBlock::new();
        for (k, chunk) in out.chunks_mut(BLOCK).enumerate() {
            let start = k * BLOCK;
            let disparity = load(&context.geometry.disparity[self.frame], start);
            let mut curvature = Curvature::ZERO;
            for (e, edge) in self.edges.iter().enumerate() {
                linearise(
                    &constants[e],
                    &edge.target_px,
                    &edge.weight,
                    &context.rays,
                    &disparity,
                    start,
                    &mut block,
                );
                let y = changes[e];
                // What the poses take away of the residual.
                for l in 0..PAIR {
                    let mut change = focal * block.jf[l];
                    for a in 0..6 {
                        change += y[a] * block.j[a][l];
                    }
                    block.r[l] -= change;
                }
                curvature.add(&block);
            }
            curvature.invert(context, self.frame, start, &disparity);
            for (l, d) in chunk.iter_mut().enumerate() {
                *d = stepped_disparity(disparity[l], curvature.b[l] * curvature.c[l]);
            }
        }
    }

    /// `sum Jz^2` of every pixel and `sum Jf^2` of all, over valid points and with weights of 1.
    pub(super) fn information(&self, context: &Context<'_>) -> (Vec<f32>, f64) {
        let mut depth = vec![0.0; context.geometry.grid.len()];
        let focal = dispatch!(context.level, s => self.information_blocks(s, context, &mut depth));
        (depth, focal)
    }

    #[inline(always)]
    fn information_blocks<S: Simd>(&self, s: S, context: &Context<'_>, out: &mut [f32]) -> f64 {
        let constants = self.constants(context);
        let ones = [vec![1.0; out.len()], vec![1.0; out.len()]];
        let mut block = EdgeBlock::new();
        let mut focal = 0.0;
        for (k, chunk) in out.chunks_mut(BLOCK).enumerate() {
            let start = k * BLOCK;
            let disparity = load(&context.geometry.disparity[self.frame], start);
            let mut curvature = Curvature::ZERO;
            for (e, edge) in self.edges.iter().enumerate() {
                let constants = constants[e].unscaled();
                linearise(
                    &constants,
                    &edge.target_px,
                    &ones,
                    &context.rays,
                    &disparity,
                    start,
                    &mut block,
                );
                curvature.add(&block);
                for l in 0..PAIR {
                    block.w[l] *= block.jf[l];
                }
                focal += dot(s, &block.w, &block.jf);
            }
            chunk.copy_from_slice(&curvature.c[..chunk.len()]);
        }
        focal
    }
}
