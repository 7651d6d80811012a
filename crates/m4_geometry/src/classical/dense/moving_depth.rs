//! Depth of dynamic regions, which no stereo over time can measure: from where it touches the
//! scene.

use super::regions::Components;
use super::temporal;
use super::working::WorkingClip;
use m4_core::quantile;
use rayon::prelude::*;

/// Time in which the depth of other frames along the flow counts e times less, seconds.
const MEMORY_S: f64 = 1.0 / 3.0;
/// Power of the disparity that is averaged: 1 for the plain mean, more to favour the nearest: 4
/// lowers the error of falling toys from 0.34 to 0.27 of their depth and costs toys on the ground
/// 0.01 to 0.02.
const POWER: f32 = 4.0;
/// Flow whose round trip misses by more than this is not followed, pixels at the working size.
const ROUND_TRIP_PX: f32 = 2.0;
/// Lowest share of the height of a region in which it may touch the ground.
pub(super) const FEET_SHARE: f32 = 0.1;
/// How far under the lowest pixels of a region the ground is read, pixels at the working size:
/// outlines are right to a pixel.
pub(super) const BELOW_PX: usize = 1;
/// Share of the background behind a region that the region must be in front of.
pub(super) const HIDDEN_QUANTILE: f64 = 0.98;

/// Disparity of every pixel of every frame: that of static regions, and in front of it the dynamic
/// ones.
///
/// Means over time along the flow, forwards and backwards in time with the same decay, so that
/// parts neither jump nor lag.
pub(super) fn place(clip: &WorkingClip<'_>) -> Vec<Vec<f32>> {
    // Both readings are lower bounds of disparity, exact only while a part touches the scene: along
    // time the greater ones say more, so means are taken of a power.
    let touched: Vec<Vec<f32>> = (clip.dynamic.par_iter().zip(clip.disparity))
        .map(|(dynamic, background)| {
            let mut disparity = touch(clip.width, clip.height, dynamic, background);
            for d in &mut disparity {
                *d = d.powf(POWER);
            }
            disparity
        })
        .collect();
    // Along parts alone.
    let trust = |step: &temporal::Step| {
        let inside = clip.dynamic[step.frame][step.pixel] > 0
            && clip.dynamic[step.other_frame][step.other_pixel] > 0;
        if inside && step.round_trip_px < ROUND_TRIP_PX {
            1.0
        } else {
            0.0
        }
    };
    let memory = clip.rate.exact(MEMORY_S).max(1.0) as f32;
    let means = temporal::mean(clip.width, &touched, clip.flows, memory, trust);
    let disparity = |(i, means): (usize, Vec<f32>)| {
        let here = means
            .into_iter()
            .zip(&clip.dynamic[i])
            .zip(&clip.disparity[i]);
        here.map(|((mean, dynamic), background)| match dynamic {
            0 => *background,
            _ => mean.max(0.0).powf(1.0 / POWER).max(*background),
        })
        .collect()
    };
    means.into_iter().enumerate().map(disparity).collect()
}

/// Disparity of each part: constant, in front of what it hides, and that of the ground under it.
///
/// `background` is the static disparity with dynamic parts filled from their surroundings, so its
/// value at the bottom of a part is that of the ground on which the part stands.
fn touch(width: usize, height: usize, dynamic: &[u8], background: &[f32]) -> Vec<f32> {
    let mut out = background.to_vec();
    for pixels in Components::of(width, height, dynamic).pixels {
        let row = |i: u32| i as usize / width;
        // In order of rows, so the first and last pixels give the extent.
        let (top, bottom) = (row(pixels[0]), row(pixels[pixels.len() - 1]));
        let feet_from = bottom - ((bottom - top) as f32 * FEET_SHARE) as usize;
        let below = |i: u32| {
            // Just under the part, where the background was seen and not filled.
            let y = (row(i) + BELOW_PX).min(height - 1);
            background[y * width + i as usize % width]
        };
        let mut feet: Vec<f32> = pixels
            .iter()
            .filter(|&&i| row(i) >= feet_from)
            .map(|&i| below(i))
            .collect();
        let mut hidden: Vec<f32> = pixels.iter().map(|&i| background[i as usize]).collect();
        let feet = quantile(&mut feet, 0.5).unwrap_or(0.0);
        let hidden = quantile(&mut hidden, HIDDEN_QUANTILE).unwrap_or(0.0);
        let disparity = feet.max(hidden);
        for i in pixels {
            out[i as usize] = disparity;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::WorkingClip;
    use crate::FrameRate;
    use crate::flow::FlowPair;
    use m4_core::Flow;

    const W: usize = 24;
    const H: usize = 20;

    /// A wall above row 8, then ground that comes nearer downwards.
    fn ground() -> Vec<f32> {
        (0..W * H)
            .map(|i| 0.2 + 0.05 * (i / W).saturating_sub(8) as f32)
            .collect()
    }

    fn block(left: usize) -> Vec<u8> {
        let inside = |x: usize, y: usize| (left..left + 5).contains(&x) && (4..14).contains(&y);
        (0..W * H)
            .map(|i| if inside(i % W, i / W) { 255 } else { 0 })
            .collect()
    }

    fn place(dynamic: &[Vec<u8>], disparity: &[Vec<f32>], flows: &[FlowPair]) -> Vec<Vec<f32>> {
        super::place(&WorkingClip {
            width: W,
            height: H,
            rate: FrameRate::FILM,
            cameras: &[],
            dynamic,
            disparity,
            flows,
        })
    }

    #[test]
    fn objects_on_the_ground_have_the_depth_of_their_contact() {
        let out = place(&[block(6)], &[ground()], &[]);
        let inside = out[0][6 * W + 8];
        // The lowest row is 13; the ground is read a row below.
        assert!((inside - ground()[14 * W]).abs() < 0.06, "{inside}");
        assert_eq!(out[0][6 * W + 2], ground()[6 * W]);
    }

    #[test]
    fn depth_jumps_are_smoothed_in_time_in_front_of_the_background() {
        let dynamic: Vec<Vec<u8>> = (0..5).map(|k| block(4 + 2 * k)).collect();
        let mut background = vec![ground(); 5];
        for d in &mut background[2] {
            *d *= 1.5;
        }
        let flow = |u: f32| Flow {
            u: vec![u; W * H],
            ..Flow::zero(W, H)
        };
        let flows: Vec<FlowPair> = (0..4)
            .map(|_| FlowPair {
                forward: flow(2.0),
                backward: flow(-2.0),
            })
            .collect();
        let out = place(&dynamic, &background, &flows);
        let at = |k: usize| out[k][6 * W + 6 + 2 * k];
        let (calm, jump) = (at(0), at(2));
        assert!(jump / calm < 1.35 && jump >= calm, "{calm} {jump}");
        for k in 0..5 {
            assert!(
                out[k].iter().zip(&background[k]).all(|(d, b)| d >= b),
                "frame {k}"
            );
        }
    }
}
