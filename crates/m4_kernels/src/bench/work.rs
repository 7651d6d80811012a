//! The minimum work of a kernel: bytes, operations, evaluations.
//!
//! **Bytes** are compulsory traffic: every input of the kernel read once and every output written
//! once, in the layout that they have (`f32` columns, 40 bytes a projected splat, a line of 64
//! bytes for its sums, 4 bytes an entry of a tile list, `f32` planes). Of the columns only the rows
//! count that the instant shows (forward) or that the frame touched (backward, Adam). What a kernel
//! keeps for itself between its passes (keys of the sort, maps of SSIM) is not compulsory and does
//! not count.
//!
//! **Operations** are those of the definition on one lane, counted by hand: a multiply-add, root,
//! division or comparison is 1, an `exp` 11, a `log2` 14. Good to a fifth.
//!
//! **Evaluations** are pairs of a pixel and a splat that changes it
//! ([`super::useful_evaluations`]).

use crate::{
    Kernel, View,
    blend::reference::walk,
    ellipse::{
        ALPHA_MIN,
        reference::{Ellipse, Hard},
    },
    reference::{Setup, Splat, ellipses, splats_of},
    slice::MARGINAL_MIN,
    tile_binning::{TILE, handover::FIELDS, reference::grid},
};
use m4_core::{Column, Splats};
use rayon::prelude::*;

/// What a frame is made of.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Of the image.
    pub pixels: usize,
    /// Rows of the scene.
    pub splats: usize,
    /// Static splats, and dynamic ones that live at this instant.
    pub alive: [usize; 2],
    /// Splats that reach the image.
    pub visible: usize,
    /// Static and dynamic splats that changed a pixel.
    pub touched: [usize; 2],
    /// Entries of all tile lists.
    pub pairs: usize,
    /// Entries that were looked at before every pixel of the tile was finished.
    pub used: usize,
    /// Pairs of a pixel and a splat that changes it.
    pub useful: u64,
    /// Columns that every splat has.
    pub shared_columns: usize,
}

impl Counts {
    /// Share of the evaluated lanes that changed a pixel, 0..1.
    pub fn useful_share(&self) -> f64 {
        self.useful as f64 / ((self.used * TILE * TILE) as f64).max(1.0)
    }
}

/// What a kernel has to do for one frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Work {
    /// Compulsory traffic.
    pub bytes: f64,
    /// On one lane each.
    pub operations: f64,
    /// Pixel-gaussian evaluations that change a pixel; 0 for kernels that do not blend.
    pub evaluations: f64,
    /// Things that the kernel goes through: see [`Kernel::item`].
    pub items: f64,
}

/// Columns that dynamic splats have besides.
const TIME_COLUMNS: usize = 5;
/// A number, in bytes.
const NUMBER: f64 = 4.0;
/// A projected splat, in bytes.
const SPLAT: f64 = FIELDS as f64 * NUMBER;
/// Its sums, in bytes.
const SUMS: f64 = 64.0;

impl Kernel {
    /// What it has to do for a frame; see the head of this file for what counts.
    #[must_use]
    pub fn work(self, c: &Counts) -> Work {
        let (shared, time) = (c.shared_columns as f64, TIME_COLUMNS as f64);
        // numbers in the columns of this many static and dynamic splats
        let columns = |[n_static, n_dynamic]: [usize; 2]| {
            (n_static + n_dynamic) as f64 * shared + n_dynamic as f64 * time
        };
        let (alive, touched) = (
            (c.alive[0] + c.alive[1]) as f64,
            (c.touched[0] + c.touched[1]) as f64,
        );
        let (visible, pixels, used) = (c.visible as f64, c.pixels as f64, c.used as f64);
        let colours = shared - 11.0;
        let useful = c.useful as f64;
        let planes = |n: usize| pixels * n as f64 * NUMBER;
        match self {
            // slice 70, life 35, place 12, ellipse 90, opacity 15, logarithm 14, extent 50, colour
            Self::Project => Work {
                bytes: columns(c.alive) * NUMBER + visible * SPLAT,
                operations: alive * (251.0 + 2.0 * colours) + c.alive[1] as f64 * 35.0,
                evaluations: 0.0,
                items: alive,
            },
            Self::Bin => Work {
                bytes: visible * SPLAT + c.pairs as f64 * NUMBER,
                operations: 0.0,
                evaluations: 0.0,
                items: c.pairs as f64,
            },
            Self::Blend => Work {
                bytes: visible * SPLAT + used * NUMBER + planes(4),
                operations: 0.0,
                evaluations: useful,
                items: used,
            },
            // a channel: two blurs of three images, 11 taps along each axis, 25 for SSIM, 10 for
            // the rest
            Self::Photo => Work {
                // the image, its gradient, three bytes of the target
                bytes: planes(6) + 3.0 * pixels,
                operations: 3.0 * pixels * (2.0 * 3.0 * 22.0 + 35.0),
                evaluations: 0.0,
                items: pixels,
            },
            Self::BlendBackward => Work {
                bytes: visible * (SPLAT + SUMS) + used * NUMBER + planes(7),
                operations: 0.0,
                evaluations: useful,
                items: used,
            },
            // forward again without extent and colour, projection 200, slice 80, colour
            Self::ProjectBackward => Work {
                bytes: visible * SUMS
                    + 2.0 * columns(c.touched) * NUMBER
                    + c.splats as f64
                    + 8.0 * touched,
                operations: touched * (460.0 + 4.0 * colours) + c.touched[1] as f64 * 60.0,
                evaluations: 0.0,
                items: touched,
            },
            // parameter and moments read and written, gradient read; count; mark
            Self::Adam => Work {
                bytes: columns(c.touched) * 7.0 * NUMBER + 8.0 * touched + c.splats as f64,
                operations: columns(c.touched) * 14.0,
                evaluations: 0.0,
                items: touched,
            },
        }
    }
}
/// Dynamic splats whose temporal marginal at `t` (frames) is above [`MARGINAL_MIN`].
pub(super) fn alive(splats: &Splats, t: f64) -> usize {
    let means = splats.column(Column::TimeMean, 0);
    let log_sds = splats.column(Column::LogTimeSd, 0);
    let marginal = |(&mean, &log_sd): (&f32, &f32)| {
        let x = (t - f64::from(mean)) * f64::from(-log_sd).exp();
        (-0.5 * x * x).exp()
    };
    means
        .iter()
        .zip(log_sds)
        .filter(|&s| marginal(s) > MARGINAL_MIN)
        .count()
}

/// Pairs of a pixel and a splat that is composited on it, by the definition of compositing
/// ([`crate::blend::reference::walk`]), over the whole frame: what no renderer can leave out.
///
/// Tiles here only save time: a splat is offered to every tile that its bounding box meets.
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
    let half = [
        (reach * e.conic[(1, 1)] / det).sqrt(),
        (reach * e.conic[(0, 0)] / det).sqrt(),
    ];
    let mut out = ([0; 2], [0; 2]);
    for (axis, tiles) in [columns, rows].into_iter().enumerate() {
        let tile = |v: f32| (v / TILE as f32).floor();
        let (first, last) = (
            tile(e.centre[axis] - half[axis] - 1.0),
            tile(e.centre[axis] + half[axis] + 1.0),
        );
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
        blend::reference::walk,
        ellipse::reference::Hard,
        reference::{Setup, ellipses, splats_of},
    };

    #[test]
    fn tiles_lose_no_pixel() {
        let config = SceneConfig {
            splats: 400,
            width: 61,
            height: 43,
            kind: SceneKind::FourD,
        };
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
