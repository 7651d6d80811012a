//! Depth at its steps: which of two surfaces a pixel shows.
//!
//! Windows of the sweep and of the refinement mix the two sides of a step, so measured outlines are
//! off by a few pixels. Around a step, both surfaces go on as planes under the pixels in doubt;
//! each of these belongs to the surface on which other frames show its colour, in agreement with
//! the pixels of like colours around it.

use super::shot::{Pair, Shot};
use super::static_depth::Measured;
use super::working::pixel_at;
use crate::flow::bilinear_rgb;
use crate::smooth::Smoother;
use fearless_simd::Level;
use m4_core::{Camera, dispatch};

/// Parallax of the frames whose colours are compared, pixels at the working size.
pub(super) const PARALLAX_PX: [f64; 3] = [12.0, 24.0, 48.0];
/// Surfaces that differ by less than this are one, steps of the sweep.
const STEP: f32 = 2.0;
/// Pixels with another surface within this distance are in doubt, pixels at the working size.
const DOUBT_PX: usize = 4;
/// Half the side of the window that is searched for two surfaces, pixels.
const WINDOW_PX: usize = 7;
/// How far from the nearer surface the farther one is read, since the nearer reaches over it,
/// pixels.
const HALO_PX: usize = 3;
/// How far from the farther surface the nearer one is read, pixels.
const RIM_PX: usize = 1;
/// Half the side of the window to which planes are fitted, pixels.
const FIT_PX: usize = 9;
/// Every n-th row and column of it counts.
const FIT_STRIDE: usize = 2;
/// Square of the distance at which a pixel counts half in the fit, pixels squared.
const FIT_NEAR_PX2: f32 = 4.0;
/// Least weight of the pixels of a plane: two at 6 px.
const FIT_LEAST: f32 = 0.05;
/// Spread of the pixels of a plane below which its slope shrinks to 0, pixels squared.
const FIT_SPREAD_PX2: f32 = 2.0;
/// Largest difference of colours that counts, 0..255; as evidence, it is 1.
const MOST_DIFFERENCE: f32 = 30.0;
/// Evidence of the depth measured before.
const PRIOR: f32 = 0.5;
/// Strength of the edge-aware average of the evidence, pixels squared (Min et al. 2014, lambda).
const SMOOTH_LAMBDA: f32 = 8.0;

/// Static depth of a clip, merged over its frames; lists are by frame, planes `[height][width]` at
/// the working size.
pub(super) struct Merged<'a> {
    pub shots: &'a [Shot],
    pub cameras: &'a [Camera],
    pub depth: &'a [Measured],
    /// Above 0 in dynamic regions, which are left as they are.
    pub dynamic: &'a [Vec<u8>],
}

/// Disparities of the two surfaces at a pixel in doubt.
#[derive(Clone, Copy)]
struct Surfaces {
    near: f32,
    far: f32,
}

