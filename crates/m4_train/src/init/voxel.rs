//! Merges points into one centroid per voxel, in a fixed order (Minute4D sec. 3.1).

use crate::init::{CellSize, cloud::Cloud};
use rayon::prelude::*;

/// Bits of a cell index along one axis.
const BITS: u32 = 21;
/// Cells along one axis; points beyond are counted to the outermost cell.
const CELLS: f32 = (1u32 << BITS) as f32;
/// Clouds that are made at a time.
const BATCH: usize = 4;

/// One centroid per voxel, sorted by voxel.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Centroids {
    /// Mean position, world units.
    pub xyz: Vec<[f32; 3]>,
    /// Mean colour, 0..1.
    pub rgb: Vec<[f32; 3]>,
    /// Edge of the voxel, world units.
    pub edge: Vec<f32>,
    /// Level and cell of the voxel.
    pub key: Vec<(i16, u64)>,
}

impl Centroids {
    /// The voxel that holds `p`; `grid` is the one that made these.
    pub fn find(&self, grid: &Grid, p: [f32; 3]) -> Option<usize> {
        self.key.binary_search(&grid.key(p)).ok()
    }
}

/// The size of a cell at each point of the world.
#[derive(Debug, Clone)]
pub(crate) struct Grid {
    /// Shift of the grid.
    origin: [f32; 3],
    /// Constant edge, or edge at unit distance.
    unit: f32,
    /// Cameras whose nearest counts: four a row, one component after the other; empty for a
    /// constant edge.
    centres: Vec<[[f32; LANES]; 3]>,
    /// Edge of each level, the lowest first.
    edges: Vec<f32>,
}

/// Cameras that are compared at once.
const LANES: usize = 4;
/// Highest level; the lowest is as far below 0.
const MOST_LEVEL: i16 = 60;

impl Grid {
    /// `pixels` at `depth`, or (depth-proportional) at the distance to the nearest camera.
    pub fn new(
        cells: CellSize,
        pixels: f32,
        focal_px: f64,
        depth: f64,
        centres: &[[f32; 3]],
        origin: [f32; 3],
    ) -> Self {
        let (unit, centres) = match cells {
            CellSize::Constant => (f64::from(pixels) * depth / focal_px, &[][..]),
            CellSize::DepthProportional => (f64::from(pixels) / focal_px, centres),
        };
        let unit = unit as f32;
        // the last camera fills the last row
        let row = |row: &[[f32; 3]]| {
            std::array::from_fn(|k| std::array::from_fn(|lane| row[lane.min(row.len() - 1)][k]))
        };
        let edge = |level: i16| unit * (0.5 * f32::from(level)).exp2();
        Self {
            origin,
            unit,
            centres: centres.chunks(LANES).map(row).collect(),
            edges: (-MOST_LEVEL..=MOST_LEVEL).map(edge).collect(),
        }
    }

    /// Level and edge at a point: `edge = unit` or `unit * sqrt(2)^level`.
    fn level(&self, p: [f32; 3]) -> (i16, f32) {
        if self.centres.is_empty() {
            return (0, self.unit);
        }
        let mut nearest = [f32::INFINITY; LANES];
        for [x, y, z] in &self.centres {
            for (lane, nearest) in nearest.iter_mut().enumerate() {
                let [dx, dy, dz] = [x[lane] - p[0], y[lane] - p[1], z[lane] - p[2]];
                let square = dx * dx + dy * dy + dz * dz;
                *nearest = if square < *nearest { square } else { *nearest };
            }
        }
        let nearest = nearest.into_iter().fold(f32::INFINITY, f32::min);
        // log base sqrt(2) of the distance is log2 of its square
        let most = f32::from(MOST_LEVEL);
        let level = nearest.max(1e-12).log2().round().clamp(-most, most) as i16;
        (level, self.edges[(level + MOST_LEVEL) as usize])
    }

