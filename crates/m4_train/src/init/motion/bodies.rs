//! Groups points into rigid bodies.

use std::collections::BTreeMap;

/// A number for the body of every point: points in the same or in touching cells of edge `gap` (world units) are
/// one body. Bodies are numbered from 0, in the order of their first points.
pub(crate) fn bodies(points: impl Iterator<Item = [f32; 3]>, gap: f32) -> Vec<usize> {
    let cells: Vec<[i32; 3]> = points.map(|p| p.map(|v| (v / gap).floor() as i32)).collect();
    let mut of_cell: BTreeMap<[i32; 3], usize> = BTreeMap::new();
    for cell in &cells {
        let next = of_cell.len();
        of_cell.entry(*cell).or_insert(next);
    }
    let mut parent: Vec<usize> = (0..of_cell.len()).collect();
    for (cell, &i) in &of_cell {
        for step in 0..27 {
            let [x, y, z] = [step % 3 - 1, step / 3 % 3 - 1, step / 9 - 1];
            let other = [cell[0].saturating_add(x), cell[1].saturating_add(y), cell[2].saturating_add(z)];
            if let Some(&j) = of_cell.get(&other) {
                let (a, b) = (root(&mut parent, i), root(&mut parent, j));
                parent[a.max(b)] = a.min(b);
            }
        }
    }
    let mut number: BTreeMap<usize, usize> = BTreeMap::new();
    cells
        .iter()
        .map(|cell| {
            let body = root(&mut parent, of_cell[cell]);
            let next = number.len();
            *number.entry(body).or_insert(next)
        })
        .collect()
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

#[cfg(test)]
mod tests {
    use super::bodies;

    #[test]
    fn a_chain_is_one_body_and_a_gap_makes_two() {
        let chain = (0..20).map(|i| [0.9 * i as f32, -3.0, 0.5 * i as f32]);
        let far = (0..3).map(|i| [50.0, i as f32, 0.0]);
        let got = bodies(far.chain(chain), 1.0);
        assert_eq!(got[..3], [0; 3]);
        assert_eq!(got[3..], [1; 20]);
        assert!(bodies(std::iter::empty(), 1.0).is_empty());
    }

    #[test]
    fn infinite_and_nan_positions_do_not_panic() {
        let got = bodies([[f32::NAN; 3], [1e30, -1e30, 0.0], [f32::INFINITY; 3]].into_iter(), 1e-3);
        assert_eq!(got.len(), 3);
    }
}
