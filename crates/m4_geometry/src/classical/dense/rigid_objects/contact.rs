//! Where a part touches the ground below it.
//!
//! Nothing is below the ground, so the lowest point of each column of a part is a lower bound of
//! its scale: it touches the ground or hangs above it. The scale of the frame is the most probable
//! one if each column does either. How probable that is tells shapes apart: of a cart and its
//! mirror image, one has all wheels on the ground.

use super::edges::Blocks;
use super::local_ground::LocalGround;
use super::shape::Shape;
use super::{BLOCK_PX, Tracklet, WorkingClip};
use crate::classical::dense::moving_depth::{BELOW_PX, FEET_SHARE};
use m4_core::quantile;

/// Columns count for the scale whose lowest point is in this lowest share of the part, and for its
/// shape those in the second.
const LOWEST_SHARE: f64 = 0.15;
const LOW_SHARE: f64 = 0.35;
/// Probability that such a column touches the ground, and the standard deviation of the logarithm
/// of the scale by one that does: of outlines and of relief. Half and twice as much of either
/// changes distances of rendered objects by less than 1.5 %.
const TOUCHES: f64 = 0.5;
const SIGMA: f64 = 0.02;
/// Range of logarithms over which a column that hangs may be below the scale.
const HANGS: f64 = 0.3;
/// Density of columns that are wrong altogether.
const WRONG: f64 = 1e-4;
/// Steps of the search, and how far below and above the nearest column it goes.
const STEP: f64 = 0.0025;
const BELOW: f64 = 0.25;
const ABOVE: f64 = 0.02;
/// Neighbouring columns, and frames within this time, seconds, are off alike and count as one.
const COLUMNS_ALIKE: f64 = 3.0;
const ALIKE_S: f64 = 1.0 / 6.0;
/// A region has ground under it where the background there comes nearer by more than this share of
/// its disparity per row.
const GROUND_SLOPE: f32 = 0.003;
/// Over how many rows the slope of the ground is read.
const SLOPE_ROWS: usize = 6;

/// The lower ends of the outline of a part, by frame of its tracklet.
pub(super) struct Feet {
    frames: Vec<Frame>,
    /// Frames and columns that count as one.
    alike: f64,
}

#[derive(Default)]
struct Frame {
    ends: Vec<End>,
    /// Whether what is under the part is ground, and not a wall.
    on_ground: bool,
}

/// The lower end of a column of blocks.
struct End {
    block: usize,
    /// Disparity of the ground there.
    ground: f32,
    /// Whether it is in [`LOWEST_SHARE`].
    lowest: bool,
}

impl Feet {
    /// Of the part whose shape has these blocks.
    pub fn of(clip: &WorkingClip<'_>, tracklet: &Tracklet, blocks: &Blocks) -> Self {
        let of_frame = |k: usize| Frame::of(clip, tracklet.first + k, &tracklet.parts[k], blocks);
        let frames = (0..tracklet.parts.len()).map(|k| of_frame(k).unwrap_or_default());
        Self {
            frames: frames.collect(),
            alike: COLUMNS_ALIKE * clip.rate.frames(ALIKE_S) as f64,
        }
    }

    /// The factor on the disparities of a shape by the ground under it in frame `k`; `None` where
    /// no column says anything.
    pub fn factor(&self, k: usize, shape: &Shape) -> Option<f32> {
        let disparity = &shape.disparity[k];
        self.factor_of(k, |blocks| blocks.iter().map(|&g| disparity[g]).collect())
    }

    /// The same of disparities that are given for blocks; 0 for those that do not count.
    pub fn factor_of(&self, k: usize, disparity: impl Fn(&[usize]) -> Vec<f32>) -> Option<f32> {
        let ends = || self.frames[k].ends.iter().filter(|end| end.lowest);
        let blocks: Vec<usize> = ends().map(|end| end.block).collect();
        let columns: Vec<f64> = ends()
            .zip(disparity(&blocks))
            .filter_map(|(end, d)| end.scale(d))
            .collect();
        touching(&columns).map(|(_, scale)| scale.exp() as f32)
    }

    /// Whether there is ground under the part in frame `k`.
    pub fn on_ground(&self, k: usize) -> bool {
        self.frames[k].on_ground
    }

