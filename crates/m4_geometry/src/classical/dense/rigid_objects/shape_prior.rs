//! How probable a shape is by single frames, whatever moves: a part stands on its feet and bulges
//! towards the camera. Both tell a shape from its mirror image, which flow hardly does from afar.

use super::contact::Feet;
use super::edges::Part;
use super::relief;
use crate::classical::dense::regions::to_outside;
use crate::dba::Geometry;
use m4_core::quantile;
use nalgebra::Vector3;

/// Logarithm of the probability for each unit of correlation between relief and the distance from
/// the outline. That of rendered things and their true depth is 0.1 to 0.9, hardly ever below 0.
const BULGE: f64 = 4.0;
/// Frames within this time, seconds, show the same side of a part and count as one.
const ALIKE_S: f64 = 0.5;
/// Reliefs count up to this logarithm of depth.
const MOST_RELIEF: f64 = 0.3;
/// Fewest blocks of a frame that counts.
const LEAST_BLOCKS: usize = 8;

/// What single frames say of the shape of a part.
pub(super) struct ShapePrior {
    pub feet: Feet,
    /// Upright planes by frame and block ([`relief::upright`]).
    pub upright: Vec<Vec<f32>>,
    /// Root of the distance from the outline by frame and block, pixels; 0 outside.
    bulge: Vec<Vec<f64>>,
    /// Frames that show the same side.
    alike: f64,
}

impl ShapePrior {
    /// Of a part in a world in which this is `down`, if that is known.
    pub fn of(part: &Part<'_>, down: Option<&Vector3<f64>>) -> Self {
        let frames = 0..part.frames();
        Self {
            feet: Feet::of(part.clip, part.tracklet, &part.blocks),
            upright: (frames.clone())
                .map(|k| relief::upright(part, k, down))
                .collect(),
            bulge: frames.map(|k| bulge(part, k)).collect(),
            alike: part.clip.rate.frames(ALIKE_S) as f64,
        }
    }

    /// Logarithm of the probability of the shape in each frame, up to a constant.
    pub fn log_probability(&self, geometry: &Geometry<f32>) -> Vec<f64> {
        let of_frame = |k: usize| {
            let own = (geometry.disparity[k].iter()).zip(&geometry.sensor[k]);
            let piece: Vec<f32> = own.map(|(d, s)| if *s > 0.0 { *d } else { 0.0 }).collect();
            let width = geometry.grid.width;
            let contact = (self.feet).log_probability(k, |blocks| {
                relief::carried(width, &self.upright[k], &piece, blocks)
            });
            contact + BULGE * bulges(&piece, &self.bulge[k]) / self.alike
        };
        (0..geometry.frames()).map(of_frame).collect()
    }
}

fn bulge(part: &Part<'_>, k: usize) -> Vec<f64> {
    let (w, h) = (part.clip.width, part.clip.height);
    let mut inside = vec![false; w * h];
    for &p in &part.tracklet.parts[k] {
        inside[p as usize] = true;
    }
    let distance = to_outside(w, h, |p| inside[p]);
    let of_block = |g: usize| {
        let (x, y) = part.blocks.pixel(g);
        (x < w && y < h).then(|| f64::from(distance[y * w + x]).sqrt())
    };
    let blocks = 0..part.blocks.grid.len();
    blocks.map(|g| of_block(g).unwrap_or(0.0)).collect()
}

/// Correlation of the relief of disparities (0 where there is none) with the distance from the
/// outline.
fn bulges(disparity: &[f32], distance: &[f64]) -> f64 {
    let own = || disparity.iter().zip(distance).filter(|(d, _)| **d > 0.0);
    let mut values: Vec<f32> = own().map(|(d, _)| *d).collect();
    if values.len() < LEAST_BLOCKS {
        return 0.0;
    }
    let Some(median) = quantile(&mut values, 0.5) else {
        return 0.0;
    };
    let pairs: Vec<[f64; 2]> = own()
        .map(|(d, distance)| {
            let relief = f64::from(d / median).ln();
            [relief.clamp(-MOST_RELIEF, MOST_RELIEF), *distance]
        })
        .collect();
    let mean = |i: usize| pairs.iter().map(|pair| pair[i]).sum::<f64>() / pairs.len() as f64;
    let means = [mean(0), mean(1)];
    let sum = |i: usize, j: usize| -> f64 {
        let product = |pair: &[f64; 2]| (pair[i] - means[i]) * (pair[j] - means[j]);
        pairs.iter().map(product).sum()
    };
    let squares = sum(0, 0) * sum(1, 1);
    match squares > 0.0 {
        true => sum(0, 1) / squares.sqrt(),
        false => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::bulges;

    #[test]
    fn a_ball_bulges_and_its_mirror_image_does_not() {
        let distance: Vec<f64> = (0..100).map(|g| f64::from(g % 10)).collect();
        let ball: Vec<f32> = distance.iter().map(|d| 1.0 + 0.01 * *d as f32).collect();
        let hollow: Vec<f32> = ball.iter().map(|d| 1.0 / d).collect();
        assert!(bulges(&ball, &distance) > 0.9);
        assert!(bulges(&hollow, &distance) < -0.9);
        assert_eq!(bulges(&[1.0; 100], &distance), 0.0);
        assert_eq!(bulges(&ball[..5], &distance), 0.0);
    }
}
