//! The backward pass, from pixels to splats: the replay form (docs/spec/optimiser.md 1.7), front to
//! back.
//!
//! Sums over pixels are products of matrices. For a splat on a tile there are two rows of sixteen
//! numbers, `omega` and the weight `w`; the sums wanted are those of `omega` times
//! `1, X, Y, XX, XY, YY` and of `w` times the gradients of the channels. So the rows are stored
//! interleaved, and for each pixel the pair `(omega, w)` is loaded into all lanes and multiplied
//! with a row of a table that has `1, v_red, X, v_green, Y, v_blue, ...` of that pixel: sixteen
//! multiplications and additions, no shuffles, and the sums of a splat come out side by side, as
//! [`Sums`] wants them.
//!
//! `X` and `Y` count from the middle of the block; the sums are moved to the splat's centre once a
//! block.

use super::{
    BLOCK_TILES, CHUNK, COLUMN, Copies, Pixels, ROW, Sums, T_FLOOR, Used, alpha, copy, step,
};
use crate::{
    blend::planes::{BandGradient, BandPlace, PIXELS},
    ellipse::ALPHA_MAX,
    simd::{all, all3},
    tile_binning::{
        TILE,
        cpu::{BAND_ROWS, BLOCK_COLUMNS, BLOCK_WIDTH, Band, Record},
        handover::Row,
    },
};
use fearless_simd::{Simd, f32x16, f64x8, prelude::*};
use fearless_simd_macros::simd;

/// Splats that go through one stage after another: as many as pays, unlike the forward pass this
/// one knows where it ends.
const BATCH: usize = 32;
/// The middle of a block, from its first pixel.
const MIDDLE: [f32; 2] = [0.5 * (BLOCK_WIDTH - 1) as f32, 0.5 * (BAND_ROWS - 1) as f32];
/// Lanes of the moments of `omega`, [`Sums`].
const EVEN: [usize; 6] = [
    Sums::WEIGHT,
    Sums::FIRST[0],
    Sums::FIRST[1],
    Sums::SECOND[0],
    Sums::SECOND[1],
    Sums::SECOND[2],
];
/// For each pixel of each tile of a block: `1, X, Y, XX, XY, YY` in their lanes.
static MOMENTS: [[[f32; 16]; PIXELS]; BLOCK_TILES] = moments();

const fn moments() -> [[[f32; 16]; PIXELS]; BLOCK_TILES] {
    let mut out = [[[0.0; 16]; PIXELS]; BLOCK_TILES];
    let mut tile = 0;
    while tile < BLOCK_TILES {
        let mut p = 0;
        while p < PIXELS {
            let x = COLUMN[p] + (tile % BLOCK_COLUMNS * TILE) as f32 - MIDDLE[0];
            let y = ROW[p] + (tile / BLOCK_COLUMNS * TILE) as f32 - MIDDLE[1];
            let values = [1.0, x, y, x * x, x * y, y * y];
            let mut k = 0;
            while k < EVEN.len() {
                out[tile][p][EVEN[k]] = values[k];
                k += 1;
            }
            p += 1;
        }
        tile += 1;
    }
    out
}

/// 1 in the lane of a channel, 0 elsewhere.
const fn unit(lane: usize) -> [f32; 16] {
    let mut out = [0.0; 16];
    out[lane] = 1.0;
    out
}
const UNITS: [[f32; 16]; 3] = [unit(Sums::RGB[0]), unit(Sums::RGB[1]), unit(Sums::RGB[2])];

/// The pixels of a tile: the gradient with respect to them, and how far they are.
#[derive(Clone, Copy)]
struct State<S: Simd> {
    /// Falls on after the end.
    t: f32x16<S>,
    /// `<g, C>`, all channels together, of what is still behind.
    behind: f32x16<S>,
    rgb: [f32x16<S>; 3],
}

/// What a batch hands from stage to stage.
struct Stages {
    alpha: [[f32; PIXELS]; BATCH],
    /// The splat's channels along the gradient.
    along: [[f32; PIXELS]; BATCH],
    /// `(omega, w)` of each pixel; pairs as one number, to be loaded at once.
    pairs: [[f64; PIXELS]; BATCH],
}

