//! Depth of the picture against depth of the capture.

use rayon::prelude::*;

/// Pixels a task; their sums are added in order.
const CHUNK_PIXELS: usize = 8192;

/// Adds the depth loss of a frame to its gradients and returns it.
///
/// The residual of a pixel is `r = (D - z A) / z`, with `D` the composited depth, `A` alpha and `z` the
/// capture's depth (0 or not finite: no residual): the blending-weighted relative error, without a division by alpha.
/// The loss is `weight` times the mean over the pixels with depth of the Huber function of `r` (linear
/// from `huber` on, slope 1), plus `alpha_weight` times their mean transmittance.
///
/// `depth`, `transmittance` and `z` are `[height][width]`; the gradients are overwritten.
pub(crate) fn depth_loss(
    depth: &[f32],
    transmittance: &[f32],
    z: &[f32],
    (weight, huber, alpha_weight): (f32, f32, f32),
    d_depth: &mut Vec<f32>,
    d_alpha: &mut Vec<f32>,
) -> f64 {
    d_depth.resize(depth.len(), 0.0);
    d_alpha.resize(depth.len(), 0.0);
    let known = |z: f32| z > 0.0 && z.is_finite();
    let count = |z: &[f32]| z.iter().filter(|z| known(**z)).count();
    let valid: usize = z.par_chunks(CHUNK_PIXELS).map(count).sum();
    let per_pixel = 1.0 / valid.max(1) as f32;
    let gradients = d_depth
        .par_chunks_mut(CHUNK_PIXELS)
        .zip(d_alpha.par_chunks_mut(CHUNK_PIXELS));
    let pictures = depth
        .par_chunks(CHUNK_PIXELS)
        .zip(transmittance.par_chunks(CHUNK_PIXELS));
    let sums: Vec<f64> = gradients
        .zip(pictures.zip(z.par_chunks(CHUNK_PIXELS)))
        .map(|((d_depth, d_alpha), ((depth, transmittance), z))| {
            let mut sum = 0.0f64;
            for i in 0..z.len() {
                if !known(z[i]) {
                    (d_depth[i], d_alpha[i]) = (0.0, 0.0);
                    continue;
                }
                let r = (depth[i] - z[i] * (1.0 - transmittance[i])) / z[i];
                let (value, slope) = if r.abs() < huber {
                    (0.5 * r * r / huber, r / huber)
                } else {
                    (r.abs() - 0.5 * huber, r.signum())
                };
                sum += f64::from(weight * value + alpha_weight * transmittance[i]);
                d_depth[i] = weight * slope * per_pixel / z[i];
                d_alpha[i] = -(weight * slope + alpha_weight) * per_pixel;
            }
            sum
        })
        .collect();
    sums.iter().sum::<f64>() / valid.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::depth_loss;

    #[test]
    fn gradient_matches_central_differences() {
        let (depth, t, z) = (
            [2.0f32, 1.9, 3.0, 0.5],
            [0.1f32, 0.05, 0.0, 0.9],
            [2.1f32, 2.01, 0.0, 1.0],
        );
        let settings = (0.7, 0.1, 0.3);
        let (mut dd, mut da) = (Vec::new(), Vec::new());
        let value = |depth: &[f32], t: &[f32]| depth_loss(depth, t, &z, settings, &mut Vec::new(), &mut Vec::new());
        depth_loss(&depth, &t, &z, settings, &mut dd, &mut da);
        let h = 1e-3;
        for i in 0..4 {
            let step = |v: &[f32; 4], h: f32| {
                let mut v = *v;
                v[i] += h;
                v
            };
            let want = (value(&step(&depth, h), &t) - value(&step(&depth, -h), &t)) / f64::from(2.0 * h);
            assert!(
                (f64::from(dd[i]) - want).abs() < 1e-4,
                "depth {i}: {} for {want}",
                dd[i]
            );
            let want = -(value(&depth, &step(&t, h)) - value(&depth, &step(&t, -h))) / f64::from(2.0 * h);
            assert!(
                (f64::from(da[i]) - want).abs() < 1e-4,
                "alpha {i}: {} for {want}",
                da[i]
            );
        }
        assert_eq!((dd[2], da[2]), (0.0, 0.0), "no depth, no gradient");
    }

    #[test]
    fn unknown_depth_has_no_residual() {
        let (depth, t, settings) = ([1.5f32, 2.5], [0.2f32, 0.3], (0.7, 0.1, 0.3));
        for unknown in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let (mut dd, mut da) = (Vec::new(), Vec::new());
            let got = depth_loss(&depth, &t, &[unknown, 2.0], settings, &mut dd, &mut da);
            let want = depth_loss(&depth[1..], &t[1..], &[2.0], settings, &mut Vec::new(), &mut Vec::new());
            assert_eq!(got, want, "{unknown}");
            assert_eq!((dd[0], da[0]), (0.0, 0.0), "{unknown}");
        }
    }
}
