//! Refines poses, focal length and exposure of the frames with their own small Adam in f64.

use crate::config::RefineConfig;
use m4_core::{Camera, Exposure, nalgebra::Vector6};
use m4_kernels::CameraGradient;

/// Rate of the logarithm of the focal length (our choice).
const FOCAL_LR: f32 = 1e-5;

/// Adam over a few numbers.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SmallAdam<const N: usize> {
    pub m: [f64; N],
    pub v: [f64; N],
    pub step: u32,
}

impl<const N: usize> Default for SmallAdam<N> {
    fn default() -> Self {
        Self {
            m: [0.0; N],
            v: [0.0; N],
            step: 0,
        }
    }
}

impl<const N: usize> SmallAdam<N> {
    /// What to add to the parameters.
    fn step(&mut self, g: &[f64; N], lr: &[f64; N]) -> [f64; N] {
        const BETA1: f64 = 0.9;
        const BETA2: f64 = 0.99;
        self.step += 1;
        let bias1 = 1.0 - BETA1.powf(f64::from(self.step));
        let bias2 = 1.0 - BETA2.powf(f64::from(self.step));
        std::array::from_fn(|k| {
            self.m[k] = BETA1 * self.m[k] + (1.0 - BETA1) * g[k];
            self.v[k] = BETA2 * self.v[k] + (1.0 - BETA2) * g[k] * g[k];
            -lr[k] * (self.m[k] / bias1) / ((self.v[k] / bias2).sqrt() + 1e-15)
        })
    }
}

/// One frame's camera, exposure and their moments.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FrameFit {
    pub camera: Camera,
    pub exposure: Exposure,
    pub pose: SmallAdam<6>,
    pub colour: SmallAdam<12>,
}

/// All frames, and the focal length that they share.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Refinement {
    pub frames: Vec<FrameFit>,
    /// Factor on every focal length, as a logarithm.
    pub log_focal: f64,
    pub focal: SmallAdam<1>,
}

impl Refinement {
    pub fn new(cameras: impl Iterator<Item = Camera>) -> Self {
        Self {
            frames: cameras
                .map(|camera| FrameFit {
                    camera,
                    exposure: Exposure::IDENTITY,
                    pose: SmallAdam::default(),
                    colour: SmallAdam::default(),
                })
                .collect(),
            log_focal: 0.0,
            focal: SmallAdam::default(),
        }
    }

    /// The camera of a frame at full size, focal length corrected.
    pub fn camera(&self, frame: usize) -> Camera {
        let mut camera = self.frames[frame].camera;
        let factor = self.log_focal.exp();
        camera.intrinsics.fx *= factor;
        camera.intrinsics.fy *= factor;
        camera
    }

    /// One step along the gradient with respect to the camera `drawn` of frame `frame`.
    pub fn step(
        &mut self,
        config: &RefineConfig,
        frame: usize,
        drawn: &Camera,
        gradient: &CameraGradient,
        median_depth: f64,
    ) {
        if config.poses && frame > 0 {
            let (t, r) = (
                f64::from(config.translation_lr) * median_depth,
                f64::from(config.rotation_lr),
            );
            let [a, b, c] = gradient.tau;
            let [d, e, f] = gradient.omega;
            let fit = &mut self.frames[frame];
            let delta = fit.pose.step(&[a, b, c, d, e, f], &[t, t, t, r, r, r]);
            let w2c = fit.camera.w2c().retract(&Vector6::from_row_slice(&delta));
            fit.camera.c2w = w2c.inverse();
        }
        if config.focal {
            let k = &drawn.intrinsics;
            let g = gradient.intrinsics[0] * k.fx + gradient.intrinsics[1] * k.fy;
            self.log_focal += self.focal.step(&[g], &[f64::from(FOCAL_LR)])[0];
        }
    }

    /// One step of the exposure of `frame` along its gradient: rows of the matrix, each followed by
    /// its offset.
    pub fn step_exposure(&mut self, config: &RefineConfig, frame: usize, mut d: [f64; 12]) {
        let fit = &mut self.frames[frame];
        let old = fit.exposure;
        let pull = f64::from(config.exposure_pull);
        for r in 0..3 {
            for k in 0..3 {
                let identity = if r == k { 1.0 } else { 0.0 };
                d[4 * r + k] += pull * (f64::from(old.matrix[r][k]) - identity);
            }
            d[4 * r + 3] += pull * f64::from(old.offset[r]);
        }
        let delta = fit.colour.step(&d, &[f64::from(config.exposure_lr); 12]);
        for r in 0..3 {
            for k in 0..3 {
                fit.exposure.matrix[r][k] += delta[4 * r + k] as f32;
            }
            fit.exposure.offset[r] += delta[4 * r + 3] as f32;
        }
    }
}