/// Adds up a band's gradient: `sums[i]` for its splat `i`; returns the gradient with respect to the
/// background. `used` is what [`forward`](super::forward()) left.
#[simd]
pub(crate) fn backward<S: Simd>(
    s: S,
    band: &Band,
    rows: &[Row],
    place: BandPlace,
    used: &Used,
    g: &BandGradient<'_>,
    sums: &mut Vec<Sums>,
) -> [f64; 3] {
    sums.clear();
    sums.resize(band.splats(), Sums::default());
    // blocks look splats and pixels up out of order: read in order they come into the cache much
    // faster, and there they stay for the band
    band.touch(rows);
    for plane in g.rgb.iter().chain(&g.d_rgb).chain([&g.transmittance]) {
        touch(plane.iter().step_by(16).copied());
    }
    let zero = all(s, 0.0);
    let mut background = [zero; 3];
    let mut replayed = used.replay();
    let mut records = [Record::default(); CHUNK];
    let mut stages = Stages {
        alpha: [[0.0; PIXELS]; BATCH],
        along: [[0.0; PIXELS]; BATCH],
        pairs: [[0.0; PIXELS]; BATCH],
    };
    let mut totals = [Sums::default(); CHUNK];
    for block in 0..place.blocks() {
        let mut states = [State {
            t: zero,
            behind: zero,
            rgb: [zero; 3],
        }; BLOCK_TILES];
        for (tile, state) in states.iter_mut().enumerate() {
            *state = fresh(s, place, block, tile, g, &mut background);
        }
        for chunk in band.list(block)[..used.walked[block] as usize].chunks(CHUNK) {
            copy(chunk, rows, &mut records);
            totals[..chunk.len()].fill(Sums::default());
            for (tile, (state, list)) in states.iter_mut().zip(replayed.chunk()).enumerate() {
                let pixels = Pixels::new(s, place, block, tile);
                let table = table(s, tile, state);
                for batch in list.chunks(BATCH) {
                    shapes(s, batch, &records, &pixels, state, &mut stages);
                    replay(s, batch.len(), state, &mut stages);
                    add_sums(s, batch, &stages, &table, &mut totals);
                }
            }
            let (x, y) = place.corner(block, 0);
            let middle = [all(s, x as f32 + MIDDLE[0]), all(s, y as f32 + MIDDLE[1])];
            for ((entry, r), total) in chunk.iter().zip(&records).zip(&totals) {
                let (dx, dy) = (all(s, r.x) - middle[0], all(s, r.y) - middle[1]);
                add_centred(s, dx, dy, &total.0, &mut sums[entry.index()].0);
            }
        }
    }
    background.map(|v| {
        let lanes: [f32; 16] = v.to_array();
        lanes.iter().map(|&v| f64::from(v)).sum()
    })
}

/// Reads, one after another: a sum would be read sixteen lines at a time, which is slower.
fn touch(values: impl Iterator<Item = f32>) {
    values.for_each(|value| {
        std::hint::black_box(value);
    });
}

/// The state of a tile before the first splat; adds its pixels to the gradient of the background.
#[inline(always)]
fn fresh<S: Simd>(
    s: S,
    place: BandPlace,
    block: usize,
    tile: usize,
    g: &BandGradient<'_>,
    background: &mut [f32x16<S>; 3],
) -> State<S> {
    let window = place.window(block, tile);
    let left = window.load(s, g.transmittance);
    let zero = all(s, 0.0);
    let mut state = State {
        t: f32x16::from_slice(s, &window.fresh(1.0, T_FLOOR)),
        behind: zero,
        rgb: [zero; 3],
    };
    for c in 0..3 {
        let v = window.load(s, g.d_rgb[c]);
        state.rgb[c] = v;
        state.behind = v.mul_add(window.load(s, g.rgb[c]), state.behind);
        background[c] = v.mul_add(left, background[c]);
    }
    state
}

/// What the pairs of each pixel of a tile are multiplied with.
#[inline(always)]
fn table<S: Simd>(s: S, tile: usize, state: &State<S>) -> [f32x16<S>; PIXELS] {
    let rgb: [[f32; PIXELS]; 3] = [
        state.rgb[0].to_array(),
        state.rgb[1].to_array(),
        state.rgb[2].to_array(),
    ];
    let mut out = [all(s, 0.0); PIXELS];
    for p in 0..PIXELS {
        let mut row = f32x16::from_slice(s, &MOMENTS[tile][p]);
        for c in 0..3 {
            row = all(s, rgb[c][p]).mul_add(f32x16::from_slice(s, &UNITS[c]), row);
        }
        out[p] = row;
    }
    out
}

/// `1 / x`: the processor's estimate and a step of Newton's, good to a few units in the last place.
#[inline(always)]
fn reciprocal<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let y = x.approximate_recip();
    y * (-x).mul_add(y, all(s, 2.0))
}

/// What does not depend on the splats in front.
#[inline(always)]
fn shapes<S: Simd>(
    s: S,
    batch: &[u8],
    records: &Copies,
    pixels: &Pixels<S>,
    state: &State<S>,
    out: &mut Stages,
) {
    for (n, &place) in batch.iter().enumerate().take(BATCH) {
        let r = &records[place as usize % CHUNK];
        let alpha = alpha(s, r, pixels);
        alpha.store_slice(&mut out.alpha[n]);
        let rgb = all3(s, &r.rgb);
        let along = rgb[0].mul_add(
            state.rgb[0],
            rgb[1].mul_add(state.rgb[1], rgb[2] * state.rgb[2]),
        );
        along.store_slice(&mut out.along[n]);
    }
}

