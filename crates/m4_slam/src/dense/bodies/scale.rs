//! The one number that the motion of a part does not reveal.

use super::super::config::{BodyConfig, MovingDepthConfig};
use super::super::shot::quantile;
use super::path::polynomial;
use super::rigid::Shape;
use super::{Clip, Tracklet};

/// The factor on the disparities of a part.
///
/// In every frame the part is at least as near as what it hides and as the ground at its feet: a lower bound of
/// the factor, which is met while it touches the scene. The bounds of all frames are in one unit, so a high
/// quantile of them is the touch, and a few bad readings do no harm.
pub(super) fn find(
    clip: &Clip<'_>,
    tracklet: &Tracklet,
    shape: &Shape,
    contact: &MovingDepthConfig,
    config: &BodyConfig,
) -> Option<f32> {
    let mut bounds: Vec<f32> = (0..tracklet.parts.len())
        .filter_map(|k| bound(clip, tracklet, shape, k, contact))
        .collect();
    let touch = quantile(&mut bounds, f64::from(config.touch_quantile))?;
    // Nothing but the right factor makes a part stay where it is while the camera passes it.
    let still = polynomial(clip, tracklet, shape, 0).filter(|e| {
        let factor = e.factor as f32;
        e.rest < config.still_rest && factor > touch / config.still_range && factor < touch * config.still_range
    });
    Some(still.map_or(touch, |e| e.factor as f32))
}

fn bound(clip: &Clip<'_>, tracklet: &Tracklet, shape: &Shape, k: usize, contact: &MovingDepthConfig) -> Option<f32> {
    let (w, h) = (clip.width, clip.height);
    let background = &clip.background[tracklet.first + k];
    let pixels = &tracklet.parts[k];
    let row = |i: u32| i as usize / w;
    let (top, bottom) = (row(*pixels.first()?), row(*pixels.last()?));
    let feet_from = bottom - ((bottom - top) as f32 * contact.feet_share) as usize;
    let (mut feet, mut hidden) = (Vec::new(), Vec::new());
    for (p, d) in shape.known(clip, k) {
        hidden.push(background[p as usize] / d);
        if row(p) + 2 >= feet_from && bottom + 1 + contact.below_px < h {
            let below = (bottom + contact.below_px).min(h - 1);
            feet.push(background[below * w + p as usize % w] / d);
        }
    }
    let feet = quantile(&mut feet, 0.5).unwrap_or(0.0);
    let hidden = quantile(&mut hidden, contact.hidden_quantile).unwrap_or(0.0);
    Some(feet.max(hidden)).filter(|b| *b > 0.0)
}
