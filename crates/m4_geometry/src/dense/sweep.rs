//! Plane sweep: what each disparity costs at each pixel.

use super::pair::Pair;

/// Cost of a disparity that no partner can judge, in half bits: that of random signatures.
const UNKNOWN: u8 = 22;
/// Brightness differences up to this are not told apart, 0..255.
const FLAT: f32 = 1.0;

/// Evenly spaced disparities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Range {
    pub least: f32,
    pub step: f32,
    pub count: usize,
}

impl Range {
    pub fn at(&self, index: f32) -> f32 {
        self.least + index * self.step
    }
}

/// The 24 comparisons of a pixel with the rest of its 5x5 neighbourhood (Zabih and Woodfill 1994).
pub(super) fn census(width: usize, height: usize, grey: &[f32]) -> Vec<u32> {
    let mut out = vec![0u32; width * height];
    for dy in -2isize..=2 {
        for dx in -2isize..=2 {
            if (dx, dy) == (0, 0) {
                continue;
            }
            for y in 0..height {
                let other = y.saturating_add_signed(dy).min(height - 1) * width;
                let row = y * width;
                for x in 0..width {
                    let o = grey[other + x.saturating_add_signed(dx).min(width - 1)];
                    out[row + x] = (out[row + x] << 1) | u32::from(o > grey[row + x] + FLAT);
                }
            }
        }
    }
    out
}

/// One partner: how to get there and its signatures.
pub(super) struct Partner<'a> {
    pub pair: Pair,
    pub census: &'a [u32],
}

/// `[height][width][count]` in half bits: twice the mean number of differing bits over the better
/// half of the partners that see the point, so that what hides it from some does not matter.
pub(super) fn cost_volume(
    width: usize,
    height: usize,
    census: &[u32],
    partners: &[Partner<'_>],
    range: &Range,
) -> Vec<u8> {
    let count = range.count;
    let mut volume = vec![UNKNOWN; width * height * count];
    let mut costs = vec![[u8::MAX; MAX_PARTNERS]; count];
    let partners = &partners[..partners.len().min(MAX_PARTNERS)];
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            let mine = census[i];
            for (slot, partner) in partners.iter().enumerate() {
                let [mut qx, mut qy, mut qz] = partner.pair.ray(x as f32, y as f32);
                let b = partner.pair.b;
                (qx, qy, qz) = (
                    qx + range.least * b[0],
                    qy + range.least * b[1],
                    qz + range.least * b[2],
                );
                let (sx, sy, sz) = (range.step * b[0], range.step * b[1], range.step * b[2]);
                for (k, cost) in costs.iter_mut().enumerate() {
                    let k = k as f32;
                    let z = 1.0 / (qz + k * sz);
                    let (u, v) = ((qx + k * sx) * z + 0.5, (qy + k * sy) * z + 0.5);
                    let inside = z > 0.0 && u >= 0.0 && v >= 0.0 && u < width as f32 && v < height as f32;
                    cost[slot] = if inside {
                        (mine ^ partner.census[v as usize * width + u as usize]).count_ones() as u8
                    } else {
                        u8::MAX
                    };
                }
            }
            let out = &mut volume[i * count..(i + 1) * count];
            for (out, cost) in out.iter_mut().zip(&costs) {
                *out = better_half(cost, partners.len());
            }
        }
    }
    volume
}

/// Partners beyond these are not used.
const MAX_PARTNERS: usize = 6;

fn better_half(costs: &[u8; MAX_PARTNERS], count: usize) -> u8 {
    let mut sorted = *costs;
    for i in 1..count {
        let mut j = i;
        while j > 0 && sorted[j - 1] > sorted[j] {
            sorted.swap(j - 1, j);
            j -= 1;
        }
    }
    let seen = sorted[..count].iter().filter(|&&c| c != u8::MAX).count();
    if seen == 0 {
        return UNKNOWN;
    }
    let half = seen.div_ceil(2);
    let sum: usize = sorted[..half].iter().map(|&c| usize::from(c)).sum();
    (2 * sum / half) as u8
}

#[cfg(test)]
mod tests {
    use super::{MAX_PARTNERS, UNKNOWN, better_half, census};

    #[test]
    fn a_signature_ignores_brightness_and_contrast() {
        let image: Vec<f32> = (0..20 * 15).map(|i| (i * 7919 % 97) as f32).collect();
        let brighter: Vec<f32> = image.iter().map(|v| 2.0 * v + 20.0).collect();
        let (a, b) = (census(20, 15, &image), census(20, 15, &brighter));
        let differing: u32 = a.iter().zip(&b).map(|(a, b)| (a ^ b).count_ones()).sum();
        // Steps of exactly one are told apart only when they are doubled.
        assert!(differing < 300 * 24 / 50, "{differing}");
        assert!(census(20, 15, &vec![5.0; 300]).iter().all(|&c| c == 0));
    }

    #[test]
    fn occluded_partners_are_ignored() {
        let costs = |v: [u8; 4]| {
            let mut all = [u8::MAX; MAX_PARTNERS];
            all[..4].copy_from_slice(&v);
            better_half(&all, 4)
        };
        assert_eq!(costs([2, 20, 4, 19]), 6);
        assert_eq!(costs([u8::MAX, 20, 4, u8::MAX]), 8);
        assert_eq!(costs([u8::MAX; 4]), UNKNOWN);
    }
}