impl Merged<'_> {
    /// The depth of frame `i` whose pixels next to steps belong to one surface or the other, by the
    /// colours of `others`. What was not measured stays so.
    pub fn assigned(&self, i: usize, others: &[usize], smoother: &Smoother) -> Measured {
        let mut out = self.depth[i].clone();
        let known_pixels = self.known_pixels(i);
        let views: Vec<(usize, Pair)> = others
            .iter()
            .map(|&j| (j, Pair::new(&self.cameras[i], &self.cameras[j])))
            .collect();
        let steps = Steps::of(&self.shots[i], &out.disparity, &known_pixels);
        let (mut evidence, mut weight) = (
            vec![0.0f32; known_pixels.len()],
            vec![0.0f32; known_pixels.len()],
        );
        let mut doubtful = Vec::new();
        for p in (0..known_pixels.len()).filter(|p| known_pixels[*p]) {
            let Some(middle) = steps.middle(p) else {
                continue;
            };
            if !steps.in_doubt(p, middle) {
                evidence[p] = if out.disparity[p] > middle { 1.0 } else { -1.0 };
            } else if let Some(surfaces) = steps.surfaces(p, middle) {
                evidence[p] = self.evidence(i, p, surfaces, &views);
                doubtful.push((p, surfaces));
            } else {
                continue;
            }
            weight[p] = 1.0;
        }
        let (evidence, _) = smoother.fill(&evidence, &weight, SMOOTH_LAMBDA);
        for (p, surfaces) in doubtful {
            let near = evidence[p] > 0.0;
            if near != surfaces.is_near(out.disparity[p]) {
                out.disparity[p] = if near { surfaces.near } else { surfaces.far };
            }
        }
        out
    }

    /// Which pixels of frame `i` are static and measured.
    fn known_pixels(&self, i: usize) -> Vec<bool> {
        self.depth[i]
            .confidence
            .iter()
            .zip(&self.dynamic[i])
            .map(|(c, dynamic)| *c > 0.0 && *dynamic == 0)
            .collect()
    }

    /// Above 0 for the nearer surface: by how much its colour fits better, and which one was
    /// measured.
    fn evidence(&self, i: usize, p: usize, surfaces: Surfaces, views: &[(usize, Pair)]) -> f32 {
        let measured = if surfaces.is_near(self.depth[i].disparity[p]) {
            PRIOR
        } else {
            -PRIOR
        };
        let difference = |disparity| self.colour_difference(i, p, disparity, views);
        let differences = difference(surfaces.near).zip(difference(surfaces.far));
        measured + differences.map_or(0.0, |(near, far)| (far - near) / MOST_DIFFERENCE)
    }

    /// Mean difference to the colours that `views` show on pixel `p` of frame `i` at a disparity,
    /// 0..255; `None` where nothing but other surfaces is seen.
    fn colour_difference(
        &self,
        i: usize,
        p: usize,
        disparity: f32,
        views: &[(usize, Pair)],
    ) -> Option<f32> {
        let frame = &self.shots[i].frame;
        let (w, h) = (frame.width, frame.height);
        let (mut sum, mut count) = (0.0, 0);
        for (j, pair) in views {
            let target = pair.project((p % w) as f32, (p / w) as f32, disparity);
            let Some(q) = pixel_at(w, h, target.x, target.y).filter(|_| target.disparity > 0.0)
            else {
                continue;
            };
            let nearer = target.disparity + STEP * self.shots[*j].range.step;
            let hidden = self.depth[*j].confidence[q] > 0.0 && self.depth[*j].disparity[q] > nearer;
            if hidden || self.dynamic[*j][q] > 0 {
                continue;
            }
            let theirs = bilinear_rgb(w, h, &self.shots[*j].frame.rgb, target.x, target.y);
            let difference: f32 = theirs
                .iter()
                .zip(frame.rgb[p])
                .map(|(a, b)| (a - f32::from(b)).abs())
                .sum();
            sum += (difference / 3.0).min(MOST_DIFFERENCE);
            count += 1;
        }
        (count > 0).then(|| sum / count as f32)
    }
}

impl Surfaces {
    /// Whether a disparity is closer to the nearer surface.
    fn is_near(self, disparity: f32) -> bool {
        (disparity - self.near).abs() < (disparity - self.far).abs()
    }
}

/// Where the depth of a frame has steps, and what lies on both sides.
struct Steps<'a> {
    size: (usize, usize),
    disparity: &'a [f32],
    known_pixels: &'a [bool],
    /// Least difference of two surfaces.
    least: f32,
    /// Least and largest known disparity within [`WINDOW_PX`] and within [`DOUBT_PX`]; infinite
    /// where nothing is known.
    window: [Vec<f32>; 2],
    doubt: [Vec<f32>; 2],
    /// Least within [`RIM_PX`], largest within [`HALO_PX`].
    rim: Vec<f32>,
    halo: Vec<f32>,
}

impl<'a> Steps<'a> {
    fn of(shot: &Shot, disparity: &'a [f32], known_pixels: &'a [bool]) -> Self {
        let size = (shot.frame.width, shot.frame.height);
        let or = |unknown: f32| -> Vec<f32> {
            disparity
                .iter()
                .zip(known_pixels)
                .map(|(d, is_known)| if *is_known { *d } else { unknown })
                .collect()
        };
        let (low, high) = (or(f32::INFINITY), or(f32::NEG_INFINITY));
        let least = |of: &[f32], reach| around(size, of, reach, |a, b| if a < b { a } else { b });
        let largest = |of: &[f32], reach| around(size, of, reach, |a, b| if a > b { a } else { b });
        let (rim, halo) = (least(&low, RIM_PX), largest(&high, HALO_PX));
        let doubt = [
            least(&rim, DOUBT_PX - RIM_PX),
            largest(&halo, DOUBT_PX - HALO_PX),
        ];
        let wider = WINDOW_PX - DOUBT_PX;
        let window = [least(&doubt[0], wider), largest(&doubt[1], wider)];
        Self {
            size,
            disparity,
            known_pixels,
            least: STEP * shot.range.step,
            window,
            doubt,
            rim,
            halo,
        }
    }

    /// The disparity between the two surfaces around a known pixel; `None` where there is no step.
    fn middle(&self, p: usize) -> Option<f32> {
        let [least, largest] = [self.window[0][p], self.window[1][p]];
        (largest - least > self.least).then_some(0.5 * (least + largest))
    }

    /// Whether both sides of the `middle` are close to a known pixel.
    fn in_doubt(&self, p: usize, middle: f32) -> bool {
        self.doubt[0][p] < middle && self.doubt[1][p] > middle
    }

