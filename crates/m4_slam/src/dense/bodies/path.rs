//! The scale of a part from its way through the scene.

use super::rigid::Shape;
use super::{Clip, Tracklet};
use nalgebra::Vector3;

/// A factor on the disparities of a part, and how well it explains the part's way.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    pub factor: f64,
    /// What is left of the way, over the way that the wrong factor 0 would leave.
    pub rest: f64,
}

/// The factor that makes the way of a part's middle closest to a polynomial of time of degree `degree` (0: it stays
/// in place; 1: it goes straight on; 2: it falls).
///
/// With disparities times `q`, the middle is at `c + v / q`, `c` being the camera's centre and `v` where the
/// adjusted shape puts the middle, seen from there. Multiplied by `q` the way is linear in `q`, and its error no
/// longer favours parts close to the camera (Ozden, Schindler and Van Gool 2010 on the scale of parts).
pub(super) fn polynomial(clip: &Clip<'_>, tracklet: &Tracklet, shape: &Shape, degree: usize) -> Option<Estimate> {
    let n = tracklet.parts.len();
    let middle = shape.middle(clip)?;
    let (mut c, mut v) = (Vec::with_capacity(n), Vec::with_capacity(n));
    for k in 0..n {
        let c2w = clip.cameras[tracklet.first + k].c2w;
        c.push(c2w.translation);
        v.push(c2w.rotation * shape.poses[k].transform(&middle));
    }
    without_polynomial(&mut c, degree);
    without_polynomial(&mut v, degree);
    let dot = |a: &[Vector3<f64>], b: &[Vector3<f64>]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(b)).sum() };
    let (cc, cv, vv) = (dot(&c, &c), dot(&c, &v), dot(&v, &v));
    if cc <= 0.0 || vv <= 0.0 {
        return None;
    }
    let factor = -cv / cc;
    Some(Estimate {
        factor,
        rest: ((vv - cv * cv / cc).max(0.0) / vv).sqrt(),
    })
}

/// Takes the best polynomial of the index out, by orthogonal polynomials on the way.
fn without_polynomial(values: &mut [Vector3<f64>], degree: usize) {
    let n = values.len();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for d in 0..=degree {
        let mut b: Vec<f64> = (0..n)
            .map(|k| (2.0 * k as f64 / n as f64 - 1.0).powi(d as i32))
            .collect();
        for e in &basis {
            let along: f64 = b.iter().zip(e).map(|(b, e)| b * e).sum();
            b.iter_mut().zip(e).for_each(|(b, e)| *b -= along * e);
        }
        let norm = b.iter().map(|b| b * b).sum::<f64>().sqrt();
        if norm < 1e-9 {
            continue;
        }
        b.iter_mut().for_each(|b| *b /= norm);
        let mut along = Vector3::zeros();
        for (v, b) in values.iter().zip(&b) {
            along += v * *b;
        }
        for (v, b) in values.iter_mut().zip(&b) {
            *v -= along * *b;
        }
        basis.push(b);
    }
}
