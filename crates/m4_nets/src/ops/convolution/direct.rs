//! Convolutions with stride 1, padded by half their kernels, without a matrix of neighbourhoods.
//!
//! ```text
//! planes --pad--> [c][h + kh - 1][w + kw - 1], one image after the other
//! weights --pack--> [block of input channels][block of outputs][channel, tap][output of the block]
//! for groups of pixels (in parallel), input blocks, tiles of some vectors of pixels, output blocks:
//!     sums of (outputs of the block) x (vectors of the tile) in registers
//! ```
//!
//! Pixels are counted over the padded width, so that a tile goes from one row on to the next; sums
//! of the columns between are thrown away. A sum runs over blocks of channels in order, whichever
//! thread has it: the bits do not depend on the threads.

use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*};
use rayon::prelude::*;

const LANES: usize = 16;
/// Products that one sum takes before it goes back to memory: this many rows of weights stay in the
/// first cache.
const DEPTH: usize = 288;
/// Pixels of a group: a multiple of all tiles.
const GROUP: usize = 192;

/// What is convolved with.
pub struct Filter<'a> {
    /// `[out][channels][kernel rows][kernel columns]`.
    pub weight: &'a [f32],
    pub bias: Option<&'a [f32]>,
    pub out: usize,
    pub channels: usize,
    /// Rows and columns, odd.
    pub kernel: [usize; 2],
    /// What lies beyond the image.
    pub beyond: Beyond,
}

/// What lies beyond an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Beyond {
    /// Zeros.
    Nothing,
    /// The nearest pixel.
    Edges,
}

impl Beyond {
    /// Fills what lies beyond the inner rows and columns of a plane of rows of `wide` numbers, of
    /// which `above` and `left` come first and last. It is zero before.
    fn fill(self, plane: &mut [f32], wide: usize, [above, left]: [usize; 2]) {
        if self == Self::Nothing {
            return;
        }
        let inner = above * wide..plane.len() - above * wide;
        for row in plane[inner.clone()].chunks_exact_mut(wide) {
            let (first, last) = (row[left], row[wide - left - 1]);
            row[..left].fill(first);
            row[wide - left..].fill(last);
        }
        for i in 0..above {
            plane.copy_within(inner.start..inner.start + wide, i * wide);
            plane.copy_within(inner.end - wide..inner.end, inner.end + i * wide);
        }
    }
}

/// How sums are laid out in registers: outputs and vectors of pixels of a tile.
#[derive(Clone, Copy)]
enum Shape {
    /// 24 sums of 512 bits.
    Wide,
    /// 12 sums of two times 256 bits (or of four times 128 where there are 32 registers).
    Middle,
    /// 3 sums of four times 128 bits.
    Narrow,
}

impl Shape {
    fn of(level: Level) -> Self {
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        match level {
            Level::Avx512(_) => Self::Wide,
            Level::Avx2(_) => Self::Middle,
            _ => Self::Narrow,
        }
        #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
        if level.is_fallback() {
            Self::Narrow
        } else {
            Self::Middle
        }
    }

    const fn outputs(self) -> usize {
        match self {
            Self::Wide => 8,
            Self::Middle => 6,
            Self::Narrow => 3,
        }
    }
}

/// An image, padded, and what of it is convolved.
struct Padded<'a> {
    values: &'a [f32],
    /// Numbers of a plane.
    plane: usize,
    /// Where the taps are, from the upper left one.
    taps: &'a [usize],
}

/// The convolution of `n` images of `h` by `w` pixels; `parts` `[n][c][h * w]`, whose channels
/// follow each other, are all of the filter's: `[n][out][h * w]`.
pub fn convolve(parts: &[&[f32]], n: usize, size: [usize; 2], filter: &Filter<'_>) -> Vec<f32> {
    with_level(Level::new(), parts, n, size, filter)
}

