//! The outcome of density control for each splat: the rows that it keeps and adds, and their
//! totals.
#![expect(
    clippy::collapsible_if,
    reason = "kernels are expanded: conditions at compile time stand alone"
)]

use crate::config::{LARGE_EXTENT, LARGE_PX, PruneRule, SplitSize};
use crate::density::{DensityStats, Rules};
use cubecl::prelude::*;
use m4_kernels::gpu::GpuError;
use m4_kernels::gpu::buffer::{Buffer, cubes, units};
use m4_kernels::gpu::scan::{Scan, scan_cube};
use m4_kernels::launch;
use m4_kernels::splats::DeviceSplats;

/// Rows of the next splats: static that stay, new static, and the same of bound and of free ones.
pub(crate) struct Outcomes {
    /// How many rows each splat leaves (0 or 1) and adds (0 to 2), `[2 n]` in that order.
    pub sizes: Buffer,
    /// Their positions.
    pub places: Buffer,
    /// Cloned, split, pruned, splats, static splats, static and bound splats.
    counts: Buffer,
}

impl Outcomes {
    /// `grows` are flags, `range` the scores that count as 0 and 1.
    pub fn new(
        client: &Client,
        splats: &DeviceSplats,
        rules: &Rules<'_>,
        grows: &Buffer,
        prune_scores: &Buffer,
        range: &Buffer,
    ) -> Self {
        let n = splats.n;
        let (config, scale) = (rules.config, rules.scale);
        let (literal, opacity) = match config.prune_rule {
            PruneRule::Literal => (rules.due.prune_by_score, 0.0),
            PruneRule::WithOpacity { opacity, .. } => (false, opacity),
        };
        let (size, everywhere) = match config.split_size {
            SplitSize::Extent { share } => (share * scale.extent, true),
            SplitSize::Pixels { pixels } => (pixels, false),
        };
        let prune_large = rules.due.prune_large;
        let centres: &[[f32; 3]] = if everywhere && !prune_large {
            &[]
        } else {
            &scale.centres
        };
        let blocks = n.div_ceil(256);
        let (sizes, places) = (Buffer::empty(client, 2 * n), Buffer::empty(client, 2 * n));
        let (parts, counts) = (Buffer::empty(client, blocks), Buffer::empty(client, 6));
        launch!(
            client,
            decide::launch,
            (cubes(n, 256), units()),
            [
                splats.geometry,
                grows,
                prune_scores,
                range,
                Buffer::floats(client, centres.as_flattened()),
                sizes,
                parts
            ],
            [
                n as u32,
                splats.n_static as u32,
                splats.n_still() as u32,
                centres.len() as u32,
                rules.min_opacity,
                size,
                scale.focal_px,
                config.prune_threshold,
                opacity,
                LARGE_EXTENT * scale.extent,
                LARGE_PX / 3.0,
                splats.layout.isotropic,
                literal,
                everywhere,
                prune_large
            ]
        );
        Scan::new(client, 2 * n).run(client, &sizes, &places);
        launch!(
            client,
            count_up::launch,
            (cubes(1, 1), units()),
            [parts, sizes, places, counts],
            [
                blocks as u32,
                n as u32,
                splats.n_static as u32,
                splats.n_still() as u32
            ]
        );
        Self {
            sizes,
            places,
            counts,
        }
    }

    /// Waits, and says how many were cloned, split and pruned, and how many splats and bound splats
    /// there are to be.
    pub fn read(
        &self,
        client: &Client,
        doing: &'static str,
    ) -> Result<(DensityStats, usize, usize), GpuError> {
        let counts = self.counts.read_words(client, doing)?;
        let [cloned, split, pruned, next, n_static, n_still] =
            [0, 1, 2, 3, 4, 5].map(|k: usize| counts[k] as usize);
        let grown = DensityStats {
            cloned,
            split,
            pruned,
            n_static,
            n_dynamic: next - n_static,
        };
        Ok((grown, next, n_still - n_static))
    }
}

/// Where row `i` is among the numbers of those that stay; of the new ones it is as much farther as
/// its kind has rows.
#[cube]
pub(super) fn stay_of(i: u32, n_static: u32, n_still: u32) -> u32 {
    let mut stay = i;
    if i >= n_static {
        stay = i + n_static;
    }
    if i >= n_still {
        stay = i + n_still;
    }
    stay
}

#[cube]
pub(super) fn birth_of(i: u32, n: u32, n_static: u32, n_still: u32) -> u32 {
    let mut birth = i + n_static;
    if i >= n_static {
        birth = i + n_still;
    }
    if i >= n_still {
        birth = i + n;
    }
    birth
}

/// The largest standard deviation.
#[cube]
fn largest(geometry: &[f32], i: u32, n: u32, #[comptime] isotropic: bool) -> f32 {
    let mut log = geometry[(3u32 * n + i) as usize];
    if comptime!(!isotropic) {
        log = log
            .max(geometry[(4u32 * n + i) as usize])
            .max(geometry[(5u32 * n + i) as usize]);
    }
    log.exp()
}

