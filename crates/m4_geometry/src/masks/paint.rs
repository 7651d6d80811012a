//! Paints objects into one map of numbers per frame.

use super::outline::Outline;
use crate::classical::dense::Components;
use m4_core::Plane;
use std::collections::BTreeMap;

/// The numbers of a frame: where things overlap, the smaller in this frame lies on top, of two of the same area the lower number.
pub(super) fn ids(things: &[(u16, &Outline)], (width, height): (usize, usize)) -> Plane<u16> {
    let mut order: Vec<&(u16, &Outline)> = things.iter().collect();
    order.sort_by_key(|(id, outline)| std::cmp::Reverse((outline.area(), *id)));
    let mut out = Plane::filled(width, height, 0);
    for (id, outline) in order {
        for pixel in outline.pixels() {
            out[pixel] = *id;
        }
    }
    out
}

/// Gives holes of at most `most_px` pixels, which do not touch the border, the number that most of their rim has.
pub(super) fn fill_holes(ids: &mut Plane<u16>, most_px: usize) {
    let (w, h) = ids.size();
    let empty: Vec<u8> = ids.data().iter().map(|&id| if id == 0 { 255 } else { 0 }).collect();
    for hole in Components::of(w, h, &empty).pixels {
        if hole.len() > most_px {
            continue;
        }
        let mut rim: BTreeMap<u16, usize> = BTreeMap::new();
        let mut open = false;
        for &p in &hole {
            let (x, y) = (p as usize % w, p as usize / w);
            open |= x == 0 || y == 0 || x + 1 == w || y + 1 == h;
            for (nx, ny) in [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)] {
                if nx < w && ny < h && ids[(nx, ny)] != 0 {
                    *rim.entry(ids[(nx, ny)]).or_default() += 1;
                }
            }
        }
        // Of equally many the lowest number.
        let most = rim
            .into_iter()
            .max_by_key(|&(id, count)| (count, std::cmp::Reverse(id)));
        if let (Some((id, _)), false) = (most, open) {
            for p in hole {
                ids.data_mut()[p as usize] = id;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{fill_holes, ids};
    use crate::masks::outline::Outline;
    use m4_core::CompactMask;

    const SIZE: (usize, usize) = (30, 20);

    fn outline(f: impl Fn(usize, usize) -> bool) -> Outline {
        Outline::of(&CompactMask::from_fn(SIZE.0, SIZE.1, f)).unwrap()
    }

    #[test]
    fn the_smaller_lies_on_top_and_small_holes_close() {
        let large =
            outline(|x, y| (2..22).contains(&x) && (2..18).contains(&y) && !((5..7).contains(&x) && y == 5) && x != 15);
        let small = outline(|x, y| (10..14).contains(&x) && (8..12).contains(&y));
        let mut found = ids(&[(3, &large), (7, &small)], SIZE);
        assert_eq!(
            (found[(3, 3)], found[(11, 9)], found[(5, 5)], found[(15, 9)]),
            (3, 7, 0, 0)
        );
        fill_holes(&mut found, 4);
        assert_eq!((found[(5, 5)], found[(15, 9)], found[(0, 0)]), (3, 0, 0));
        fill_holes(&mut found, 10_000);
        // The gap at column 15 is open to what is outside.
        assert_eq!((found[(15, 9)], found[(0, 0)]), (0, 0));
    }
}
