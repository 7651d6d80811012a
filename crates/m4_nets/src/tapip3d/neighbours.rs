//! The nearest points of a map: exact, and the same for any order of work.
//!
//! A map has some ten thousand points, row by row, so that points that follow each other are near
//! each other: boxes around runs of them rule nearly all out. Of points at the same distance the
//! one that comes first in the map is the nearer.

/// Points of a run.
const RUN: usize = 32;
/// Runs that are looked at first, those whose boxes are nearest.
const FIRST: usize = 4;

/// Points, and boxes around runs of them.
#[derive(Debug, Clone)]
pub struct Cloud {
    points: Vec<[f32; 3]>,
    /// A coordinate of all points after the other.
    axes: [Vec<f32>; 3],
    low: [Vec<f32>; 3],
    high: [Vec<f32>; 3],
}

#[derive(Debug, Default)]
pub struct Search {
    bounds: Vec<f32>,
    order: Vec<u32>,
    /// Squared distance and number of the nearest points so far, in order.
    best: Vec<(f32, u32)>,
}

impl Cloud {
    pub fn new(points: Vec<[f32; 3]>) -> Self {
        let axes = [0, 1, 2].map(|axis| points.iter().map(|p| p[axis]).collect::<Vec<f32>>());
        let fold = |axis: usize, start: f32, f: fn(f32, f32) -> f32| -> Vec<f32> {
            let runs = axes[axis].chunks(RUN);
            runs.map(|run| run.iter().copied().fold(start, f)).collect()
        };
        let low = [0, 1, 2].map(|axis| fold(axis, f32::INFINITY, f32::min));
        let high = [0, 1, 2].map(|axis| fold(axis, f32::NEG_INFINITY, f32::max));
        Self {
            points,
            axes,
            low,
            high,
        }
    }

    pub fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    /// The numbers of the `k` points nearest to `q`, nearest first; all, if there are fewer.
    pub fn nearest<'a>(
        &self,
        q: [f32; 3],
        k: usize,
        search: &'a mut Search,
    ) -> impl Iterator<Item = u32> + use<'a> {
        let Search {
            bounds,
            order,
            best,
        } = search;
        best.clear();
        self.bounds(q, bounds);
        let runs = bounds.len();
        order.clear();
        order.extend(0..runs as u32);
        let first = FIRST.min(runs);
        if first < runs {
            order.select_nth_unstable_by(first, |&a, &b| {
                bounds[a as usize]
                    .total_cmp(&bounds[b as usize])
                    .then(a.cmp(&b))
            });
        }
        for &run in &order[..first] {
            self.scan(run as usize, q, k, best);
            bounds[run as usize] = f32::INFINITY;
        }
        for run in 0..runs {
            // a box at the distance of the worst may hold a point of a smaller number
            if bounds[run] <= worst(best, k) && bounds[run] < f32::INFINITY {
                self.scan(run, q, k, best);
            }
        }
        best.iter().map(|&(_, i)| i)
    }

    /// Squared distances to the boxes: none is above that to a point in it, as the same operations
    /// round them.
    fn bounds(&self, q: [f32; 3], bounds: &mut Vec<f32>) {
        bounds.clear();
        bounds.resize(self.low[0].len(), 0.0);
        for axis in 0..3 {
            let sides = self.low[axis].iter().zip(&self.high[axis]);
            for (bound, (low, high)) in bounds.iter_mut().zip(sides) {
                let d = (low - q[axis]).max(q[axis] - high).max(0.0);
                *bound += d * d;
            }
        }
    }

    fn scan(&self, run: usize, q: [f32; 3], k: usize, best: &mut Vec<(f32, u32)>) {
        let first = run * RUN;
        let n = RUN.min(self.points.len() - first);
        let mut squares = [0.0f32; RUN];
        for axis in 0..3 {
            for (square, x) in squares.iter_mut().zip(&self.axes[axis][first..first + n]) {
                let d = x - q[axis];
                *square += d * d;
            }
        }
        for (i, &square) in squares[..n].iter().enumerate() {
            let candidate = (square, (first + i) as u32);
            if best.len() == k {
                if !best
                    .last()
                    .is_some_and(|&last| comes_before(candidate, last))
                {
                    continue;
                }
                best.pop();
            }
            let place = best.partition_point(|&other| comes_before(other, candidate));
            best.insert(place, candidate);
        }
    }
}

fn comes_before(a: (f32, u32), b: (f32, u32)) -> bool {
    a.0 < b.0 || a.0 == b.0 && a.1 < b.1
}

fn worst(best: &[(f32, u32)], k: usize) -> f32 {
    match best.last() {
        Some(&(worst, _)) if best.len() == k => worst,
        _ => f32::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use m4_testkit::formula;

    fn by_sorting(points: &[[f32; 3]], q: [f32; 3], k: usize) -> Vec<u32> {
        let square = |p: &[f32; 3]| {
            let d = [0, 1, 2].map(|i| p[i] - q[i]);
            d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        };
        let mut all: Vec<(f32, u32)> = points.iter().map(square).zip(0..).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.into_iter().take(k).map(|(_, i)| i).collect()
    }

    #[test]
    fn neighbours_match_sorting() {
        let u: Vec<f32> = formula("points", 3 * 2000).map(|u| u as f32).collect();
        let surface: Vec<[f32; 3]> = (0..2000)
            .map(|i| {
                let (x, y) = ((i % 50) as f32, (i / 50) as f32);
                [x, y, 0.3 * (x * 0.2).sin() + 0.01 * u[i]]
            })
            .collect();
        let grid: Vec<[f32; 3]> = surface.iter().map(|p| [p[0], p[1], 0.0]).collect();
        let mut same = u.as_chunks::<3>().0.to_vec();
        same[300..900].fill([0.1, 0.2, 0.3]);
        let mut search = Search::default();
        for points in [surface, grid, same] {
            let cloud = Cloud::new(points.clone());
            for q in 0..300 {
                let q =
                    [u[q] * 30.0, u[q + 300] * 25.0, u[q + 600]].map(|x| (x * 4.0).round() / 4.0);
                let got: Vec<u32> = cloud.nearest(q, 32, &mut search).collect();
                assert_eq!(got, by_sorting(&points, q, 32), "{q:?}");
            }
        }
        let few = Cloud::new(vec![[0.0; 3], [1.0; 3]]);
        assert_eq!(
            few.nearest([1.0; 3], 32, &mut search).collect::<Vec<_>>(),
            [1, 0]
        );
    }
}
