//! The oracle of the fast path: f64, plain sums, every block stored.

use super::options::{DbaOptions, WEIGHT_SCALE, depth_prior, stepped_disparity};
use super::problem::{DbaError, Factor, Geometry, Problem, project};
use m4_core::Se3;
use m4_core::nalgebra::{Cholesky, DMatrix, DVector, Matrix6, Vector6};
use std::collections::BTreeMap;
use std::ops::Range;

/// The normal equations of one edge; index 0 is the source, 1 the target.
#[derive(Debug, Clone)]
pub struct EdgeSystem {
    /// `H[a][b]`, pose against pose.
    pub h: [[Matrix6<f64>; 2]; 2],
    /// Gradient by the poses.
    pub v: [Vector6<f64>; 2],
    /// Pose against disparity, `[2][height * width]`.
    pub e: [Vec<Vector6<f64>>; 2],
    /// Disparity against itself, `[height * width]`.
    pub c: Vec<f64>,
    /// Gradient by the disparity, `[height * width]`.
    pub b: Vec<f64>,
    /// Focal against focal.
    pub focal: f64,
    /// Gradient by the focal parameter.
    pub focal_v: f64,
    /// Focal against pose.
    pub focal_h: [Vector6<f64>; 2],
    /// Focal against disparity, `[height * width]`.
    pub focal_e: Vec<f64>,
    /// Sums of `w |r|^2` and of `w`.
    pub squares: (f64, f64),
}

/// Linearises one edge at the present geometry.
#[must_use]
pub fn edge_system(
    geometry: &Geometry<f64>,
    factor: &Factor<f64>,
    options: &DbaOptions,
) -> EdgeSystem {
    let g = geometry.relative(factor.source, factor.target);
    let (width, len) = (geometry.grid.width, geometry.grid.len());
    let rate = options.fy_rate(&geometry.lens);
    let mut s = EdgeSystem {
        h: [[Matrix6::zeros(); 2]; 2],
        v: [Vector6::zeros(); 2],
        e: [vec![Vector6::zeros(); len], vec![Vector6::zeros(); len]],
        c: vec![0.0; len],
        b: vec![0.0; len],
        focal: 0.0,
        focal_v: 0.0,
        focal_h: [Vector6::zeros(); 2],
        focal_e: vec![0.0; len],
        squares: (0.0, 0.0),
    };
    for n in 0..len {
        let (u, v) = ((n % width) as f64, (n / width) as f64);
        let p = project(
            &g,
            &geometry.lens,
            rate,
            u,
            v,
            geometry.disparity[factor.source][n],
        );
        if p.z <= options.min_depth {
            continue;
        }
        let r = [
            factor.target_px[0][n] - p.pixel.x,
            factor.target_px[1][n] - p.pixel.y,
        ];
        let scale = WEIGHT_SCALE / (1.0 + (r[0] * r[0] + r[1] * r[1]) * options.inverse_square());
        for k in 0..2 {
            let w = scale * factor.weight[k][n];
            let j = [
                p.by_source.row(k).transpose(),
                p.by_target.row(k).transpose(),
            ];
            let (jz, jf) = (p.by_disparity[k], p.by_focal[k]);
            for a in 0..2 {
                for b in 0..2 {
                    s.h[a][b] += j[a] * j[b].transpose() * w;
                }
                s.v[a] += j[a] * (w * r[k]);
                s.e[a][n] += j[a] * (w * jz);
                s.focal_h[a] += j[a] * (w * jf);
            }
            s.c[n] += w * jz * jz;
            s.b[n] += w * r[k] * jz;
            s.focal += w * jf * jf;
            s.focal_v += w * r[k] * jf;
            s.focal_e[n] += w * jf * jz;
            s.squares.0 += w * r[k] * r[k];
            s.squares.1 += w;
        }
    }
    s
}

/// The step of one iteration.
struct Step {
    poses: DVector<f64>,
    focal: f64,
    /// By source frame.
    disparity: BTreeMap<usize, Vec<f64>>,
}

/// Runs the iterations of `options`. `window` holds the frames whose poses move. Returns how many
/// iterations failed to factorise; those move nothing.
///
/// # Errors
///
/// [`DbaError`] where sizes or indices do not fit.
pub fn adjust_reference(
    geometry: &mut Geometry<f64>,
    problem: &Problem<'_, f64>,
    window: Range<usize>,
    options: &DbaOptions,
) -> Result<usize, DbaError> {
    problem.check(geometry, &window)?;
    let mut failed = 0;
    for _ in 0..options.iterations {
        let Some(step) = solve(geometry, problem, &window, options) else {
            failed += 1;
            continue;
        };
        for (k, frame) in window.clone().enumerate() {
            let xi: Vector6<f64> = step.poses.fixed_rows::<6>(6 * k).into_owned();
            geometry.poses[frame] = Se3::exp(&xi).compose(&geometry.poses[frame]);
        }
        if options.free.focal() {
            geometry.lens = geometry.lens.with_focal_step(step.focal);
        }
        for (&frame, steps) in &step.disparity {
            for (d, &dz) in geometry.disparity[frame].iter_mut().zip(steps) {
                *d = stepped_disparity(*d, dz);
            }
        }
    }
    Ok(failed)
}

