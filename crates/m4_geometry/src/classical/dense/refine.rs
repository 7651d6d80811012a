//! Refines static depth below the precision of the sweep: Gauss-Newton on brightness over growing
//! baselines.

use super::shot::{Pair, Shot};
use super::working::pixel_at;
use crate::smooth::box_blur;
use m4_core::{Camera, cubic, quantile};

/// Parallax of the frames of each round, pixels at the working size: the error that one round
/// leaves is within reach of the next. A step at the widest parallax leaves a part of the error
/// there, too, so there are two of them.
pub(super) const PARALLAX_PX: [&[f64]; 4] = [&[12.0], &[12.0, 24.0], &[24.0, 48.0], &[24.0, 48.0]];
/// Frames of a round, fewer where the clip has no more that are far enough away.
pub(super) const FRAMES: usize = 4;
/// Parallax between frames that are refined, pixels at the working size: those between them see the
/// same, and merging brings its depth to them. With 2, 3 and 4 pixels static depth of `pendulum-1`,
/// which has the least parallax of the first group, is off by 2, 4 and 4 % more, that of other
/// scenes by as much as without.
pub(super) const KEYFRAME_PX: f64 = 3.0;
/// Standard deviation of the disparity before, in steps of the sweep.
const PRIOR_STEPS: f32 = 0.5;
/// A pixel is taken for hidden in a frame whose own disparity there differs by more than this, in
/// steps of the sweep.
const HIDDEN_STEPS: f32 = 1.0;
/// Least noise of the difference of two brightnesses, 0..255.
const LEAST_NOISE: f32 = 0.5;
/// Pixels that [`box_blur`] averages.
const WINDOW: f32 = 25.0;
/// Every n-th pixel counts for the noise.
const NOISE_STRIDE: usize = 7;

/// A clip with first estimates; lists are by frame, planes `[height][width]`.
pub(super) struct Estimates<'a> {
    pub shots: &'a [Shot],
    pub cameras: &'a [Camera],
    /// Of every pixel.
    pub disparity: &'a [Vec<f32>],
    /// Above 0 in dynamic regions, which are left as they are.
    pub dynamic: &'a [Vec<u8>],
}

impl Estimates<'_> {
    /// The disparity of frame `i` after a round against each list of frames. In a window of 5x5
    /// pixels the step is that of least squares with the weights of Cauchy, held by the disparity
    /// before as far as its standard deviation allows, and by one step of the sweep. Exposure and
    /// shading do not matter: differences count less their mean around the pixel.
    pub fn refined(&self, rounds: &[Vec<usize>], i: usize) -> Vec<f32> {
        let shot = &self.shots[i];
        let (w, h) = (shot.frame.width, shot.frame.height);
        let slopes = slopes(w, h, &shot.frame.grey);
        let mut out = self.disparity[i].clone();
        let limit = shot.range.step;
        let prior = (PRIOR_STEPS * limit).powi(-2) / WINDOW;
        for others in rounds {
            let (mut gradient, mut curvature) = (vec![0.0f32; w * h], vec![0.0f32; w * h]);
            for &j in others {
                self.add(&slopes, &out, (i, j), &mut gradient, &mut curvature);
            }
            box_blur::<5>(w, h, &mut gradient);
            box_blur::<5>(w, h, &mut curvature);
            for (d, (g, c)) in out.iter_mut().zip(gradient.iter().zip(&curvature)) {
                *d -= (g / (c + prior)).clamp(-limit, limit);
            }
        }
        out
    }

    /// Adds the gradient and the curvature of the disparity of each pixel of frame `i` against
    /// frame `j`.
    fn add(
        &self,
        slopes: &[[f32; 2]],
        disparity: &[f32],
        (i, j): (usize, usize),
        gradient: &mut [f32],
        curvature: &mut [f32],
    ) {
        let (w, h) = (self.shots[i].frame.width, self.shots[i].frame.height);
        let (mine, theirs) = (&self.shots[i].frame.grey, &self.shots[j].frame.grey);
        let pair = Pair::new(&self.cameras[i], &self.cameras[j]);
        let hidden = HIDDEN_STEPS * self.shots[j].range.step;
        // what each pixel that both see differs by, and by how much more per disparity
        let sample = |p: usize| {
            let at = pair.project((p % w) as f32, (p / w) as f32, disparity[p]);
            let q = pixel_at(w, h, at.x, at.y).filter(|_| at.disparity > 0.0)?;
            if self.dynamic[i][p] > 0
                || self.dynamic[j][q] > 0
                || (self.disparity[j][q] - at.disparity).abs() > hidden
            {
                return None;
            }
            let z = at.disparity / disparity[p];
            let (dx, dy) = (
                (pair.b[0] - at.x * pair.b[2]) * z,
                (pair.b[1] - at.y * pair.b[2]) * z,
            );
            Some((
                p,
                cubic(w, h, theirs, at.x, at.y) - mine[p],
                slopes[p][0] * dx + slopes[p][1] * dy,
            ))
        };
        let mut samples: Vec<(usize, f32, f32)> = (0..w * h).filter_map(sample).collect();
        centre(w, h, &mut samples);
        let mut sizes: Vec<f32> = samples
            .iter()
            .step_by(NOISE_STRIDE)
            .map(|s| s.1.abs())
            .collect();
        let noise = 1.4826 * quantile(&mut sizes, 0.5).unwrap_or(0.0).max(LEAST_NOISE);
        for (p, residual, slope) in samples {
            let weight = 1.0 / (noise * noise + residual * residual);
            gradient[p] += weight * slope * residual;
            curvature[p] += weight * slope * slope;
        }
    }
}