fn with_level(
    level: Level,
    parts: &[&[f32]],
    n: usize,
    [h, w]: [usize; 2],
    filter: &Filter<'_>,
) -> Vec<f32> {
    let shape = Shape::of(level);
    let [kh, kw] = filter.kernel;
    let depth = (DEPTH / (kh * kw)).clamp(1, filter.channels);
    let packed = pack(filter, depth, shape.outputs());
    let wide = w + kw - 1;
    let plane = (h + kh - 1) * wide;
    let taps: Vec<usize> = (0..kh)
        .flat_map(|y| (0..kw).map(move |x| y * wide + x))
        .collect();
    let groups = (h * wide).div_ceil(GROUP);
    let outputs = filter.out.next_multiple_of(shape.outputs());
    // as many images at a time as keep all threads busy
    let together = (4 * rayon::current_num_threads())
        .div_ceil(groups)
        .clamp(1, n);
    // the last tile reads beyond the last plane
    let room = filter.channels * plane + GROUP + kw;
    let mut padded = vec![0.0; together * room];
    let mut sums = vec![0.0; together * groups * outputs * GROUP];
    let mut out = vec![0.0; n * filter.out * h * w];
    for (batch, out) in out.chunks_mut(together * filter.out * h * w).enumerate() {
        let count = out.len() / (filter.out * h * w);
        let images = batch * together..batch * together + count;
        let planes: Vec<&[f32]> = images
            .flat_map(|i| {
                parts.iter().flat_map(move |part| {
                    let size = part.len() / n;
                    part[i * size..][..size].chunks_exact(h * w)
                })
            })
            .collect();
        let rooms = padded
            .par_chunks_mut(room)
            .zip(planes.par_chunks(filter.channels));
        rooms.for_each(|(room, planes)| {
            room.par_chunks_mut(plane)
                .zip(planes)
                .for_each(|(room, values)| {
                    let inner = room.chunks_exact_mut(wide).skip(kh / 2);
                    for (row, values) in inner.zip(values.chunks_exact(w)) {
                        row[kw / 2..][..w].copy_from_slice(values);
                    }
                    filter.beyond.fill(room, wide, [kh / 2, kw / 2]);
                });
        });
        let tasks = sums[..count * groups * outputs * GROUP].par_chunks_mut(outputs * GROUP);
        tasks.enumerate().for_each(|(task, sums)| {
            sums.fill(0.0);
            let image = Padded {
                values: &padded[task / groups * room..][..room],
                plane,
                taps: &taps,
            };
            let (from, c) = (task % groups * GROUP, filter.channels);
            dispatch!(level, s => match shape {
                Shape::Wide => group::<_, 8, 3>(s, &image, from, &packed, c, depth, sums),
                Shape::Middle => group::<_, 6, 1>(s, &image, from, &packed, c, depth, sums),
                Shape::Narrow => group::<_, 3, 1>(s, &image, from, &packed, c, depth, sums),
            });
        });
        out.par_chunks_exact_mut(h * w)
            .enumerate()
            .for_each(|(map, out)| {
                let (image, o) = (map / filter.out, map % filter.out);
                let bias = filter.bias.map_or(0.0, |bias| bias[o]);
                for (y, row) in out.chunks_exact_mut(w).enumerate() {
                    let (mut at, mut row) = (y * wide, row);
                    while !row.is_empty() {
                        let (g, inside) = (image * groups + at / GROUP, at % GROUP);
                        let len = row.len().min(GROUP - inside);
                        let (now, later) = row.split_at_mut(len);
                        let sums = &sums[(g * outputs + o) * GROUP + inside..][..len];
                        for (out, sum) in now.iter_mut().zip(sums) {
                            *out = sum + bias;
                        }
                        (row, at) = (later, at + len);
                    }
                }
            });
    }
    out
}

/// Weights as [`group`] reads them; outputs beyond the last are 0.
fn pack(filter: &Filter<'_>, depth: usize, block: usize) -> Vec<f32> {
    let taps = filter.kernel[0] * filter.kernel[1];
    let outputs = filter.out.next_multiple_of(block);
    let mut packed = vec![0.0; outputs * filter.channels * taps];
    let blocks = packed.par_chunks_mut(outputs * depth * taps).enumerate();
    blocks.for_each(|(d, packed)| {
        let first = d * depth;
        let deep = depth.min(filter.channels - first) * taps;
        for (b, packed) in packed.chunks_exact_mut(deep * block).enumerate() {
            for o in 0..block.min(filter.out - (b * block).min(filter.out)) {
                let weights =
                    &filter.weight[((b * block + o) * filter.channels + first) * taps..][..deep];
                for (to, &weight) in packed.iter_mut().skip(o).step_by(block).zip(weights) {
                    *to = weight;
                }
            }
        }
    });
    packed
}

/// Sums `[output][GROUP]` of the pixels from `from` on, over all channels, `depth` of them at a
/// time.
#[inline(always)]
fn group<S: Simd, const OUT: usize, const VECTORS: usize>(
    s: S,
    image: &Padded<'_>,
    from: usize,
    packed: &[f32],
    channels: usize,
    depth: usize,
    sums: &mut [f32],
) {
    let outputs = sums.len() / GROUP;
    let taps = image.taps.len();
    let mut packed = packed;
    for first in (0..channels).step_by(depth) {
        let deep = depth.min(channels - first);
        let (block, rest) = packed.split_at(outputs * deep * taps);
        packed = rest;
        for tile in (0..GROUP).step_by(VECTORS * LANES) {
            let values = &image.values[first * image.plane + from + tile..];
            let panels = block.chunks_exact(OUT * deep * taps);
            for (panel, sums) in panels.zip(sums.chunks_exact_mut(OUT * GROUP)) {
                tile_sums::<S, OUT, VECTORS>(s, image, values, panel, tile, sums);
            }
        }
    }
}