fn solve(
    geometry: &Geometry<f64>,
    problem: &Problem<'_, f64>,
    window: &Range<usize>,
    options: &DbaOptions,
) -> Option<Step> {
    let len = geometry.grid.len();
    let focal = options.free.focal();
    let n = 6 * window.len();
    let size = n + usize::from(focal);
    let systems: Vec<(&Factor<f64>, EdgeSystem)> = problem
        .edges
        .iter()
        .map(|&f| (f, edge_system(geometry, f, options)))
        .collect();
    let sources: Vec<usize> = {
        let mut all: Vec<usize> = problem.edges.iter().map(|f| f.source).collect();
        all.sort_unstable();
        all.dedup();
        all
    };
    let place = |frame: usize| window.contains(&frame).then(|| 6 * (frame - window.start));
    let (mut h, mut v) = (
        DMatrix::<f64>::zeros(size, size),
        DVector::<f64>::zeros(size),
    );
    let mut e = DMatrix::<f64>::zeros(size, sources.len() * len);
    let (mut c, mut b) = (
        vec![0.0; sources.len() * len],
        vec![0.0; sources.len() * len],
    );
    for (f, s) in &systems {
        let k = sources.iter().position(|&x| x == f.source)?;
        let places = [place(f.source), place(f.target)];
        for (x, row) in places.iter().enumerate() {
            let Some(row) = *row else { continue };
            for (y, column) in places.iter().enumerate() {
                if let Some(column) = *column {
                    let mut block = h.fixed_view_mut::<6, 6>(row, column);
                    block += s.h[x][y];
                }
            }
            let mut part = v.fixed_rows_mut::<6>(row);
            part += s.v[x];
            for p in 0..len {
                let mut part = e.fixed_view_mut::<6, 1>(row, k * len + p);
                part += s.e[x][p];
            }
            if focal {
                for a in 0..6 {
                    h[(n, row + a)] += s.focal_h[x][a];
                    h[(row + a, n)] += s.focal_h[x][a];
                }
            }
        }
        for p in 0..len {
            c[k * len + p] += s.c[p];
            b[k * len + p] += s.b[p];
            if focal {
                e[(n, k * len + p)] += s.focal_e[p];
            }
        }
        if focal {
            h[(n, n)] += s.focal;
            v[n] += s.focal_v;
        }
    }
    for i in 0..size {
        h[(i, i)] += options.ep + options.lm * h[(i, i)];
    }
    #[cfg(test)]
    if options.python_twin && !options.free.depth() {
        for (i, j) in (0..size).flat_map(|i| (0..size).map(move |j| (i, j))) {
            if i != j && i % 6 == j % 6 {
                h[(i, j)] += options.ep + options.lm * h[(i, j)];
            }
        }
    }
    if !options.free.depth() {
        let poses = Cholesky::new(h)?.solve(&v);
        return Some(Step {
            poses,
            focal: 0.0,
            disparity: BTreeMap::new(),
        });
    }
    for (k, &frame) in sources.iter().enumerate() {
        for p in 0..len {
            let (more_c, more_b) = depth_prior(
                options.prior_alpha,
                problem.eta[frame][p],
                geometry.disparity[frame][p],
                geometry.sensor[frame][p],
            );
            c[k * len + p] += more_c;
            b[k * len + p] += more_b;
        }
    }
    let mut scaled = e.clone();
    for (mut column, c) in scaled.column_iter_mut().zip(&c) {
        column /= *c;
    }
    let b = DVector::from_vec(b);
    let reduced = h - &scaled * e.transpose();
    let rhs = v - &scaled * &b;
    let dx = Cholesky::new(reduced)?.solve(&rhs);
    let mut dz = b - e.transpose() * &dx;
    for (z, c) in dz.iter_mut().zip(&c) {
        *z /= c;
    }
    let disparity = sources
        .iter()
        .enumerate()
        .map(|(k, &frame)| (frame, dz.as_slice()[k * len..(k + 1) * len].to_vec()))
        .collect();
    Some(Step {
        focal: if focal { dx[n] } else { 0.0 },
        poses: dx.rows(0, n).into_owned(),
        disparity,
    })
}