    /// The planes of both sides of the `middle` at a pixel; `None` where one of them is not seen
    /// well enough or they are one (a slanted surface).
    fn surfaces(&self, p: usize, middle: f32) -> Option<Surfaces> {
        let (w, h) = self.size;
        let (x, y) = (p % w, p / w);
        let (mut near, mut far) = (Plane::default(), Plane::default());
        for v in (y.saturating_sub(FIT_PX)..(y + FIT_PX + 1).min(h)).step_by(FIT_STRIDE) {
            for u in (x.saturating_sub(FIT_PX)..(x + FIT_PX + 1).min(w)).step_by(FIT_STRIDE) {
                let q = v * w + u;
                if !self.known_pixels[q] {
                    continue;
                }
                let at = [u as f32 - x as f32, v as f32 - y as f32];
                if self.rim[q] > middle {
                    near.add(at, self.disparity[q]);
                } else if self.halo[q] < middle {
                    far.add(at, self.disparity[q]);
                }
            }
        }
        let (near, far) = near.at_origin().zip(far.at_origin())?;
        (far > 0.0 && near - far > self.least).then_some(Surfaces { near, far })
    }
}

/// Extremes of `values` in squares of `2 reach + 1` pixels, by `of` the minimum or the maximum: one
/// pixel wider at a time.
fn around(
    size: (usize, usize),
    values: &[f32],
    reach: usize,
    of: impl Fn(f32, f32) -> f32,
) -> Vec<f32> {
    dispatch!(Level::new(), _s => extremes(size, values, reach, &of))
}

#[inline(always)]
fn extremes(
    (w, h): (usize, usize),
    values: &[f32],
    reach: usize,
    of: &impl Fn(f32, f32) -> f32,
) -> Vec<f32> {
    let mut out = values.to_vec();
    let mut rows = out.clone();
    for _ in 0..reach {
        for (row, wider) in out.chunks_exact(w).zip(rows.chunks_exact_mut(w)) {
            wider.copy_from_slice(row);
            wider[1..]
                .iter_mut()
                .zip(row)
                .for_each(|(wider, left)| *wider = of(*wider, *left));
            wider
                .iter_mut()
                .zip(&row[1..])
                .for_each(|(wider, right)| *wider = of(*wider, *right));
        }
        out.copy_from_slice(&rows);
        let below = (h - 1) * w;
        out[w..]
            .iter_mut()
            .zip(&rows[..below])
            .for_each(|(wider, above)| *wider = of(*wider, *above));
        out[..below]
            .iter_mut()
            .zip(&rows[w..])
            .for_each(|(wider, below)| *wider = of(*wider, *below));
    }
    out
}

/// Least squares of `1 + x + y`, near the origin above all: weights and weighted sums of x, y, the
/// value and their products.
#[derive(Default)]
struct Plane([f32; 9]);

impl Plane {
    fn add(&mut self, [x, y]: [f32; 2], value: f32) {
        let weight = 1.0 / (FIT_NEAR_PX2 + x * x + y * y);
        let moments = [1.0, x, y, value, x * x, x * y, y * y, x * value, y * value];
        self.0
            .iter_mut()
            .zip(moments)
            .for_each(|(sum, moment)| *sum += weight * moment);
    }

    /// Its value at the origin; `None` of too few values.
    fn at_origin(&self) -> Option<f32> {
        let total = self.0[0];
        let [_, x, y, value, xx, xy, yy, xv, yv] = self.0.map(|sum| sum / total);
        let (vx, vy, cross) = (
            xx - x * x + FIT_SPREAD_PX2,
            yy - y * y + FIT_SPREAD_PX2,
            xy - x * y,
        );
        let (cx, cy) = (xv - x * value, yv - y * value);
        let slope = |a: f32, b: f32, v: f32| (a * v - b * cross) / (vx * vy - cross * cross);
        (total >= FIT_LEAST).then(|| value - slope(cx, cy, vy) * x - slope(cy, cx, vx) * y)
    }
}

#[cfg(test)]
mod tests {
    use super::{Merged, Plane, Steps, around};
    use crate::classical::dense::shot::Shot;
    use crate::classical::dense::static_depth::Measured;
    use crate::smooth::Smoother;

    const W: usize = 64;
    const H: usize = 24;
    /// Disparities of a wall and of a post before it; cameras go to the right by one unit per
    /// frame, at a focal length of one pixel.
    const FAR: f32 = 1.0;
    const NEAR: f32 = 3.0;

    /// Whether frame `i` shows the post at column `x`, `grown` px wider on both sides.
    fn post(i: usize, x: usize, grown: i32) -> bool {
        let left = 30 - 3 * (i as i32 - 3);
        (left - grown..left + 10 + grown).contains(&(x as i32))
    }

