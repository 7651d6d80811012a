//! Outlines of masks between pixels: a pixel at the rim of an object mixes its colour with that of
//! the background.

use super::regions::to_outside;

/// Distance from the outside at which pixels show the object alone, pixels at the working size.
const INNER_PX: f32 = 2.0;
/// How far from the rim the colour of the object is sought, pixels.
const REACH_PX: isize = 4;
/// Least difference between object and background that says how they are mixed, and most that no
/// mixture explains, 0..255.
const CONTRAST: f32 = 20.0;

/// The pixels of `mask` (above 0) and those around it that show more of the object than of what is
/// behind it. Only the pixels on both sides of the outline change, and only where `background` is
/// known and they are mixtures of it and the pixels of the object nearby.
///
/// `colours`, `background` (without the object) and `mask` are `[height][width]`.
pub(super) fn outline(
    (width, height): (usize, usize),
    colours: &[[u8; 3]],
    background: &[Option<[f32; 3]>],
    mask: &[u8],
) -> Vec<u8> {
    let depth = to_outside(width, height, |p| mask[p] > 0);
    let around = |p: usize, reach: isize| {
        let (x, y) = ((p % width) as isize, (p / width) as isize);
        let steps = move |dy: isize| (-reach..=reach).map(move |dx| (dx, dy));
        (-reach..=reach)
            .flat_map(steps)
            .filter_map(move |(dx, dy)| {
                let inside = (0..width as isize).contains(&(x + dx))
                    && (0..height as isize).contains(&(y + dy));
                inside.then(|| {
                    (
                        (y + dy) as usize * width + (x + dx) as usize,
                        (dx * dx + dy * dy) as f32,
                    )
                })
            })
    };
    let mut out = mask.to_vec();
    for (p, out) in out.iter_mut().enumerate() {
        let Some(behind) = background[p] else {
            continue;
        };
        if around(p, 1).all(|(q, _)| (mask[q] > 0) == (*out > 0)) {
            continue;
        }
        let (mut sum, mut weight) = ([0.0; 3], 0.0);
        // the pixel itself, next to the outline, is not among them
        for (q, squared) in around(p, REACH_PX).filter(|(q, _)| depth[*q] >= INNER_PX) {
            let near = 1.0 / (squared * squared);
            weight += near;
            sum.iter_mut()
                .zip(colours[q])
                .for_each(|(sum, c)| *sum += near * f32::from(c));
        }
        if weight > 0.0 {
            let share = share(colours[p].map(f32::from), sum.map(|c| c / weight), behind);
            *out = share.map_or(*out, |share| if share > 0.5 { 255 } else { 0 });
        }
    }
    out
}

/// The share of `object` in a `mixture` with `background`; `None` where the two are alike or
/// explain too little.
fn share(mixture: [f32; 3], object: [f32; 3], background: [f32; 3]) -> Option<f32> {
    let (mut along, mut squared) = (0.0, 0.0);
    for ((m, o), b) in mixture.iter().zip(&object).zip(&background) {
        along += (m - b) * (o - b);
        squared += (o - b) * (o - b);
    }
    let share = (squared >= CONTRAST * CONTRAST).then(|| (along / squared).clamp(0.0, 1.0))?;
    let explained = |c: usize| {
        (mixture[c] - background[c] - share * (object[c] - background[c])).abs() <= CONTRAST
    };
    (0..3).all(explained).then_some(share)
}

#[cfg(test)]
mod tests {
    use super::{outline, share};

    const W: usize = 24;
    const H: usize = 20;
    const OBJECT: [f32; 3] = [200.0, 40.0, 60.0];
    const BEHIND: [f32; 3] = [50.0, 90.0, 120.0];

    /// Share of each pixel that a disc covers, by 8x8 samples.
    fn covered(p: usize) -> f32 {
        let at = |k: usize, of: usize| of as f32 + (k as f32 - 3.5) / 8.0;
        let inside = |k: usize| (at(k % 8, p % W) - 11.3).hypot(at(k / 8, p / W) - 9.6) < 6.2;
        (0..64).filter(|k| inside(*k)).count() as f32 / 64.0
    }

    fn disc(least: f32) -> Vec<u8> {
        (0..W * H)
            .map(|p| if covered(p) > least { 255 } else { 0 })
            .collect()
    }

    #[test]
    fn outlines_lie_where_pixels_are_half_covered() {
        let colours: Vec<[u8; 3]> = (0..W * H)
            .map(|p| {
                std::array::from_fn(|c| {
                    (covered(p) * OBJECT[c] + (1.0 - covered(p)) * BEHIND[c]) as u8
                })
            })
            .collect();
        // too wide, as a comparison with the background makes it, and too narrow
        for least in [0.05, 0.95] {
            let mask = disc(least);
            assert_ne!(mask, disc(0.5));
            assert_eq!(
                outline((W, H), &colours, &vec![Some(BEHIND); W * H], &mask),
                disc(0.5),
                "{least}"
            );
            assert_eq!(
                outline((W, H), &colours, &vec![None; W * H], &mask),
                mask,
                "{least}"
            );
        }
    }

    #[test]
    fn what_is_no_mixture_has_no_share() {
        let mixture = std::array::from_fn(|c| 0.3 * OBJECT[c] + 0.7 * BEHIND[c]);
        assert!((share(mixture, OBJECT, BEHIND).unwrap() - 0.3).abs() < 1e-5);
        assert_eq!(share([255.0; 3], OBJECT, BEHIND), None);
        assert_eq!(share(mixture, BEHIND.map(|c| c + 5.0), BEHIND), None);
    }
}
