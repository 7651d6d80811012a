//! Fills parts of an image smoothly from around (pull and push: Gortler et al. 1996).

use m4_core::{Plane, RgbImage};

/// Sums of colours, and their weight.
type Level = Plane<[f32; 4]>;

/// Replaces the pixels of `image` where `mask`, of its size, is true by a smooth continuation of
/// those around.
pub(super) fn fill(image: &mut RgbImage, mask: &Plane<bool>) {
    let (w, h) = image.size();
    let mut levels: Vec<Level> = vec![Plane::from_fn(w, h, |x, y| {
        let [r, g, b] = image[(x, y)].map(f32::from);
        if mask[(x, y)] {
            [0.0; 4]
        } else {
            [r, g, b, 1.0]
        }
    })];
    while let Some(top) = levels.last()
        && top.width().max(top.height()) > 1
    {
        let half = halved(top);
        levels.push(half);
    }
    let Some(mut coarse) = levels.pop() else {
        return;
    };
    while let Some(fine) = levels.pop() {
        coarse = pushed(&coarse, &fine);
    }
    for y in 0..h {
        for x in 0..w {
            if mask[(x, y)] {
                let [r, g, b, _] = coarse[(x, y)];
                image[(x, y)] = [r, g, b].map(|v| v.round().clamp(0.0, 255.0) as u8);
            }
        }
    }
}

/// Weighted means of 2 x 2 pixels; weights stay at most 1.
fn halved(fine: &Level) -> Level {
    let (w, h) = fine.size();
    Plane::from_fn(w.div_ceil(2), h.div_ceil(2), |x, y| {
        let mut sum = [0.0; 4];
        for row in (2 * y..2 * y + 2).filter(|&row| row < h) {
            for v in &fine.row(row)[2 * x..(2 * x + 2).min(w)] {
                for (sum, v) in sum.iter_mut().zip(v) {
                    *sum += v;
                }
            }
        }
        let scale = sum[3].min(1.0) / sum[3].max(1e-6);
        sum.map(|v| v * scale)
    })
}

/// `fine` with what is missing of its weight taken from `coarse`, which has all of it.
fn pushed(coarse: &Level, fine: &Level) -> Level {
    let (w, h) = coarse.size();
    let last = |i: f32, n: usize| i.clamp(0.0, (n - 1) as f32);
    Plane::from_fn(fine.width(), fine.height(), |x, y| {
        let own = fine[(x, y)];
        if own[3] >= 1.0 {
            return own;
        }
        let (u, v) = (
            last(0.5 * x as f32 - 0.25, w),
            last(0.5 * y as f32 - 0.25, h),
        );
        let (x0, y0) = (u as usize, v as usize);
        let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
        let (fx, fy) = (u - x0 as f32, v - y0 as f32);
        std::array::from_fn(|k| {
            let at = |x, y| coarse[(x, y)][k] / coarse[(x, y)][3].max(1e-6);
            let upper = at(x0, y0) * (1.0 - fx) + at(x1, y0) * fx;
            let lower = at(x0, y1) * (1.0 - fx) + at(x1, y1) * fx;
            own[k] + (1.0 - own[3]) * (upper * (1.0 - fy) + lower * fy)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::fill;
    use m4_core::Plane;

    #[test]
    fn a_gap_is_filled_with_what_is_around() {
        let slope = Plane::from_fn(48, 32, |x, y| [(3 * x + 2 * y) as u8, 90, (5 * y) as u8]);
        let mask = Plane::from_fn(48, 32, |x, y| {
            (20..28).contains(&x) && (12..18).contains(&y)
        });
        let mut image = Plane::from_fn(48, 32, |x, y| match mask[(x, y)] {
            true => [255; 3],
            false => slope[(x, y)],
        });
        fill(&mut image, &mask);
        for y in 0..32 {
            for x in 0..48 {
                let worst = (0..3)
                    .map(|k| image[(x, y)][k].abs_diff(slope[(x, y)][k]))
                    .max();
                let most = if mask[(x, y)] { 12 } else { 0 };
                assert!(worst <= Some(most), "{worst:?} at {x}, {y}");
            }
        }
        // Nothing to fill with.
        let mut all = Plane::filled(5, 3, [7; 3]);
        fill(&mut all, &Plane::filled(5, 3, true));
        assert_eq!(all.size(), (5, 3));
    }
}