    /// Edge of the cell of a point, world units.
    pub fn edge(&self, p: [f32; 3]) -> f32 {
        self.level(p).1
    }

    /// Sortable key of the cell of a point.
    pub fn key(&self, p: [f32; 3]) -> (i16, u64) {
        let (level, edge) = self.level(p);
        let axis = |k: usize| {
            // what is not negative is rounded down by the conversion
            ((p[k] - self.origin[k]) / edge + 0.5 * CELLS).clamp(0.0, CELLS - 1.0) as u64
        };
        (level, (axis(2) << (2 * BITS)) | (axis(1) << BITS) | axis(0))
    }

    /// The cells that hold a point, sorted.
    fn cells(&self, cloud: &Cloud) -> Vec<(i16, u64)> {
        let mut keys: Vec<_> = cloud.xyz.par_iter().map(|&p| self.key(p)).collect();
        keys.par_sort_unstable();
        keys.dedup();
        keys
    }

    /// The cell and the index of each point, sorted by cell, points of a cell in order.
    fn sorted_keys(&self, cloud: &Cloud) -> Vec<((i16, u64), u32)> {
        let keyed = |i: u32| (self.key(cloud.xyz[i as usize]), i);
        let mut keys: Vec<_> = (0..cloud.xyz.len() as u32)
            .into_par_iter()
            .map(keyed)
            .collect();
        // The index makes every entry unique, so an unstable sort has one result.
        keys.par_sort_unstable();
        keys
    }

    /// Number of cells that hold a point.
    pub fn occupied(&self, cloud: &Cloud) -> usize {
        self.cells(cloud).len()
    }

    /// Number of cells that hold a point of any of `parts`, which `cloud` makes points of.
    pub fn occupied_by<T: Sync>(&self, parts: &[T], cloud: impl Fn(&T) -> Cloud + Sync) -> usize {
        let mut all: Vec<(i16, u64)> = Vec::new();
        for batch in parts.chunks(BATCH) {
            let cells: Vec<_> = batch
                .par_iter()
                .map(|part| self.cells(&cloud(part)))
                .collect();
            all.extend(cells.iter().flatten());
            all.par_sort_unstable();
            all.dedup();
        }
        all.len()
    }

    /// The centroid of each occupied cell.
    pub fn merge(&self, cloud: &Cloud) -> Centroids {
        self.centroids(&added(&[], cloud, &self.sorted_keys(cloud)))
    }

    /// The same of points that count `weight` each.
    pub fn merge_weighted(&self, cloud: &Cloud, weight: &[f64]) -> Centroids {
        let sum = |cell: &[((i16, u64), u32)]| {
            let mut sum = Sum {
                key: cell[0].0,
                xyz: [0.0; 3],
                rgb: [0.0; 3],
                n: 0.0,
            };
            for i in cell.iter().map(|entry| entry.1 as usize) {
                let n = weight[i];
                for k in 0..3 {
                    sum.xyz[k] += n * f64::from(cloud.xyz[i][k]);
                    sum.rgb[k] += n * f64::from(cloud.rgb[i][k]);
                }
                sum.n += n;
            }
            sum
        };
        self.centroids(
            &self
                .sorted_keys(cloud)
                .chunk_by(|a, b| a.0 == b.0)
                .map(sum)
                .collect::<Vec<_>>(),
        )
    }

    /// The centroid of each cell that holds a point of any of `parts`, which `cloud` makes points
    /// of: the bits that [`merge`](Self::merge) makes of all their points in a row, without all of
    /// them in memory at once.
    pub fn merge_all<T: Sync>(&self, parts: &[T], cloud: impl Fn(&T) -> Cloud + Sync) -> Centroids {
        let mut all = Vec::new();
        for batch in parts.chunks(BATCH) {
            let sorted = |part| {
                let cloud = cloud(part);
                let keys = self.sorted_keys(&cloud);
                (cloud, keys)
            };
            let lists: Vec<_> = batch.par_iter().map(sorted).collect();
            all = lists
                .iter()
                .fold(all, |all, (cloud, keys)| added(&all, cloud, keys));
        }
        self.centroids(&all)
    }