    /// Logarithm of the probability of a shape in frame `k` at its best scale, up to a constant.
    /// `disparity` gives that of blocks, or nothing.
    pub fn log_probability(&self, k: usize, disparity: impl Fn(&[usize]) -> Vec<f32>) -> f64 {
        let frame = &self.frames[k];
        if !frame.on_ground {
            return 0.0;
        }
        let blocks: Vec<usize> = frame.ends.iter().map(|end| end.block).collect();
        let columns: Vec<f64> = (frame.ends.iter())
            .zip(disparity(&blocks))
            .filter_map(|(end, d)| end.scale(d))
            .collect();
        touching(&columns).map_or(0.0, |(log, _)| log / self.alike)
    }
}

impl Frame {
    /// Of a part of these `pixels` (rising) in frame `i`; `None` where there is no ground in view.
    fn of(clip: &WorkingClip<'_>, i: usize, pixels: &[u32], blocks: &Blocks) -> Option<Self> {
        let row = |p: &u32| *p as usize / clip.width;
        let (top, bottom) = (row(pixels.first()?), row(pixels.last()?));
        if bottom + BELOW_PX + 1 >= clip.height {
            return None;
        }
        let ground = LocalGround::under(clip, i, pixels)?;
        // rising, so that the last of a column is its lowest
        let mut lowest = vec![None; clip.width];
        for p in pixels {
            lowest[*p as usize % clip.width] = Some(row(p));
        }
        let height = (bottom - top) as f64;
        let zone = |share: f64| (share * height).max(BLOCK_PX as f64);
        let grid = blocks.grid;
        let of_column = |column: usize| {
            let inside = |g: &usize| {
                let (x, y) = blocks.pixel(*g);
                pixels.binary_search(&((y * clip.width + x) as u32)).is_ok()
            };
            let block = (0..grid.height)
                .rev()
                .map(|row| row * grid.width + column)
                .find(inside)?;
            let (x, y) = blocks.pixel(block);
            let around = x.saturating_sub(BLOCK_PX / 2)..(x + BLOCK_PX / 2).min(clip.width);
            let mut ends: Vec<usize> = lowest[around].iter().copied().flatten().collect();
            ends.sort_unstable();
            let end = *ends.get(ends.len() / 2)?;
            let above = bottom.saturating_sub(end) as f64;
            let near = end < y + 2 * BLOCK_PX && above <= zone(LOW_SHARE);
            near.then(|| End {
                block,
                ground: ground.at(x as f64, end as f64 + 0.5) as f32,
                lowest: above <= zone(LOWEST_SHARE),
            })
        };
        Some(Self {
            ends: (0..grid.width).filter_map(of_column).collect(),
            on_ground: slope_below(clip, i, pixels).is_some_and(|slope| slope > GROUND_SLOPE),
        })
    }
}

impl End {
    /// Logarithm of the factor that puts this disparity on the ground.
    fn scale(&self, disparity: f32) -> Option<f64> {
        (self.ground > 0.0 && disparity > 0.0).then(|| f64::from(self.ground / disparity).ln())
    }
}

/// How fast the background comes nearer downwards below the lowest of `pixels` (rising) in frame
/// `i`, as a share of its disparity a row: a wall's is about 0.
fn slope_below(clip: &WorkingClip<'_>, i: usize, pixels: &[u32]) -> Option<f32> {
    let (w, background) = (clip.width, &clip.disparity[i]);
    let row = |p: u32| p as usize / w;
    let (top, bottom) = (row(*pixels.first()?), row(*pixels.last()?));
    let feet_from = bottom - ((bottom - top) as f32 * FEET_SHARE) as usize;
    let near = (bottom + BELOW_PX).min(clip.height - 1);
    let further = (near + SLOPE_ROWS).min(clip.height - 1);
    let of_column = |p: &u32| {
        let ground = |y: usize| background[y * w + *p as usize % w];
        (ground(further) / ground(near) - 1.0) / (further - near).max(1) as f32
    };
    let feet = pixels.iter().filter(|p| row(**p) >= feet_from);
    quantile(&mut feet.map(of_column).collect::<Vec<f32>>(), 0.5)
}

/// The most probable scale of columns that touch the ground or hang above it, and the logarithm of
/// its probability.
fn touching(columns: &[f64]) -> Option<(f64, f64)> {
    let nearest = columns.iter().copied().reduce(f64::max)?;
    let likelihood = |scale: f64| -> f64 {
        let of_column = |column: &f64| {
            let off = (column - scale) / SIGMA;
            let touches = (-0.5 * off * off).exp() / (SIGMA * std::f64::consts::TAU.sqrt());
            let hangs = if off < 0.0 { 1.0 / HANGS } else { 0.0 };
            (TOUCHES * touches + (1.0 - TOUCHES) * hangs + WRONG).ln()
        };
        columns.iter().map(of_column).sum()
    };
    let steps = ((BELOW + ABOVE) / STEP) as usize;
    (0..=steps)
        .map(|step| nearest + ABOVE - step as f64 * STEP)
        .map(|scale| (likelihood(scale), scale))
        .max_by(|a, b| a.0.total_cmp(&b.0))
}