/// Walks on over a batch of `len`: from transmittance and light to `(omega, w)`.
#[inline(always)]
fn replay<S: Simd>(s: S, len: usize, state: &mut State<S>, stages: &mut Stages) {
    let (alpha_max, zero, one) = (all(s, ALPHA_MAX as f32), all(s, 0.0), all(s, 1.0));
    let (mut t, mut behind) = (state.t, state.behind);
    for n in 0..len.min(BATCH) {
        let alpha = f32x16::from_slice(s, &stages.alpha[n]);
        let along = f32x16::from_slice(s, &stages.along[n]);
        let step = step(s, alpha, t);
        behind = (-step.weight).mul_add(along, behind);
        // alpha dL/d(alpha), 0 where nothing is blended and where alpha was cut
        let odds = alpha * reciprocal(s, one - alpha);
        let omega = step.weight.mul_add(along, -(behind * odds));
        let omega = (step.pass & alpha.simd_lt(alpha_max)).select(omega, zero);
        t = step.t;
        let (low, high) = stages.pairs[n].split_at_mut(PIXELS / 2);
        let pairs = |v: f32x16<S>| -> f64x8<S> { v.bitcast() };
        pairs(omega.zip_low(step.weight)).store_slice(low);
        pairs(omega.zip_high(step.weight)).store_slice(high);
    }
    (state.t, state.behind) = (t.max(all(s, T_FLOOR)), behind);
}

/// Adds the sums of a batch to its entries' `totals`.
#[inline(always)]
fn add_sums<S: Simd>(
    s: S,
    batch: &[u8],
    stages: &Stages,
    table: &[f32x16<S>; PIXELS],
    totals: &mut [Sums; CHUNK],
) {
    for (&place, row) in batch.iter().zip(&stages.pairs) {
        let pair = |p: usize| -> f32x16<S> { f64x8::splat(s, row[p]).bitcast() };
        let mut sum = [
            pair(0) * table[0],
            pair(1) * table[1],
            pair(2) * table[2],
            pair(3) * table[3],
        ];
        for p in (4..PIXELS).step_by(4) {
            for k in 0..4 {
                sum[k] = pair(p + k).mul_add(table[p + k], sum[k]);
            }
        }
        let total = &mut totals[place as usize % CHUNK].0;
        let sum = (sum[0] + sum[1]) + (sum[2] + sum[3]);
        (f32x16::from_slice(s, total) + sum).store_slice(total);
    }
}

/// A vector with some lanes other than 0.
const fn lanes<const N: usize>(values: [(usize, f32); N]) -> [f32; 16] {
    let mut out = [0.0; 16];
    let mut k = 0;
    while k < N {
        out[values[k].0] = values[k].1;
        k += 1;
    }
    out
}
const X: usize = Sums::FIRST[0];
const Y: usize = Sums::FIRST[1];
const XX: usize = Sums::SECOND[0];
const XY: usize = Sums::SECOND[1];
const YY: usize = Sums::SECOND[2];

/// Moves an entry's sums from the middle of the block to the splat's centre, `(dx, dy)` from there,
/// and adds them to its splat.
///
/// With the sums `S, SX, SY, ...` about the middle, those about the centre are `dx S - SX`,
/// `dx dx S - 2 dx SX + SXX`, `dx dy S - dy SX - dx SY + SXY` and so on: each of `S`, `SX` and `SY`
/// times a vector, and the sums themselves with signs.
#[inline(always)]
fn add_centred<S: Simd>(
    s: S,
    dx: f32x16<S>,
    dy: f32x16<S>,
    total: &[f32; 16],
    sum: &mut [f32; 16],
) {
    const SIGNS: [f32; 16] = {
        let mut out = [1.0; 16];
        (out[X], out[Y]) = (-1.0, -1.0);
        out
    };
    let form = |x: &[f32; 16], y: &[f32; 16]| {
        f32x16::from_slice(s, x) * dx + f32x16::from_slice(s, y) * dy
    };
    // dx, dy, dx dx, dx dy, dy dy
    let one = const { lanes([(X, 1.0), (Y, 1.0)]) };
    let of_weight = form(
        &const { lanes([(X, 1.0), (XX, 1.0), (XY, 1.0)]) },
        &const { lanes([(Y, 1.0), (YY, 1.0)]) },
    ) * (form(
        &const { lanes([(XX, 1.0)]) },
        &const { lanes([(XY, 1.0), (YY, 1.0)]) },
    ) + f32x16::from_slice(s, &one));
    let of_x = form(
        &const { lanes([(XX, -2.0)]) },
        &const { lanes([(XY, -1.0)]) },
    );
    let of_y = form(
        &const { lanes([(XY, -1.0)]) },
        &const { lanes([(YY, -2.0)]) },
    );
    let mut moved = f32x16::from_slice(s, total)
        .mul_add(f32x16::from_slice(s, &SIGNS), f32x16::from_slice(s, sum));
    moved = all(s, total[Sums::WEIGHT]).mul_add(of_weight, moved);
    moved = all(s, total[X]).mul_add(of_x, moved);
    moved = all(s, total[Y]).mul_add(of_y, moved);
    moved.store_slice(sum);
}
