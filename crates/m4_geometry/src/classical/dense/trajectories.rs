//! Places that the flow leads pixels to, against what static points would do.
//!
//! If a pixel is static, one disparity explains all of its places in the frames before and after.
//! The disparity that fits best is found in closed form, with the estimated one as a prior; a
//! velocity that is fitted besides says how much more likely a dynamic pixel is, given the noise of
//! the flow. Long spans tell slow motion, which is below the noise of short ones, and motion that
//! looks like another depth as long as the camera moves evenly.

use super::shot::{Pair, Reprojected, Shot};
use super::working::nearest_pixel;
use crate::FrameRate;
use crate::flow::{FlowPair, ScaledFrame, Way};
use crate::smooth::box_blur;
use m4_core::{Camera, bilinear, quantile};

/// Spans over which places are compared, each both ways, seconds.
const SPANS_S: [f64; 3] = [1.0 / 24.0, 1.0 / 6.0, 1.0];
/// Distance of the pixels that are judged, pixels at the working size: the flow starts from patches
/// twice as far apart.
const STRIDE_PX: usize = 2;
/// Side of the square of these over which brightness is compared, counted in them.
const PATCH: usize = 3;
/// Noise of the flow after a second, one standard deviation, pixels at the working size: its
/// variance grows with time, in however many steps. And that of every step, a share of its length.
const FLOW_NOISE_PX: f32 = 0.5;
const FLOW_NOISE_SHARE: f32 = 0.05;
/// Speed of dynamic pixels, one standard deviation, image widths per second.
const SPEED: f32 = 0.1;
/// Logarithm of a ratio of likelihoods that is certain.
const CERTAIN: f32 = 4.0;
/// By how much more the static place must differ from a pixel than the place that the flow leads
/// to, to be refuted: this brightness (0..255, mean of a patch), and this share of the difference
/// of the latter.
const BRIGHTNESS_NOISE: f32 = 1.0;
const BRIGHTNESS_SHARE: f32 = 0.3;
/// Darkest shadow, as a share of the light, and the cost of one that leaves 1/e of it, 0..255.
const DARKEST: f32 = 0.3;
const SHADOW_COST: f32 = 0.6;
/// Least weight of flow that the brightness does not confirm, 0..1: on a flat wall flow is a guess.
const LEAST_REFUTED: f32 = 0.1;
/// Most that a place counts, in variances: flow that fails is as far off as it likes.
const MOST_OFF: f32 = 60.0;

/// A clip and the static disparity of one frame.
pub(super) struct Trajectories<'a> {
    pub shots: &'a [Shot],
    /// At the working size.
    pub cameras: &'a [Camera],
    pub flows: &'a [FlowPair],
    pub rate: FrameRate,
    /// `[height][width]`: as if all pixels were static.
    pub disparity: &'a [f32],
    /// `[height][width]`: one standard deviation.
    pub deviation: &'a [f32],
}

/// What the places of a pixel say.
#[derive(Debug, Clone, Copy)]
pub(super) struct Verdict {
    /// From -1 for certainly static to 1 for certainly dynamic.
    pub dynamic: f32,
    /// Number of places, each weighted by how little the flow to it varies, 0..1, times the pixels
    /// that it stands for.
    pub weight: f32,
}

/// Sums over the places of a pixel, each weighted by its precision; times are seconds from the
/// frame, negative before it.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    /// Squared residuals at the estimated disparity.
    square: f32,
    /// Squared derivatives of the place by the disparity, and residuals times these.
    slope: f32,
    slope_residual: f32,
    /// Squared times, and residuals and derivatives times these.
    time: f32,
    time_residual: [f32; 2],
    time_slope: [f32; 2],
    /// Number of places, and the same with weights (see [`Verdict::weight`]).
    count: f32,
    weight: f32,
}