    fn centroids(&self, sums: &[Sum]) -> Centroids {
        let of = |f: fn(&Sum) -> [f32; 3]| sums.iter().map(f).collect();
        let edge = |s: &Sum| self.unit * (0.5 * f32::from(s.key.0)).exp2();
        Centroids {
            xyz: of(|s| s.xyz.map(|v| (v / s.n) as f32)),
            rgb: of(|s| s.rgb.map(|v| (v / s.n / 255.0) as f32)),
            edge: sums.iter().map(edge).collect(),
            key: sums.iter().map(|s| s.key).collect(),
        }
    }
}

/// What is added up over the points of a cell.
#[derive(Debug, Clone, Copy)]
struct Sum {
    key: (i16, u64),
    xyz: [f64; 3],
    /// 0..255.
    rgb: [f64; 3],
    n: f64,
}

/// `sums`, sorted by cell, with the points of one more cloud, whose cells are `keys`, added one
/// after the other.
fn added(sums: &[Sum], cloud: &Cloud, keys: &[((i16, u64), u32)]) -> Vec<Sum> {
    let mut out = Vec::with_capacity(sums.len());
    let mut rest = sums.iter().copied().peekable();
    for cell in keys.chunk_by(|a, b| a.0 == b.0) {
        let key = cell[0].0;
        while let Some(sum) = rest.next_if(|sum| sum.key < key) {
            out.push(sum);
        }
        let mut sum = rest.next_if(|sum| sum.key == key).unwrap_or(Sum {
            key,
            xyz: [0.0; 3],
            rgb: [0.0; 3],
            n: 0.0,
        });
        for &(_, i) in cell {
            for k in 0..3 {
                sum.xyz[k] += f64::from(cloud.xyz[i as usize][k]);
                sum.rgb[k] += f64::from(cloud.rgb[i as usize][k]);
            }
        }
        sum.n += cell.len() as f64;
        out.push(sum);
    }
    out.extend(rest);
    out
}

/// The smallest number of pixels (at least `least`) whose grid has at most `target` cells, by
/// `count`.
///
/// Cells of a surface go with the inverse square of the edge, so a few secant steps suffice; the
/// result is within about 3 % of the target, never above it.
pub(crate) fn pixels_for(target: usize, least: f32, mut count: impl FnMut(f32) -> usize) -> f32 {
    let mut low = least;
    let mut n = count(low);
    if n <= target {
        return low;
    }
    let mut high: Option<f32> = None;
    let mut pixels = low;
    for _ in 0..12 {
        let guess = pixels * ((n as f32 / target as f32).sqrt() * 1.01).clamp(0.25, 8.0);
        pixels = match high {
            Some(high) if !(guess > low && guess < high) => (low * high).sqrt(),
            _ if guess <= low => low * 1.05,
            _ => guess,
        };
        n = count(pixels);
        if n > target {
            low = pixels;
        } else {
            high = Some(pixels);
            if n as f32 >= 0.97 * target as f32 {
                break;
            }
        }
        if high.is_some_and(|high| high / low < 1.01) {
            break;
        }
    }
    high.unwrap_or(pixels)
}

#[cfg(test)]
mod tests {
    use super::{Grid, pixels_for};
    use crate::init::{CellSize, cloud::Cloud};
    use m4_core::CounterRng;

    fn noise(n: usize) -> Cloud {
        let mut rng = CounterRng::new(1, 2, 3);
        Cloud {
            xyz: (0..n)
                .map(|_| {
                    [
                        rng.uniform() as f32 * 4.0 - 2.0,
                        rng.uniform() as f32 * 3.0,
                        2.0,
                    ]
                })
                .collect(),
            rgb: (0..n).map(|i| [(i % 256) as u8, 7, 200]).collect(),
        }
    }

