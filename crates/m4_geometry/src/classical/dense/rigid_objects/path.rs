//! The scale of a part that stays where it is.

use super::rigid::Shape;
use super::{Clip, Tracklet};
use nalgebra::Vector3;

/// A factor on the disparities of a part, and how well it explains that the part stays in place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    pub factor: f64,
    /// What is left of the way of its middle, over the way that the wrong factor 0 would leave.
    pub rest: f64,
}

/// The factor that keeps a part's middle closest to one place.
///
/// With disparities times `q`, the middle is at `c + v / q`, `c` being the camera's centre and `v` where the
/// adjusted shape puts the middle, seen from there. Multiplied by `q` the way is linear in `q`, and its error no
/// longer favours parts close to the camera (Ozden, Schindler and Van Gool 2010 on the scale of parts).
pub(super) fn in_place(clip: &Clip<'_>, tracklet: &Tracklet, shape: &Shape) -> Option<Estimate> {
    let middle = shape.middle(clip)?;
    let (mut c, mut v) = (Vec::new(), Vec::new());
    for k in 0..tracklet.parts.len() {
        let c2w = clip.cameras[tracklet.first + k].c2w;
        c.push(c2w.translation);
        v.push(c2w.rotation * shape.poses[k].transform(&middle));
    }
    without_mean(&mut c);
    without_mean(&mut v);
    let dot = |a: &[Vector3<f64>], b: &[Vector3<f64>]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(b)).sum() };
    let (cc, cv, vv) = (dot(&c, &c), dot(&c, &v), dot(&v, &v));
    (cc > 0.0 && vv > 0.0).then(|| Estimate {
        factor: -cv / cc,
        rest: ((vv - cv * cv / cc).max(0.0) / vv).sqrt(),
    })
}

fn without_mean(values: &mut [Vector3<f64>]) {
    let mean = values.iter().sum::<Vector3<f64>>() / values.len().max(1) as f64;
    for v in values {
        *v -= mean;
    }
}
