//! Masks made larger and smaller by round elements, with exact distances.

use crate::classical::dense::to_outside;

/// Pixels of a mask (above 0) deeper than `radius_px`. The border of the image is no edge.
pub(super) fn eroded(width: usize, height: usize, mask: &[u8], radius_px: f32) -> Vec<u8> {
    let depth = to_outside(width, height, |p| mask[p] > 0);
    depth.iter().map(|&d| if d > radius_px { 255 } else { 0 }).collect()
}

/// Pixels no farther than `radius_px` from one of a mask (above 0).
pub(super) fn dilated(width: usize, height: usize, mask: &[u8], radius_px: f32) -> Vec<u8> {
    let away = to_outside(width, height, |p| mask[p] == 0);
    away.iter().map(|&d| if d <= radius_px { 255 } else { 0 }).collect()
}

/// What of a mask a disc of `radius_px` inside of it can reach: without specks and threads.
pub(super) fn opened(width: usize, height: usize, mask: &[u8], radius_px: f32) -> Vec<u8> {
    if radius_px < 1.0 {
        return mask.to_vec();
    }
    // A disc around the middle of a pixel reaches its neighbours at a distance of 1 and not their edges.
    let core = eroded(width, height, mask, radius_px);
    dilated(width, height, &core, radius_px)
}

#[cfg(test)]
mod tests {
    use super::{dilated, eroded, opened};

    const W: usize = 40;
    const H: usize = 30;

    fn count(mask: &[u8]) -> usize {
        mask.iter().filter(|&&m| m > 0).count()
    }

    #[test]
    fn opening_removes_thin_parts_only() {
        let square = |x: usize, y: usize| (5..25).contains(&x) && (5..20).contains(&y);
        let thread = |x: usize, y: usize| y == 25 && x > 3 || x == 30;
        let mask: Vec<u8> = (0..W * H)
            .map(|p| u8::from(square(p % W, p / W) || thread(p % W, p / W)))
            .collect();
        let found = opened(W, H, &mask, 2.0);
        for p in 0..W * H {
            let (x, y) = (p % W, p / W);
            assert!(found[p] == 0 || square(x, y), "column {x}, row {y}");
            assert!(found[p] > 0 || !square(x, y) || on_corner(x, y), "column {x}, row {y}");
        }
        assert!(count(&found) > 20 * 15 - 16);
        assert_eq!(count(&opened(W, H, &vec![0; W * H], 2.0)), 0);
        assert_eq!(count(&opened(W, H, &vec![9; W * H], 2.0)), W * H);
    }

    fn on_corner(x: usize, y: usize) -> bool {
        !(7..=22).contains(&x) && !(7..=17).contains(&y)
    }

    #[test]
    fn larger_and_smaller_by_the_radius() {
        let mask: Vec<u8> = (0..W * H).map(|p| u8::from(p % W >= 10)).collect();
        assert_eq!(count(&dilated(W, H, &mask, 3.0)), (W - 7) * H);
        assert_eq!(count(&eroded(W, H, &mask, 3.0)), (W - 13) * H);
    }
}