    /// Colours of the wall or of the post: textures whose values both take.
    fn colour(i: usize, x: usize, y: usize) -> [u8; 3] {
        let (disparity, tint) = if post(i, x, 0) {
            (NEAR, 2.0)
        } else {
            (FAR, 0.5)
        };
        let along = x as f32 + disparity * i as f32;
        let value =
            |c: usize| 120.0 + 60.0 * (0.8 * along + 0.5 * y as f32 + tint * c as f32).sin();
        std::array::from_fn(|c| value(c) as u8)
    }

    /// The depth of frame 3, given depth maps whose post is `grown` px too wide on both sides.
    fn assigned(grown: i32, unknown: impl Fn(usize) -> bool) -> Measured {
        let (mut shots, cameras) = Shot::of_wall(7, (W, H), 2.0);
        for (i, shot) in shots.iter_mut().enumerate() {
            shot.frame.rgb = (0..W * H).map(|p| colour(i, p % W, p / W)).collect();
        }
        let depth = |i: usize| Measured {
            disparity: (0..W * H)
                .map(|p| if post(i, p % W, grown) { NEAR } else { FAR })
                .collect(),
            confidence: (0..W * H)
                .map(|p| if unknown(p % W) { 0.0 } else { 1.0 })
                .collect(),
        };
        let depth: Vec<Measured> = (0..7).map(depth).collect();
        let dynamic = vec![vec![0u8; W * H]; 7];
        let clip = Merged {
            shots: &shots,
            cameras: &cameras,
            depth: &depth,
            dynamic: &dynamic,
        };
        let smoother = Smoother::new(W, H, &shots[3].frame.rgb, 8.0);
        clip.assigned(3, &[0, 1, 5, 6], &smoother)
    }

    #[test]
    fn outlines_that_are_too_wide_or_too_narrow_go_to_the_edge() {
        for grown in [-2, 0, 2] {
            let actual = assigned(grown, |_| false);
            let wrong = actual
                .disparity
                .iter()
                .enumerate()
                .filter(|(p, disparity)| {
                    let truth = if post(3, p % W, 0) { NEAR } else { FAR };
                    (*disparity - truth).abs() > 0.01
                });
            // of four columns, none where the depth was right
            let (wrong, before) = (wrong.count(), 2 * H * grown.unsigned_abs() as usize);
            assert!(
                10 * wrong <= before,
                "{wrong} pixels of {before} are wrong, {grown} px wider"
            );
        }
    }

    #[test]
    fn what_was_not_measured_stays_unknown() {
        let Measured {
            disparity,
            confidence,
        } = assigned(2, |x| (28..30).contains(&x));
        // on the wall, but of the post by the depth before
        assert_eq!((disparity[28], disparity[29]), (NEAR, NEAR));
        assert_eq!(
            (
                confidence[27],
                confidence[28],
                confidence[29],
                confidence[30]
            ),
            (1.0, 0.0, 0.0, 1.0)
        );
    }

    #[test]
    fn slanted_surfaces_have_no_steps() {
        let (shots, cameras) = Shot::of_wall(3, (W, H), 2.0);
        let slanted: Vec<f32> = (0..W * H).map(|p| 1.0 + 0.03 * (p % W) as f32).collect();
        let depth = vec![
            Measured {
                disparity: slanted.clone(),
                confidence: vec![1.0; W * H]
            };
            3
        ];
        let dynamic = vec![vec![0u8; W * H]; 3];
        let clip = Merged {
            shots: &shots,
            cameras: &cameras,
            depth: &depth,
            dynamic: &dynamic,
        };
        let smoother = Smoother::new(W, H, &shots[1].frame.rgb, 8.0);
        assert!(
            Steps::of(&shots[1], &slanted, &[true; W * H])
                .middle(12 * W + 30)
                .is_some(),
            "the window spans two steps"
        );
        assert!(clip.assigned(1, &[0, 2], &smoother).disparity == slanted);
    }

    #[test]
    fn planes_go_on_beside_their_values() {
        let mut plane = Plane::default();
        (0..60).for_each(|k| {
            let at = [3.0 + (k % 6) as f32, (k / 6) as f32 - 4.0];
            plane.add(at, 5.0 + 0.1 * at[0] - 0.2 * at[1]);
        });
        assert!(
            (plane.at_origin().unwrap() - 5.0).abs() < 0.2,
            "{:?}",
            plane.at_origin()
        );
        assert_eq!(Plane::default().at_origin(), None);
    }

    #[test]
    fn extremes_are_those_of_the_square() {
        let mut values = vec![0.0; 7 * 5];
        values[2 * 7 + 3] = 1.0;
        let actual = around((7, 5), &values, 1, f32::max);
        for (p, value) in actual.iter().enumerate() {
            assert_eq!(
                *value == 1.0,
                (p % 7).abs_diff(3) <= 1 && (p / 7).abs_diff(2) <= 1,
                "pixel {p}"
            );
        }
    }
}