impl Sums {
    /// Adds a place to all but the weight; its residual in pixels, its derivative in pixels per
    /// disparity, its precision in one over pixels squared.
    fn add(&mut self, [x, y]: [f32; 2], [sx, sy]: [f32; 2], time_s: f32, precision: f32) {
        self.square += (x * x + y * y) * precision;
        self.slope += (sx * sx + sy * sy) * precision;
        self.slope_residual += (sx * x + sy * y) * precision;
        let time = time_s * precision;
        self.time += time_s * time;
        self.time_residual = [
            self.time_residual[0] + time * x,
            self.time_residual[1] + time * y,
        ];
        self.time_slope = [
            self.time_slope[0] + time * sx,
            self.time_slope[1] + time * sy,
        ];
        self.count += 1.0;
    }

    fn joined(&self, other: &Self) -> Self {
        let both = |a: [f32; 2], b: [f32; 2]| [a[0] + b[0], a[1] + b[1]];
        Self {
            square: self.square + other.square,
            slope: self.slope + other.slope,
            slope_residual: self.slope_residual + other.slope_residual,
            time: self.time + other.time,
            time_residual: both(self.time_residual, other.time_residual),
            time_slope: both(self.time_slope, other.time_slope),
            count: self.count + other.count,
            weight: self.weight + other.weight,
        }
    }

    /// Logarithm of how much more likely a dynamic point is than a static one, the disparity of
    /// both having this variance.
    ///
    /// A dynamic point has an even velocity (the ratio of evidences of two linear models), or it is
    /// anywhere: what is left of the residuals beyond the noise. `speed` is in pixels per second.
    fn ratio(&self, variance: f32, speed: f32) -> f32 {
        let fit = variance / (1.0 + variance * self.slope);
        let left = self.square - self.slope_residual * self.slope_residual * fit;
        let [tx, ty] = self.time_slope;
        let [gx, gy] = [0, 1].map(|axis| {
            self.time_residual[axis] - self.time_slope[axis] * self.slope_residual * fit
        });
        let prior = 1.0 / (speed * speed);
        let [a, b, c] = [
            self.time - tx * tx * fit + prior,
            -tx * ty * fit,
            self.time - ty * ty * fit + prior,
        ];
        let determinant = (a * c - b * b).max(prior * prior);
        let explained = (c * gx * gx - 2.0 * b * gx * gy + a * gy * gy) / determinant;
        0.5 * (explained.max(left - 2.0 * self.count) - (determinant / (prior * prior)).ln())
    }

    fn verdict(before: &Self, after: &Self, deviation: f32, speed: f32) -> Verdict {
        let both = before.joined(after);
        let mut ratio = both
            .ratio(deviation * deviation, speed)
            .clamp(-CERTAIN, CERTAIN);
        if ratio > 0.0 {
            // what an object covers or uncovers is static before or after
            let one = before.ratio(0.0, speed).min(after.ratio(0.0, speed));
            ratio = (ratio + one.min(0.0)).max(-CERTAIN);
        }
        Verdict {
            dynamic: ratio / CERTAIN,
            weight: (STRIDE_PX * STRIDE_PX) as f32 * both.weight,
        }
    }
}