/// Distance to the nearest of some points; next to infinite where there are none.
#[cube]
fn nearest(geometry: &[f32], centres: &[f32], count: u32, i: u32, n: u32) -> f32 {
    let mut square = 3.0e38f32;
    for c in 0u32..count {
        let mut sum = 0.0f32;
        for k in 0u32..3u32 {
            let d = centres[(3u32 * c + k) as usize] - geometry[(k * n + i) as usize];
            sum += d * d;
        }
        square = square.min(sum);
    }
    square.sqrt()
}

/// Clones, splits and prunes: prune scores are normalised and compared with the threshold
/// (Minute4D Eq. 10).
#[cube(launch)]
fn decide(
    geometry: &[f32],
    grows: &[u32],
    scores: &[f32],
    range: &[f32],
    centres: &[f32],
    sizes: &mut [u32],
    parts: &mut [u32],
    n: u32,
    n_static: u32,
    n_still: u32,
    centre_count: u32,
    min_opacity: f32,
    size: f32,
    focal_px: f32,
    threshold: f32,
    low_opacity: f32,
    large: f32,
    large_px: f32,
    #[comptime] isotropic: bool,
    #[comptime] literal: bool,
    #[comptime] everywhere: bool,
    #[comptime] prune_large: bool,
) {
    let mut shared = Shared::<[u32]>::new_slice(256usize);
    let i = ABSOLUTE_POS as u32;
    // cloned, split and pruned of at most 256 splats share a number, ten bits each
    let mut mine = 0u32;
    if i < n {
        let scale = largest(geometry, i, n, isotropic);
        let mut limit = size;
        let mut too_large = false;
        if comptime!(!everywhere || prune_large) {
            let pixel = nearest(geometry, centres, centre_count, i, n) / focal_px;
            if comptime!(!everywhere) {
                limit = size * pixel;
            }
            if comptime!(prune_large) {
                too_large = scale > large || scale > large_px * pixel;
            }
        }
        let column = comptime!(if isotropic { 4u32 } else { 10u32 });
        // beyond that it is 0 in any case, and no exponential is infinite
        let logit = geometry[(column * n + i) as usize].max(-80.0f32);
        let opacity = 1.0f32 / (1.0f32 + (-logit).exp());
        let hopeless = opacity < min_opacity || too_large;
        let mut by_score = false;
        let (low, high) = (range[0usize], range[1usize]);
        if high > low {
            let score = ((scores[(n + i) as usize] - low) / (high - low)).clamp(0.0f32, 1.0f32);
            if comptime!(literal) {
                by_score = score > threshold;
            } else {
                by_score = score > threshold && opacity < low_opacity;
            }
        }
        let mut stays = 1u32;
        let mut births = 0u32;
        let grow = grows[i as usize] != 0u32;
        if grow && scale > limit {
            stays = 0u32;
            births = 2u32;
            mine = 1u32 << 10u32;
        } else {
            if hopeless {
                stays = 0u32;
                mine = 1u32 << 20u32;
            } else {
                if grow {
                    births = 1u32;
                    mine = 1u32;
                    if comptime!(literal) {
                        if by_score {
                            stays = 0u32;
                            mine = (1u32 << 20u32) + 1u32;
                        }
                    }
                } else {
                    if by_score {
                        stays = 0u32;
                        mine = 1u32 << 20u32;
                    }
                }
            }
        }
        sizes[stay_of(i, n_static, n_still) as usize] = stays;
        sizes[birth_of(i, n, n_static, n_still) as usize] = births;
    }
    let before = scan_cube(mine, &mut shared);
    if UNIT_POS == 255u32 && (CUBE_POS as u32) < parts.len() as u32 {
        parts[CUBE_POS] = before + mine;
    }
}

#[cube(launch)]
fn count_up(
    parts: &[u32],
    sizes: &[u32],
    places: &[u32],
    counts: &mut [u32],
    blocks: u32,
    n: u32,
    n_static: u32,
    n_still: u32,
) {
    let mut shared = Shared::<[u32]>::new_slice(256usize);
    for k in 0u32..3u32 {
        let mut mine = 0u32;
        let mut block = UNIT_POS;
        while block < blocks {
            mine += (parts[block as usize] >> (10u32 * k)) & 1023u32;
            block += 256u32;
        }
        let before = scan_cube(mine, &mut shared);
        if UNIT_POS == 255u32 {
            counts[k as usize] = before + mine;
        }
        sync_cube();
    }
    if UNIT_POS == 0u32 {
        let last = (2u32 * n - 1u32) as usize;
        let all = places[last] + sizes[last];
        let mut fixed = all;
        if n_static < n {
            fixed = places[(2u32 * n_static) as usize];
        }
        let mut still = all;
        if n_still < n {
            still = places[(2u32 * n_still) as usize];
        }
        counts[3usize] = all;
        counts[4usize] = fixed;
        counts[5usize] = still;
    }
}