/// The gradient with respect to an exposure: rows of the matrix, each followed by its offset. `g`
/// is that with respect to the corrected colours, `rgb` the colours before.
pub(crate) fn exposure_gradient(rgb: &[Vec<f32>; 3], g: &[Vec<f32>; 3]) -> [f64; 12] {
    let mut d = [0.0f64; 12];
    for i in 0..rgb[0].len() {
        let gi = [g[0][i], g[1][i], g[2][i]];
        for r in 0..3 {
            for k in 0..3 {
                d[4 * r + k] += f64::from(gi[r] * rgb[k][i]);
            }
            d[4 * r + 3] += f64::from(gi[r]);
        }
    }
    d
}

/// Turns a gradient with respect to corrected colours into that with respect to the colours before.
pub(crate) fn pull_back(exposure: &Exposure, g: &mut [Vec<f32>; 3]) {
    for i in 0..g[0].len() {
        let gi = [g[0][i], g[1][i], g[2][i]];
        for k in 0..3 {
            g[k][i] = (0..3).map(|r| exposure.matrix[r][k] * gi[r]).sum();
        }
    }
}

/// `out = matrix rgb + offset`, pixel by pixel.
pub(crate) fn expose(exposure: &Exposure, rgb: &[Vec<f32>; 3], out: &mut [Vec<f32>; 3]) {
    let n = rgb[0].len();
    for (r, plane) in out.iter_mut().enumerate() {
        let [a, b, c] = exposure.matrix[r];
        plane.clear();
        plane.extend(
            (0..n).map(|i| a * rgb[0][i] + b * rgb[1][i] + c * rgb[2][i] + exposure.offset[r]),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::{Refinement, expose, exposure_gradient};
    use crate::config::RefineConfig;
    use m4_core::{Camera, Exposure, Intrinsics, Se3};

    #[test]
    fn exposure_finds_a_colour_cast() {
        let camera = Camera {
            intrinsics: Intrinsics::centred(8, 8, 8.0),
            c2w: Se3::identity(),
        };
        let mut fit = Refinement::new(std::iter::once(camera));
        let config = RefineConfig {
            exposure: true,
            exposure_lr: 5e-3,
            exposure_pull: 0.0,
            ..RefineConfig::default()
        };
        let rgb: [Vec<f32>; 3] = std::array::from_fn(|c| {
            (0..64)
                .map(|i| ((i * (c + 3)) % 17) as f32 / 17.0)
                .collect()
        });
        let cast = Exposure {
            matrix: [[0.8, 0.1, 0.0], [0.0, 1.1, 0.0], [0.0, 0.0, 0.9]],
            offset: [0.02, 0.0, 0.05],
        };
        let (mut want, mut got) = (rgb.clone(), rgb.clone());
        expose(&cast, &rgb, &mut want);
        let mut error = 0.0;
        for _ in 0..2000 {
            expose(&fit.frames[0].exposure, &rgb, &mut got);
            let g: [Vec<f32>; 3] = std::array::from_fn(|c| {
                got[c]
                    .iter()
                    .zip(&want[c])
                    .map(|(a, b)| (a - b) / 64.0)
                    .collect()
            });
            error = g.iter().flatten().map(|v| v.abs()).fold(0.0, f32::max) * 64.0;
            fit.step_exposure(&config, 0, exposure_gradient(&rgb, &g));
        }
        assert!(error < 0.02, "largest error {error}");
    }

    #[test]
    fn the_pose_of_the_first_frame_stays_fixed() {
        let camera = Camera {
            intrinsics: Intrinsics::centred(8, 8, 8.0),
            c2w: Se3::identity(),
        };
        let mut fit = Refinement::new([camera, camera].into_iter());
        let config = RefineConfig {
            poses: true,
            ..RefineConfig::default()
        };
        let gradient = m4_kernels::CameraGradient {
            tau: [1.0, 0.0, 0.0],
            omega: [0.0, -2.0, 0.0],
            intrinsics: [0.0; 4],
        };
        for frame in 0..2 {
            fit.step(&config, frame, &camera, &gradient, 2.0);
        }
        assert_eq!(fit.frames[0].camera, camera);
        let w2c = fit.frames[1].camera.w2c();
        assert!(
            (w2c.translation.x + 1e-4).abs() < 1e-9,
            "against the gradient, one step"
        );
    }
}