impl Trajectories<'_> {
    /// Pixels of frame `i`, spread evenly, and the verdicts on them.
    pub fn verdicts(&self, i: usize) -> Vec<(usize, Verdict)> {
        let frame = &self.shots[i].frame;
        let speed = SPEED * frame.width as f32;
        let grid = Grid::of(frame);
        let [before, after] = [false, true].map(|later| self.sums(i, &grid, later));
        let sums = before.iter().zip(&after).zip(&grid.pixels);
        sums.map(|((before, after), p)| {
            (*p, Sums::verdict(before, after, self.deviation[*p], speed))
        })
        .collect()
    }

    /// Sums over the places in the frames after or before frame `i`, one per pixel of the grid.
    fn sums(&self, i: usize, grid: &Grid, later: bool) -> Vec<Sums> {
        let mut sums = vec![Sums::default(); grid.pixels.len()];
        let spans = self.rate.distances(&SPANS_S);
        let mut places = grid.places();
        let noise = FLOW_NOISE_PX * FLOW_NOISE_PX * self.rate.seconds(1) as f32;
        for k in 1..=spans.last().copied().unwrap_or_default() {
            let Some(from) = (if later {
                Some(i + k - 1)
            } else {
                (i + 1).checked_sub(k)
            }) else {
                break;
            };
            let Some(way) = FlowPair::step(self.flows, from, later) else {
                break;
            };
            places
                .iter_mut()
                .for_each(|place| place.advance(way, noise));
            if spans.contains(&k) {
                self.add_places(
                    i,
                    if later { i + k } else { i - k },
                    grid,
                    &places,
                    &mut sums,
                );
            }
        }
        sums
    }

    /// Adds the places in frame `j` that the pixels of frame `i` were followed to.
    fn add_places(&self, i: usize, j: usize, grid: &Grid, places: &[Place], sums: &mut [Sums]) {
        let target = &self.shots[j].frame;
        let pair = Pair::new(&self.cameras[i], &self.cameras[j]);
        let fixed: Vec<(Reprojected, [f32; 2])> = grid
            .pixels
            .iter()
            .map(|&p| {
                pair.project_with_slope(
                    (p % target.width) as f32,
                    (p / target.width) as f32,
                    self.disparity[p],
                )
            })
            .collect();
        let static_difference = grid.difference(target, fixed.iter().map(|(at, _)| [at.x, at.y]));
        let flow_difference =
            grid.difference(target, places.iter().map(|place| [place.x, place.y]));
        let residual = |(place, (at, _)): (&Place, &(Reprojected, [f32; 2]))| {
            let is_known = place.variance.is_finite() && at.disparity > 0.0;
            is_known.then_some([place.x - at.x, place.y - at.y])
        };
        // most of a frame is static, so what half of it exceeds is an error of the cameras
        let residuals: Vec<Option<[f32; 2]>> = places.iter().zip(&fixed).map(residual).collect();
        let mut squares: Vec<f32> = residuals
            .iter()
            .flatten()
            .map(|[x, y]| x * x + y * y)
            .collect();
        let camera_variance = quantile(&mut squares, 0.5).unwrap_or(0.0);
        let time_s = self.rate.seconds(i.abs_diff(j)) as f32 * if j < i { -1.0 } else { 1.0 };
        for (p, sums) in sums.iter_mut().enumerate() {
            let Some(residual) = residuals[p] else {
                continue;
            };
            let variance = places[p].variance;
            let by_flow = flow_difference[p];
            let refuted =
                (static_difference[p] - by_flow) / (BRIGHTNESS_NOISE + BRIGHTNESS_SHARE * by_flow);
            let refuted = refuted.clamp(LEAST_REFUTED, 1.0);
            let precision = refuted / (variance + camera_variance);
            let square = (residual[0] * residual[0] + residual[1] * residual[1]) * precision;
            let share = (MOST_OFF * refuted * refuted / square).sqrt().min(1.0);
            sums.add(residual.map(|r| share * r), fixed[p].1, time_s, precision);
            sums.weight += 1.0 / (1.0 + variance);
        }
    }
}

/// Where the flow has led a pixel.
#[derive(Clone, Copy)]
struct Place {
    x: f32,
    y: f32,
    /// Pixels squared, per axis; infinite once the flow has left the image.
    variance: f32,
}

impl Place {
    /// Follows one more step, whose error is independent of those before; `noise` is the variance
    /// that every step has, pixels squared.
    fn advance(&mut self, way: Way<'_>, noise: f32) {
        if self.variance.is_infinite() {
            return;
        }
        let flow = way.flow;
        let missed = way.round_trip_px(nearest_pixel(flow.width, flow.height, self.x, self.y));
        let (u, v) = flow.at(self.x, self.y);
        let noise = noise + FLOW_NOISE_SHARE * FLOW_NOISE_SHARE * (u * u + v * v);
        *self = Self {
            x: self.x + u,
            y: self.y + v,
            variance: self.variance + noise + 0.25 * missed * missed,
        };
    }
}

