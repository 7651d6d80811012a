//! The inputs of the backward pass for each pixel: gradients of the channels, and the light behind all splats.
use cubecl::prelude::*;

/// Fills `out`: red, green, blue, all that is blended along the gradient, depth; planes.
#[cube(launch)]
pub(crate) fn pixels(
    image: &[f32],
    gradient: &[f32],
    out: &mut [f32],
    count: u32,
    #[comptime] with_alpha: bool,
    #[comptime] with_depth: bool,
) {
    let i = ABSOLUTE_POS as u32;
    if i < count {
        let at = i as usize;
        let n = count as usize;
        let (r, g, b) = (gradient[at], gradient[n + at], gradient[2 * n + at]);
        let mut all = r * image[at] + g * image[n + at] + b * image[2 * n + at];
        if comptime!(with_alpha) {
            all -= gradient[3 * n + at] * image[3 * n + at];
        }
        if comptime!(with_depth) {
            let d = gradient[4 * n + at];
            all += d * image[4 * n + at];
            out[4 * n + at] = d;
        }
        out[at] = r;
        out[n + at] = g;
        out[2 * n + at] = b;
        out[3 * n + at] = all;
    }
}