/// Takes the mean around its pixel out of the difference and the slope of every sample (pixel,
/// difference, slope).
///
/// Both are of the aligned images. Means taken from each image before would leave a halo around
/// every line and edge, of one width in all views, however much a view stretches the surface, and a
/// plain surface beside an edge shows nothing but that halo.
fn centre(width: usize, height: usize, samples: &mut [(usize, f32, f32)]) {
    let around = |of: fn(&(usize, f32, f32)) -> f32| {
        let mut plane = vec![0.0f32; width * height];
        samples
            .iter()
            .for_each(|sample| plane[sample.0] = of(sample));
        box_blur::<5>(width, height, &mut plane);
        box_blur::<5>(width, height, &mut plane);
        plane
    };
    let (count, difference, slope) = (
        around(|_| 1.0),
        around(|sample| sample.1),
        around(|sample| sample.2),
    );
    for sample in samples {
        sample.1 -= difference[sample.0] / count[sample.0];
        sample.2 -= slope[sample.0] / count[sample.0];
    }
}

/// Central differences along x and y, one-sided at the rim.
fn slopes(width: usize, height: usize, plane: &[f32]) -> Vec<[f32; 2]> {
    let at = |p: usize| {
        let (x, y) = (p % width, p / width);
        let (left, right) = (p - usize::from(x > 0), p + usize::from(x + 1 < width));
        let (above, below) = (
            p - width * usize::from(y > 0),
            p + width * usize::from(y + 1 < height),
        );
        let slope = |a: usize, b: usize, step: usize| {
            (plane[b] - plane[a]) / ((b - a) / step).max(1) as f32
        };
        [slope(left, right, 1), slope(above, below, width)]
    };
    (0..width * height).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::{Estimates, centre};
    use crate::classical::dense::shot::Shot;

    #[test]
    fn brightness_finds_the_disparity_that_the_sweep_missed() {
        let (w, h, truth) = (60, 40, 2.0);
        let (mut shots, cameras) = Shot::of_wall(7, (w, h), truth);
        // the exposure changes, and a shade goes over the wall with the camera
        for (i, shot) in shots.iter_mut().enumerate() {
            shot.frame
                .grey
                .iter_mut()
                .enumerate()
                .for_each(|(p, grey)| *grey += 6.0 * i as f32 + 0.3 * (p % w) as f32);
        }
        let dynamic = vec![vec![0u8; w * h]; 7];
        let disparity = vec![vec![1.02 * truth; w * h]; 7];
        let clip = Estimates {
            shots: &shots,
            cameras: &cameras,
            disparity: &disparity,
            dynamic: &dynamic,
        };
        let actual = clip.refined(&[vec![2, 4], vec![1, 5]], 3);
        let inside =
            (0..w * h).filter(|p| (12..w - 12).contains(&(p % w)) && (4..h - 4).contains(&(p / w)));
        let errors: Vec<f32> = inside.map(|p| (actual[p] / truth - 1.0).abs()).collect();
        let mean = errors.iter().sum::<f32>() / errors.len() as f32;
        assert!(mean < 0.002, "{mean} of 0.02 is left");
        // dynamic pixels stay as they are
        let dynamic = vec![vec![255u8; w * h]; 7];
        let clip = Estimates {
            dynamic: &dynamic,
            ..clip
        };
        assert_eq!(clip.refined(&[vec![2, 4]], 3), disparity[3]);
    }
    /// One line on a plain wall, which the other camera sees a fifth larger: what is left of its
    /// mean in each image must not pull at the plain surface beside it.
    #[test]
    fn plain_surfaces_beside_a_line_stay_where_they_are() {
        let (w, h, truth) = (60, 40, 2.0_f32);
        let (mut shots, mut cameras) = Shot::of_wall(2, (w, h), truth);
        cameras[1].c2w.translation.z = 1.0 / 12.0;
        let dynamic = vec![vec![0u8; w * h]; 2];
        // the wall in the two images, and how far pixels beside the line go
        let place = |i: usize, x: usize| {
            (x as f32 - 29.5) * if i == 0 { 1.0 } else { 5.0 / 6.0 } + 2.0 * i as f32
        };
        for (i, shot) in shots.iter_mut().enumerate() {
            shot.frame.grey = (0..w * h)
                .map(|p| 90.0 + 60.0 * (-0.1 * (place(i, p % w) - 3.0).powi(2)).exp())
                .collect();
        }
        let disparity = vec![vec![truth; w * h], vec![1.2 * truth; w * h]];
        let moved = |shots: &[Shot]| {
            let clip = Estimates {
                shots,
                cameras: &cameras,
                disparity: &disparity,
                dynamic: &dynamic,
            };
            let actual = clip.refined(&[vec![1], vec![1]], 0);
            let beside = (0..w * h).filter(|p| {
                (6..11).contains(&(p % w).abs_diff(32)) && (4..h - 4).contains(&(p / w))
            });
            beside
                .map(|p| (actual[p] / truth - 1.0).abs())
                .fold(0.0, f32::max)
        };
        let now = moved(&shots);
        for shot in &mut shots {
            let mut mean = shot.frame.grey.clone();
            super::box_blur::<5>(w, h, &mut mean);
            super::box_blur::<5>(w, h, &mut mean);
            shot.frame
                .grey
                .iter_mut()
                .zip(mean)
                .for_each(|(grey, mean)| *grey -= mean);
        }
        let with_halos = moved(&shots);
        assert!(
            now < 0.012 && with_halos > 0.025,
            "{now} of the disparity, {with_halos} with halos"
        );
    }

    #[test]
    fn what_is_alike_around_a_pixel_is_taken_out() {
        let (w, h) = (20, 16);
        let one = |p: usize| (p, 7.0 + f32::from(u8::from(p == 168)), -3.0);
        // every third pixel is hidden
        let mut samples: Vec<_> = (0..w * h).filter(|p| p % 3 != 1).map(one).collect();
        centre(w, h, &mut samples);
        for (p, difference, slope) in samples {
            let near = (p % w).abs_diff(8) <= 4 && (p / w).abs_diff(8) <= 4;
            let range = if p == 168 {
                0.8..1.0
            } else if near {
                -0.1..1e-4
            } else {
                -1e-4..1e-4
            };
            assert!(
                range.contains(&difference) && slope.abs() < 1e-4,
                "pixel {p}: {difference}, {slope}"
            );
        }
    }
}