/// Pixels of a frame, [`STRIDE_PX`] apart.
struct Grid {
    /// Of the frame.
    width: usize,
    columns: usize,
    rows: usize,
    /// Indices in the frame, `[rows][columns]`.
    pixels: Vec<usize>,
    /// Brightness, 0..255, and its mean over a patch.
    grey: Vec<f32>,
    mean: Vec<f32>,
}

impl Grid {
    fn of(frame: &ScaledFrame) -> Self {
        let (columns, rows) = (
            frame.width.div_ceil(STRIDE_PX),
            frame.height.div_ceil(STRIDE_PX),
        );
        let pixel = |g: usize| g / columns * STRIDE_PX * frame.width + g % columns * STRIDE_PX;
        let pixels: Vec<usize> = (0..columns * rows).map(pixel).collect();
        let grey: Vec<f32> = pixels.iter().map(|p| frame.grey[*p]).collect();
        let mut grid = Self {
            columns,
            rows,
            pixels,
            width: frame.width,
            mean: grey.clone(),
            grey,
        };
        box_blur::<PATCH>(columns, rows, &mut grid.mean);
        grid
    }

    /// The pixels themselves.
    fn places(&self) -> Vec<Place> {
        let place = |p: &usize| Place {
            x: (p % self.width) as f32,
            y: (p / self.width) as f32,
            variance: 0.0,
        };
        self.pixels.iter().map(place).collect()
    }