/// Adds to `sums` `[OUT][GROUP]`, from `tile` on, what the channels of `panel`
/// `[channel][tap][OUT]` give.
#[inline(always)]
fn tile_sums<S: Simd, const OUT: usize, const VECTORS: usize>(
    s: S,
    image: &Padded<'_>,
    values: &[f32],
    panel: &[f32],
    tile: usize,
    sums: &mut [f32],
) {
    let taps = image.taps;
    let mut acc = [[f32x16::splat(s, 0.0); VECTORS]; OUT];
    for (c, panel) in panel.chunks_exact(taps.len() * OUT).enumerate() {
        let plane = &values[c * image.plane..];
        for (weights, &tap) in panel.as_chunks::<OUT>().0.iter().zip(taps) {
            let pixels = plane[tap..][..VECTORS * LANES].as_chunks::<LANES>().0;
            let mut x = [f32x16::splat(s, 0.0); VECTORS];
            for v in 0..VECTORS {
                x[v] = f32x16::simd_from(s, pixels[v]);
            }
            for o in 0..OUT {
                let weight = f32x16::splat(s, weights[o]);
                for v in 0..VECTORS {
                    acc[o][v] = weight.mul_add(x[v], acc[o][v]);
                }
            }
        }
    }
    // a loop so plain that it is unrolled: else the sums would lie in memory all along
    let mut totals = [[[0.0; LANES]; VECTORS]; OUT];
    for o in 0..OUT {
        for v in 0..VECTORS {
            totals[o][v] = acc[o][v].into();
        }
    }
    for (totals, sums) in totals.iter().zip(sums.chunks_exact_mut(GROUP)) {
        for (sum, total) in sums[tile..].iter_mut().zip(totals.as_flattened()) {
            *sum += total;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use m4_testkit::{formula_input, same_on_any_threads};

    fn levels() -> Vec<Level> {
        let best = Level::new();
        #[cfg(target_arch = "x86_64")]
        let all = [
            best.as_sse2().map(|t| t.level()),
            best.as_avx2().map(|t| t.level()),
            best.as_avx512().map(|t| t.level()),
        ];
        #[cfg(not(target_arch = "x86_64"))]
        let all = [Some(best)];
        all.into_iter().flatten().collect()
    }

    fn by_definition(x: &[f32], [h, w]: [usize; 2], filter: &Filter<'_>) -> Vec<f64> {
        let [kh, kw] = filter.kernel;
        let mut out = Vec::new();
        for o in 0..filter.out {
            for (y, x0) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
                let mut sum = filter.bias.map_or(0.0, |b| f64::from(b[o]));
                for c in 0..filter.channels {
                    for (ky, kx) in (0..kh).flat_map(|y| (0..kw).map(move |x| (y, x))) {
                        let (y, x1) = (
                            (y + ky).wrapping_sub(kh / 2),
                            (x0 + kx).wrapping_sub(kw / 2),
                        );
                        if y < h && x1 < w {
                            let weight =
                                filter.weight[((o * filter.channels + c) * kh + ky) * kw + kx];
                            sum += f64::from(weight) * f64::from(x[(c * h + y) * w + x1]);
                        }
                    }
                }
                out.push(sum);
            }
        }
        out
    }

    #[test]
    fn every_level_agrees_with_the_definition() {
        for (channels, out, kernel, [h, w]) in [
            (70, 13, [3, 3], [7, 31]),
            (9, 8, [7, 7], [12, 20]),
            (300, 3, [1, 1], [5, 5]),
        ] {
            let x = formula_input("x", 0.1, 1.0, channels * h * w);
            let weight = formula_input("w", 0.0, 0.1, out * channels * kernel[0] * kernel[1]);
            let bias = formula_input("b", 0.0, 1.0, out);
            let filter = Filter {
                weight: &weight,
                bias: Some(&bias),
                out,
                channels,
                kernel,
                beyond: Beyond::Nothing,
            };
            let want = by_definition(&x, [h, w], &filter);
            let largest = want.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
            assert!(largest > 0.5);
            for level in levels() {
                let got = with_level(level, &[&x], 1, [h, w], &filter);
                assert_eq!(got.len(), want.len());
                let errors = got
                    .iter()
                    .zip(&want)
                    .map(|(a, b)| (f64::from(*a) - b).abs());
                let error = errors.fold(
                    0.0,
                    |m: f64, x| if x.is_nan() { f64::NAN } else { m.max(x) },
                );
                assert!(
                    error < 3e-6 * largest,
                    "{level:?} {kernel:?}: {error:.1e} of {largest:.1e}"
                );
            }
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let (channels, out, n, h, w) = (40, 20, 7, 30, 41);
        let x = formula_input("x", 0.1, 1.0, n * channels * h * w);
        let weight = formula_input("w", 0.0, 0.1, out * channels * 9);
        let filter = Filter {
            weight: &weight,
            bias: None,
            out,
            channels,
            kernel: [3, 3],
            beyond: Beyond::Nothing,
        };
        same_on_any_threads(|| convolve(&[&x], n, [h, w], &filter));
    }
}
