//! Counts the splats visible at an instant and the pixels that they change, in separate slow passes, so that kernels count nothing.

use crate::{
    View,
    blend::{
        ALPHA_MIN,
        reference::{Ellipse, Hard, walk},
    },
    reference::{Setup, Splat, ellipses, splats_of},
    slice::MARGINAL_MIN,
    tile_binning::{TILE, reference::grid},
};
use m4_core::{Column, Splats};
use rayon::prelude::*;

/// Dynamic splats whose temporal marginal at `t` (frames) is above [`MARGINAL_MIN`].
pub(super) fn alive(splats: &Splats, t: f64) -> usize {
    let means = splats.column(Column::TimeMean, 0);
    let log_sds = splats.column(Column::LogTimeSd, 0);
    let marginal = |(&mean, &log_sd): (&f32, &f32)| {
        let x = (t - f64::from(mean)) * f64::from(-log_sd).exp();
        (-0.5 * x * x).exp()
    };
    means.iter().zip(log_sds).filter(|&s| marginal(s) > MARGINAL_MIN).count()
}

/// Pairs of a pixel and a splat that is composited on it, by the definition of compositing
/// ([`crate::blend::reference::walk`]), over the whole frame: what no renderer can leave out.
///
/// Tiles here only save time: a splat is offered to every tile that its bounding box meets.
#[must_use]
pub fn useful_evaluations(splats: &Splats, view: &View) -> u64 {
    let setup = Setup::<f32>::new(view);
    let all: Vec<Splat<f32>> = splats_of(splats);
    let ellipses = ellipses(&all, &setup);
    let (columns, rows) = grid(setup.width, setup.height);
    let mut tiles = vec![Vec::<u32>::new(); columns * rows];
    for (index, ellipse) in ellipses.iter().enumerate() {
        let Some(([left, top], [right, bottom])) = tile_box(ellipse, columns, rows) else {
            continue;
        };
        for y in top..=bottom {
            for tile in &mut tiles[y * columns + left..=y * columns + right] {
                tile.push(index as u32);
            }
        }
    }
    let counts = tiles.par_iter().enumerate().map(|(tile, list)| {
        let list: Vec<Ellipse<f32>> = list.iter().map(|&i| ellipses[i as usize]).collect();
        let (x, y) = (tile % columns * TILE, tile / columns * TILE);
        let mut count = 0u64;
        for y in y..(y + TILE).min(setup.height) {
            for x in x..(x + TILE).min(setup.width) {
                walk::<f32, Hard>(&list, x, y, |_| count += 1);
            }
        }
        count
    });
    counts.sum()
}

/// First and last tile that the ellipse `alpha >= ALPHA_MIN` can meet.
fn tile_box(e: &Ellipse<f32>, columns: usize, rows: usize) -> Option<([usize; 2], [usize; 2])> {
    let reach = 2.0 * (e.opacity / ALPHA_MIN as f32).ln();
    let det = e.conic.determinant();
    if !(reach >= 0.0 && det > 0.0) {
        return None;
    }
    let half = [(reach * e.conic[(1, 1)] / det).sqrt(), (reach * e.conic[(0, 0)] / det).sqrt()];
    let mut out = ([0; 2], [0; 2]);
    for (axis, tiles) in [columns, rows].into_iter().enumerate() {
        let tile = |v: f32| (v / TILE as f32).floor();
        let (first, last) = (tile(e.centre[axis] - half[axis] - 1.0), tile(e.centre[axis] + half[axis] + 1.0));
        if !(last >= 0.0 && first < tiles as f32) {
            return None;
        }
        out.0[axis] = first.max(0.0) as usize;
        out.1[axis] = (last as usize).min(tiles - 1);
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::useful_evaluations;
    use crate::{
        bench::{BenchScene, SceneConfig, SceneKind},
        blend::reference::{Hard, walk},
        reference::{Setup, ellipses, splats_of},
    };

    #[test]
    fn tiles_lose_no_pixel() {
        let config =
            SceneConfig { splats: 400, width: 61, height: 43, kind: SceneKind::FourD, ..SceneConfig::default() };
        let scene = BenchScene::new(&config).unwrap();
        let view = &scene.views[3];
        let all = ellipses(&splats_of::<f32>(&scene.splats), &Setup::new(view));
        let mut want = 0;
        for (x, y) in (0..61 * 43).map(|i| (i % 61, i / 61)) {
            walk::<f32, Hard>(&all, x, y, |_| want += 1);
        }
        assert!(want > 2 * 61 * 43, "{want}");
        assert_eq!(useful_evaluations(&scene.splats, view), want);
    }
}