    /// How much places in another frame differ in brightness from the pixels here, 0..255; a shadow
    /// on one of them is all but free.
    fn difference(&self, target: &ScaledFrame, places: impl Iterator<Item = [f32; 2]>) -> Vec<f32> {
        let blurred = |mut values: Vec<f32>| {
            box_blur::<PATCH>(self.columns, self.rows, &mut values);
            values
        };
        let other: Vec<f32> = places
            .map(|[x, y]| bilinear(target.width, target.height, &target.grey, x, y))
            .collect();
        let means = self.mean.iter().zip(blurred(other.clone()));
        let light: Vec<f32> = means
            .map(|(a, b)| ((a + 1.0) / (b + 1.0)).clamp(DARKEST, 1.0 / DARKEST))
            .collect();
        let pixels = || self.grey.iter().zip(&other).zip(&light);
        let plain = blurred(pixels().map(|((a, b), _)| (a - b).abs()).collect());
        // at the light of the darker one, so that noise counts alike
        let shadow = blurred(
            pixels()
                .map(|((a, b), light)| (a - light * b).abs() / light.max(1.0))
                .collect(),
        );
        let shadow = shadow
            .iter()
            .zip(&light)
            .map(|(shadow, light)| shadow + SHADOW_COST * light.ln().abs());
        plain
            .iter()
            .zip(shadow)
            .map(|(plain, shadow)| plain.min(shadow))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::{FlowPair, FrameRate, Shot, Trajectories};
    use m4_core::Flow;

    const W: usize = 64;
    const H: usize = 48;
    const FRAMES: usize = 49;
    const MIDDLE: usize = 24;

    /// A clip of a wall, at disparity 1, in front of which a square moves down by `speed` pixels a
    /// frame; it stays in its column, as a static point at disparity 0 does. Returns verdicts on
    /// pixels of the frame in the middle and which of all pixels are of the square.
    fn verdicts(speed: f32, rate: f64) -> (Vec<(usize, f32)>, Vec<bool>) {
        let inside = |t: usize, p: usize| {
            let top = 14.0 + speed * (t as f32 - MIDDLE as f32);
            let (x, y) = (p % W, (p / W) as f32);
            (24..40).contains(&x) && y >= top && y < top + 16.0
        };
        let (mut shots, cameras) = Shot::of_wall(FRAMES, (W, H), 1.0);
        for (t, shot) in shots.iter_mut().enumerate() {
            for p in (0..W * H).filter(|&p| inside(t, p)) {
                let (x, y) = ((p % W) as f32, (p / W) as f32 - speed * t as f32);
                shot.frame.grey[p] =
                    120.0 + 60.0 * (1.3 * x).sin() + 50.0 * (0.9 * y + 0.4 * x).cos();
            }
        }
        let flow = |t: usize, sign: f32| {
            let along = |p: usize| {
                if inside(t, p) {
                    (0.0, sign * speed)
                } else {
                    (-sign, 0.0)
                }
            };
            let (u, v) = (0..W * H).map(along).unzip();
            Flow {
                width: W,
                height: H,
                u,
                v,
            }
        };
        let flows: Vec<FlowPair> = (0..FRAMES - 1)
            .map(|t| FlowPair {
                forward: flow(t, 1.0),
                backward: flow(t + 1, -1.0),
            })
            .collect();
        let square: Vec<bool> = (0..W * H).map(|p| inside(MIDDLE, p)).collect();
        let disparity: Vec<f32> = square
            .iter()
            .map(|inside| if *inside { 0.1 } else { 1.0 })
            .collect();
        let deviation: Vec<f32> = square
            .iter()
            .map(|inside| if *inside { 0.3 } else { 0.02 })
            .collect();
        let rate = FrameRate::new(rate).unwrap();
        let clip = Trajectories {
            shots: &shots,
            cameras: &cameras,
            flows: &flows,
            rate,
            disparity: &disparity,
            deviation: &deviation,
        };
        (
            clip.verdicts(MIDDLE)
                .iter()
                .map(|(p, verdict)| (*p, verdict.dynamic))
                .collect(),
            square,
        )
    }

    /// Mean verdict on the pixels of the square and on those of the wall, a margin aside.
    fn means((verdicts, square): (Vec<(usize, f32)>, Vec<bool>)) -> (f32, f32) {
        let mean = |wanted: bool| {
            let same = |p: usize| {
                (-2..=2).all(|k: isize| {
                    [k, k * W as isize]
                        .iter()
                        .all(|off| square.get((p as isize + off) as usize) == Some(&wanted))
                })
            };
            let all: Vec<f32> = verdicts
                .iter()
                .filter(|(p, _)| same(*p))
                .map(|(_, verdict)| *verdict)
                .collect();
            assert!(all.len() > 25, "{}", all.len());
            all.iter().sum::<f32>() / all.len() as f32
        };
        (mean(true), mean(false))
    }

    #[test]
    fn slow_motion_shows_over_long_spans() {
        let (square, wall) = means(verdicts(0.25, 24.0));
        assert!(square > 0.8 && wall < -0.5, "{square} {wall}");
        // the same images, whose longest span is a second again: two frames instead of 24
        let (square, _) = means(verdicts(0.05, 24.0));
        let (short, _) = means(verdicts(0.05, 2.0));
        assert!(square > 0.5 && short < 0.0, "{square} {short}");
    }

    #[test]
    fn motion_like_that_of_another_disparity_is_none() {
        let (square, wall) = means(verdicts(0.0, 24.0));
        assert!(square < 0.0 && wall < -0.5, "{square} {wall}");
    }

    #[test]
    fn what_the_square_will_cover_is_static() {
        let (verdicts, square) = verdicts(0.5, 24.0);
        let below = |p: usize| {
            !square[p]
                && (2..12).any(|rows| p >= rows * W && square[p - rows * W])
                && !square[p - W]
        };
        let all: Vec<f32> = verdicts
            .iter()
            .filter(|(p, _)| *p >= W && below(*p))
            .map(|(_, v)| *v)
            .collect();
        let dynamic = all.iter().filter(|v| **v > 0.0).count() as f32 / all.len() as f32;
        assert!(all.len() > 25 && dynamic < 0.1, "{} {dynamic}", all.len());
    }
}