#[cfg(test)]
mod tests {
    use super::super::edges::Blocks;
    use super::{Feet, Shape, Tracklet, touching};
    use crate::classical::dense::working::ClipData;

    const W: usize = 120;
    const H: usize = 90;

    #[test]
    fn columns_that_hang_above_the_ground_do_not_count() {
        let noise = |i: usize| 0.015 * ((i * 7 % 5) as f64 - 2.0) / 2.0;
        // an axle between two wheels
        let wheels = |i: usize| if i.is_multiple_of(3) { 0.1 } else { -0.08 };
        let columns: Vec<f64> = (0..15).map(|i| wheels(i) + noise(i)).collect();
        let (_, scale) = touching(&columns).unwrap();
        assert!((scale - 0.1).abs() < 0.02, "{scale}");
        // a box that touches with all of its lower edge
        let columns: Vec<f64> = (0..15).map(|i| 0.1 + noise(i)).collect();
        let (_, scale) = touching(&columns).unwrap();
        assert!((scale - 0.1).abs() < 0.01, "{scale}");
        assert_eq!(touching(&[]), None);
    }

    /// Ground of disparity 0.2 at the top of the image and 0.01 more a row.
    fn ground(y: f32) -> f32 {
        0.2 + 0.01 * y
    }

    /// The feet of a part whose columns end at these rows, and its shape of disparity 0.5.
    fn of_outline(end: impl Fn(usize) -> usize) -> (Feet, Shape) {
        let inside = |p: usize| (40..80).contains(&(p % W)) && (20..=end(p % W)).contains(&(p / W));
        let pixels: Vec<u32> = (0..W * H)
            .filter(|p| inside(*p))
            .map(|p| p as u32)
            .collect();
        let data = ClipData {
            size: (W, H),
            cameras: Vec::new(),
            dynamic: vec![(0..W * H).map(|p| 255 * u8::from(inside(p))).collect()],
            disparity: vec![(0..W * H).map(|p| ground((p / W) as f32)).collect()],
            flows: Vec::new(),
        };
        let clip = data.clip();
        let tracklet = Tracklet {
            first: 0,
            parts: vec![pixels],
        };
        let blocks = Blocks::around(&clip, &tracklet);
        let value = |g: usize| {
            let (x, y) = blocks.pixel(g);
            if inside(y * W + x) { 0.5 } else { 0.0 }
        };
        let shape = Shape {
            poses: Vec::new(),
            disparity: vec![(0..blocks.grid.len()).map(value).collect()],
            whole: None,
            blocks: blocks.clone(),
        };
        (Feet::of(&clip, &tracklet, &blocks), shape)
    }

    #[test]
    fn the_ground_is_read_where_the_outline_ends() {
        let factor = |end: &dyn Fn(usize) -> usize| {
            let (feet, shape) = of_outline(end);
            feet.factor(0, &shape).unwrap() / (ground(59.5) / 0.5)
        };
        let off = |share: f32| share.ln().abs();
        let level = factor(&|_| 59);
        assert!(off(level) < 0.003, "{level}");
        // two feet and a belly
        let animal = factor(&|x| if x % 20 < 8 { 59 } else { 50 });
        assert!(off(animal) < 0.01, "{animal}");
        // the corner of a box, seen from the side, rests on the ground farther up: as near as it
        let corner = factor(&|x| 59 - (x - 40) / 8);
        assert!(corner < 1.0 && off(corner) < 0.05, "{corner}");
    }

    #[test]
    fn a_box_stands_on_the_ground_more_probably_than_its_mirror_image() {
        let end = |x: usize| 59 - (x - 40) / 4;
        let (feet, shape) = of_outline(end);
        assert!(feet.on_ground(0));
        let log = |power: f32| {
            feet.log_probability(0, |blocks| {
                let disparity = |g: &usize| {
                    let (x, _) = shape.blocks.pixel(*g);
                    (ground(end(x) as f32) / ground(54.0)).powf(power)
                };
                blocks.iter().map(disparity).collect()
            })
        };
        let [right, flat, mirrored] = [1.0, 0.0, -1.0].map(log);
        assert!(
            right > flat + 0.2 && flat > mirrored + 0.2,
            "{right} {flat} {mirrored}"
        );
    }
}