    #[test]
    fn a_cell_becomes_its_centroid() {
        let grid = Grid::new(CellSize::Constant, 10.0, 100.0, 2.0, &[], [0.0; 3]);
        let cloud = Cloud {
            xyz: vec![[0.31, 0.01, 0.0], [0.01, 0.0, 0.0], [0.03, 0.1, 0.0]],
            rgb: vec![[255, 0, 0], [0, 0, 0], [0, 255, 0]],
        };
        let got = grid.merge(&cloud);
        assert_eq!(got.xyz.len(), 2);
        assert_eq!(got.xyz, [[0.02, 0.05, 0.0], [0.31, 0.01, 0.0]]);
        assert_eq!(got.rgb, [[0.0, 0.5, 0.0], [1.0, 0.0, 0.0]]);
        assert!((got.edge[0] - 0.2).abs() < 1e-6);
        assert_eq!(grid.occupied(&cloud), 2);
    }

    #[test]
    fn proportional_cells_grow_with_the_distance() {
        let grid = Grid::new(
            CellSize::DepthProportional,
            2.0,
            400.0,
            3.0,
            &[[0.0, 0.0, 0.0]],
            [0.0; 3],
        );
        let cloud = Cloud {
            xyz: vec![[0.0, 0.0, 1.0], [0.0, 0.0, 8.0]],
            rgb: vec![[0; 3]; 2],
        };
        let edge = grid.merge(&cloud).edge;
        assert!(
            (edge[0] - 0.005).abs() < 1e-6 && (edge[1] - 0.04).abs() < 1e-6,
            "{edge:?}"
        );
    }

    #[test]
    fn the_target_is_met_from_below() {
        let cloud = noise(200_000);
        let grid = |pixels| Grid::new(CellSize::Constant, pixels, 100.0, 2.0, &[], [0.0; 3]);
        for target in [300, 5_000, 60_000] {
            let pixels = pixels_for(target, 0.1, |p| grid(p).occupied(&cloud));
            let n = grid(pixels).occupied(&cloud);
            assert!(
                n <= target && n * 10 > target * 8,
                "{n} cells where at most {target} were asked"
            );
        }
        assert_eq!(
            pixels_for(1_000_000, 0.1, |p| grid(p).occupied(&cloud)),
            0.1
        );
    }

    #[test]
    fn parts_are_merged_to_the_same_bits_as_the_whole() {
        let whole = noise(20_000);
        // uneven parts, one of them empty
        let cuts = [0, 1, 7_000, 7_000, 7_100, 15_000, 19_999, 20_000];
        let parts: Vec<_> = cuts.windows(2).map(|w| w[0]..w[1]).collect();
        let part = |range: &std::ops::Range<usize>| Cloud {
            xyz: whole.xyz[range.clone()].to_vec(),
            rgb: whole.rgb[range.clone()].to_vec(),
        };
        for pixels in [0.01, 3.0, 1000.0] {
            let grid = Grid::new(CellSize::Constant, pixels, 100.0, 2.0, &[], [0.0; 3]);
            assert_eq!(grid.merge_all(&parts, part), grid.merge(&whole));
            assert_eq!(grid.occupied_by(&parts, part), grid.occupied(&whole));
        }
        let grid = Grid::new(CellSize::Constant, 1.0, 100.0, 2.0, &[], [0.0; 3]);
        assert_eq!(
            grid.merge_all(&parts[..0], part),
            grid.merge(&Cloud::default())
        );
    }

    #[test]
    fn threads_do_not_change_the_result() {
        let grid = Grid::new(CellSize::Constant, 3.0, 100.0, 2.0, &[], [0.0; 3]);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let parts: Vec<usize> = (0..9).collect();
            pool.install(|| grid.merge_all(&parts, |&i| noise(5_000 + i)))
        };
        assert_eq!(run(1), run(3));
    }
}
