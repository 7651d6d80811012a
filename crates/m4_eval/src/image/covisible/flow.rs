//! Co-visibility from forward-backward optical flow.

use crate::image::{ImageError, same_size};
use m4_core::{Mask, Plane};

/// 255 where a pixel of the test image is seen in a training frame: `|f + b|^2 <= 0.01 (|f|^2 + |b|^2) + 0.5` for the flow `f` from the
/// test image to the frame and the flow `b` back, read bilinearly where `f` leads (Brox et al., ECCV 2004; `compute_occ_brox` of
/// DyCheck, but exact where OpenCV rounds places to 1/32 px). Beyond the frame `b` is 0.
///
/// `forward` and `backward` are pixels to the right and down, `[height][width]`, of equal size. A pixel whose flow is not finite is not
/// seen.
///
/// # Errors
///
/// [`ImageError::Size`] if the sizes differ.
pub fn seen_by_flow(forward: &Plane<[f32; 2]>, backward: &Plane<[f32; 2]>) -> Result<Mask, ImageError> {
    same_size("the flow back", forward.size(), backward.size())?;
    let (width, height) = forward.size();
    let square = |[u, v]: [f64; 2]| u * u + v * v;
    Ok(Plane::from_fn(width, height, |x, y| {
        let f = forward[(x, y)].map(f64::from);
        let b = bilinear(backward, x as f64 + f[0], y as f64 + f[1]);
        let apart = square([f[0] + b[0], f[1] + b[1]]);
        // false for NaN
        if apart <= 0.01 * (square(f) + square(b)) + 0.5 {
            255
        } else {
            0
        }
    }))
}

/// The flow at a place (the centre of the first pixel: 0, 0), zeros beyond the border. NaN where the place is none.
fn bilinear(flow: &Plane<[f32; 2]>, x: f64, y: f64) -> [f64; 2] {
    if !(x.is_finite() && y.is_finite()) {
        return [f64::NAN; 2];
    }
    let (width, height) = flow.size();
    let at = |x: f64, y: f64| {
        let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        if inside {
            flow[(x as usize, y as usize)].map(f64::from)
        } else {
            [0.0; 2]
        }
    };
    let (x0, y0) = (x.floor(), y.floor());
    let (tx, ty) = (x - x0, y - y0);
    let mut out = [0.0; 2];
    for (dx, dy, weight) in [
        (0.0, 0.0, (1.0 - tx) * (1.0 - ty)),
        (1.0, 0.0, tx * (1.0 - ty)),
        (0.0, 1.0, (1.0 - tx) * ty),
        (1.0, 1.0, tx * ty),
    ] {
        // a neighbour without weight may lie beyond the border, or be no number
        if weight > 0.0 {
            let near = at(x0 + dx, y0 + dy);
            out = [out[0] + weight * near[0], out[1] + weight * near[1]];
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::seen_by_flow;
    use m4_core::Plane;

    #[test]
    fn forward_backward_consistent_pixels_are_visible() {
        // everything moves by (2, -1): two columns and a row leave
        let there = Plane::filled(8, 6, [2.0, -1.0]);
        let mut back = Plane::filled(8, 6, [-2.0, 1.0]);
        back[(5, 2)] = [f32::NAN, 0.0];
        let seen = seen_by_flow(&there, &back).unwrap();
        for y in 0..6 {
            for x in 0..8 {
                let want = x < 6 && y > 0 && (x, y) != (3, 3);
                assert_eq!(seen[(x, y)], if want { 255 } else { 0 }, "{x}, {y}");
            }
        }
        assert!(seen_by_flow(&there, &Plane::filled(8, 5, [0.0; 2])).is_err());
        let wild = Plane::filled(8, 6, [f32::INFINITY, 0.0]);
        assert!(seen_by_flow(&wild, &back).unwrap().data().iter().all(|&m| m == 0));
    }

    #[test]
    fn the_consistency_limit_grows_with_the_flow() {
        let at = |there: f32, back: f32| {
            let seen = seen_by_flow(&Plane::filled(40, 1, [there, 0.0]), &Plane::filled(40, 1, [back, 0.0])).unwrap();
            seen[(0, 0)] == 255
        };
        // 0.7^2 = 0.49, 0.72^2 = 0.52 of 0.5 + 0.01 * 0.52; 20 there and 18 back: 4 of 7.74 + 0.5; 17: 9 of 7.39
        assert!(at(0.0, 0.7) && !at(0.0, 0.72));
        assert!(at(20.0, -18.0) && !at(20.0, -17.0));
    }
}
