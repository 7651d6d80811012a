//! Masks against the clean background: what a pixel would show if nothing moved.
//!
//! Cameras and the depth of static regions say where a pixel of the background is seen in other
//! frames. Where those frames agree on a colour and the frame at hand shows another, something
//! stands in front of it; where it shows the same, the mask is too wide. How much another colour
//! must differ depends on how well they agree. Behind an object that stays in place and rotates or
//! swings, masks may cover a pixel in every frame; its background is then the colour that recurs
//! between those of the object.

use super::motion::mask;
use super::shot::{Pair, Shot};
use crate::FrameRate;
use crate::flow::{ScaledFrame, bilinear_rgb};
use crate::smooth::{Smoother, box_blur};
use m4_core::{Camera, dilated, quantile};
use std::array;
use std::ops::RangeInclusive;

/// Distances in time of the frames that a background is made of where there is parallax, each both
/// ways, seconds.
const REACHES_S: [f64; 5] = [0.08, 0.21, 0.38, 0.58, 0.83];
/// Fewest frames that must have seen a pixel of the background.
const LEAST_FRAMES: usize = 2;
/// Frames, spread over the clip, that the background is searched in without parallax or behind what
/// is masked in all near frames.
const SPREAD_FRAMES: usize = 32;
/// Colours of the background differ by at most this, 0..255 (the largest of the channels): noise
/// and compression.
const RECURRENCE_NOISE: f32 = 12.0;
/// Least share of the frames that show the colour that recurs.
const LEAST_RECURRENCE: f32 = 0.35;
/// Least number of times that the colour is shown again after another.
const LEAST_RUNS: usize = 3;
/// Largest share of the other frames whose colour differs by less than twice the noise: the texture
/// of an object that sways changes gradually, occlusions do not.
const MOST_GRADUAL: f32 = 0.2;
/// How far a region may reach beyond its mask, pixels at the working size.
const MARGIN_PX: usize = 6;
/// How far masks are grown before pixels of other frames count as background, pixels.
pub(super) const GUARD_PX: usize = 2;
/// Difference in colour that is as likely motion as not, inside the previous mask: in units of the
/// spread of the other frames.
const STEP: f32 = 4.0;
/// Least and largest such difference, 0..255: the light changes a little everywhere, and no noise
/// is as strong as an object.
const STEP_RANGE: RangeInclusive<f32> = 10.0..=20.0;
/// How much larger it is outside of the previous mask.
const STEP_OUTSIDE: f32 = 1.6;
/// Darkest shadow, as a share of the light.
const LEAST_GAIN: f32 = 0.4;
/// Cost of explaining a difference by a shadow, as a share of the step for full darkness.
const GAIN_COST: f32 = 1.0;
/// Weight of the previous mask; a pixel of the background has 1.
const PRIOR: f32 = 0.3;
/// Strength of the edge-aware smoothing, pixels squared (Min et al. 2014, lambda). It alone
/// averages the evidence: means over windows fill the corners between two parts.
const SMOOTH_LAMBDA: f32 = 40.0;

/// Everything that the plates are made of.
pub(super) struct BackgroundInputs<'a> {
    pub width: usize,
    pub height: usize,
    /// Whether the camera moves from its place.
    pub parallax: bool,
    pub rate: FrameRate,
    pub cameras: &'a [Camera],
    pub shots: &'a [Shot],
    /// `[height][width]` by frame: disparity of static regions, continued behind dynamic ones.
    pub background: &'a [Vec<f32>],
    /// `[height][width]` by frame: above 0 for what may move, generously.
    pub near: &'a [Vec<u8>],
}

/// What a pixel would show if nothing moved, 0..255.
#[derive(Clone, Copy)]
struct Background {
    colour: [f32; 3],
    /// Half of the frames that it was seen in differ from it by more.
    spread: f32,
}

/// The background of every pixel of `zone` (above 0), `[height][width]`; `None` where too few
/// frames saw it.
fn backgrounds(scene: &BackgroundInputs<'_>, i: usize, zone: &[u8]) -> Vec<Option<Background>> {
    let w = scene.width;
    let count = scene.cameras.len();
    let pairs = |frames: Vec<usize>| -> Vec<(usize, Pair)> {
        let pair = |j: usize| (j, Pair::new(&scene.cameras[i], &scene.cameras[j]));
        frames.into_iter().map(pair).collect()
    };
    let spread = SPREAD_FRAMES.min(count);
    let all = pairs((0..spread).map(|k| k * count / spread).collect());
    let reaches = scene.rate.distances(&REACHES_S);
    let near = reaches.iter().flat_map(|reach| {
        [
            i.checked_sub(*reach),
            Some(i + reach).filter(|&j| j < count),
        ]
    });
    // errors of depth grow with the parallax; without it, an object that rests for a while is not
    // the background of the whole clip
    let near = if scene.parallax {
        pairs(near.flatten().collect())
    } else {
        all.clone()
    };
    let mut colours: Vec<[f32; 3]> = Vec::new();
    (0..zone.len())
        .map(|p| {
            if zone[p] == 0 {
                return None;
            }
            let disparity = scene.background[i][p];
            let shown = |(j, pair): &(usize, Pair), masked: bool| {
                let at = pair.project((p % w) as f32, (p / w) as f32, disparity);
                scene
                    .colour(*j, at.x, at.y, masked)
                    .filter(|_| at.disparity > 0.0)
            };
            for frames in [&near, &all] {
                colours.clear();
                colours.extend(frames.iter().filter_map(|pair| shown(pair, false)));
                if colours.len() >= LEAST_FRAMES {
                    return Some(agreed(colours.iter()));
                }
            }
            colours.clear();
            colours.extend(all.iter().filter_map(|pair| shown(pair, true)));
            recurring(&colours)
        })
        .collect()
}

impl BackgroundInputs<'_> {
    /// The colour of frame `j` at a place, pixels; `None` outside of the image and, unless `masked`
    /// pixels count, where something may move.
    fn colour(&self, j: usize, x: f32, y: f32, masked: bool) -> Option<[f32; 3]> {
        let (w, h) = (self.width, self.height);
        let inside = x >= 0.0 && y >= 0.0 && x < (w - 1) as f32 && y < (h - 1) as f32;
        let free = || masked || self.near[j][(y + 0.5) as usize * w + (x + 0.5) as usize] == 0;
        (inside && free()).then(|| bilinear_rgb(w, h, &self.shots[j].frame.rgb, x, y))
    }
}

/// The colour that recurs between others among `colours`, which are in order of time; `None` if
/// there is none.
fn recurring(colours: &[[f32; 3]]) -> Option<Background> {
    let within =
        |of: &[f32; 3], most: f32| colours.iter().filter(|s| difference(of, s) <= most).count();
    let least = (LEAST_RECURRENCE * colours.len() as f32).max(LEAST_RUNS as f32);
    // the first of those that most agree with
    let (count, of) = colours
        .iter()
        .map(|s| (within(s, RECURRENCE_NOISE), s))
        .reduce(|best, other| if other.0 > best.0 { other } else { best })?;
    let shows = |s: &[f32; 3]| difference(of, s) <= RECURRENCE_NOISE;
    let runs = colours
        .chunk_by(|a, b| shows(a) == shows(b))
        .filter(|run| shows(&run[0]))
        .count();
    let gradual = within(of, 2.0 * RECURRENCE_NOISE) - count;
    if (count as f32) < least
        || runs < LEAST_RUNS
        || gradual as f32 > MOST_GRADUAL * (colours.len() - count) as f32
    {
        return None;
    }
    Some(Background {
        spread: RECURRENCE_NOISE,
        ..agreed(colours.iter().filter(|s| shows(s)))
    })
}

/// The background of a pixel: the median of its `colours` in several frames, and their spread.
fn agreed<'a>(colours: impl Iterator<Item = &'a [f32; 3]> + Clone) -> Background {
    let colour = array::from_fn(|c| median(colours.clone().map(|s| s[c])));
    Background {
        colour,
        spread: median(colours.map(|s| difference(s, &colour))),
    }
}

/// The largest of the channels' differences.
fn difference(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.collect();
    quantile(&mut values, 0.5).unwrap_or(0.0)
}

/// Evidence of motion a pixel, above 0 for moving; `None` where no background is known.
fn evidence(
    scene: &BackgroundInputs<'_>,
    i: usize,
    before: &[u8],
    background: &[Option<Background>],
) -> Vec<Option<f32>> {
    let (w, h) = (scene.width, scene.height);
    let frame = &scene.shots[i].frame;
    let around = |of: &dyn Fn(usize, &Background) -> f32| {
        let mut values: Vec<f32> = background
            .iter()
            .enumerate()
            .map(|(p, b)| b.as_ref().map_or(0.0, |b| of(p, b)))
            .collect();
        box_blur::<5>(w, h, &mut values);
        values
    };
    // Shadows keep the pattern of what they fall on: the background may be darker by one factor
    // around a pixel.
    let own_light = around(&|p, _| frame.rgb[p].map(f32::from).iter().sum());
    let background_light = around(&|_, b| b.colour.iter().sum());
    let (spread, count) = (around(&|_, b| b.spread), around(&|_, _| 1.0));
    let pixel = |p: usize| {
        let still = background[p]?.colour;
        let rgb = frame.rgb[p].map(f32::from);
        let step = (STEP * spread[p] / count[p]).clamp(*STEP_RANGE.start(), *STEP_RANGE.end())
            * if before[p] > 0 { 1.0 } else { STEP_OUTSIDE };
        let gain = (own_light[p] / background_light[p].max(1.0)).clamp(LEAST_GAIN, 1.0);
        let shadow = difference(&rgb, &still.map(|c| gain * c)) / step + GAIN_COST * (1.0 - gain);
        Some((difference(&rgb, &still) / step).min(shadow).min(2.0) - 1.0)
    };
    (0..w * h).map(pixel).collect()
}

/// The mask of a frame, from `before` (its mask so far) and the background.
pub(super) fn sharpen(
    scene: &BackgroundInputs<'_>,
    i: usize,
    before: &[u8],
    smoother: &Smoother,
) -> Vec<u8> {
    let (w, h) = (scene.width, scene.height);
    let background = backgrounds(scene, i, &dilated(&scene.near[i], w, h, MARGIN_PX));
    let mut weight = vec![PRIOR; w * h];
    let mut value: Vec<f32> = before
        .iter()
        .map(|&before| if before > 0 { 1.0 } else { -1.0 })
        .collect();
    for ((value, weight), evidence) in
        value
            .iter_mut()
            .zip(&mut weight)
            .zip(evidence(scene, i, before, &background))
    {
        if let Some(evidence) = evidence {
            *value = (evidence + PRIOR * *value) / (1.0 + PRIOR);
            *weight += 1.0;
        }
    }
    let smooth = smoother.fill(&value, &weight, SMOOTH_LAMBDA).0;
    mask(w, h, &smooth)
}

/// Frames the usual colours of a static camera are the median of, spread over the clip.
const SAMPLES: usize = 25;
/// Least noise of a pixel, 0..255.
const NOISE: f32 = 4.0;
/// Difference at which a pixel is as likely dynamic as static, in units of the noise.
const THRESHOLD: f32 = 2.5;
/// Strength of a vote for static against one for dynamic, 0..1.
const STATIC_VOTE: f32 = 0.5;

/// The usual colour of every pixel of a static camera: median over time, channel by channel.
/// `frames` must not be empty.
pub(super) fn median_colours(frames: &[ScaledFrame]) -> Vec<[u8; 3]> {
    let count = SAMPLES.min(frames.len());
    let chosen: Vec<&ScaledFrame> = (0..count)
        .map(|k| &frames[k * frames.len() / count])
        .collect();
    let mut values = vec![0u8; count];
    let mut median = |i: usize, c: usize| {
        for (v, frame) in values.iter_mut().zip(&chosen) {
            *v = frame.rgb[i][c];
        }
        *values.select_nth_unstable(count / 2).1
    };
    (0..frames[0].rgb.len())
        .map(|i| array::from_fn(|c| median(i, c)))
        .collect()
}

/// Evidence of motion a pixel, as that of the flow: the difference to the most similar pixel of the
/// usual colours nearby (a tripod shakes, too) in units of the noise.
pub(super) fn difference_evidence(usual: &[[u8; 3]], frame: &ScaledFrame) -> Vec<f32> {
    let (w, h) = (frame.width, frame.height);
    let difference = |a: [u8; 3], b: [u8; 3]| {
        a.iter()
            .zip(&b)
            .map(|(a, b)| a.abs_diff(*b))
            .fold(0, u8::max)
    };
    let least = |p: usize| {
        let (x, y) = (p % w, p / w);
        let rows = y.saturating_sub(1)..(y + 2).min(h);
        let near = rows.flat_map(|y| &usual[y * w + x.saturating_sub(1)..y * w + (x + 2).min(w)]);
        f32::from(near.fold(u8::MAX, |least, colour| {
            least.min(difference(frame.rgb[p], *colour))
        }))
    };
    let mut out: Vec<f32> = (0..w * h).map(least).collect();
    let noise = NOISE.max(2.0 * median(out.iter().copied()));
    for v in &mut out {
        *v = (0.5 * (*v / noise - THRESHOLD)).clamp(-STATIC_VOTE, 1.0);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{
        BackgroundInputs, ScaledFrame, Shot, Smoother, backgrounds, difference_evidence, dilated,
        evidence, median_colours, recurring, sharpen,
    };
    use crate::FrameRate;
    use m4_core::{
        Camera, Intrinsics, Plane, Se3,
        nalgebra::{Vector3, Vector6},
    };

    const W: usize = 96;
    const H: usize = 72;
    const FRAMES: usize = 24;

    fn pattern(x: f64, y: f64) -> u8 {
        let wave = |k: f64, a: f64| ((x * a.cos() + y * a.sin()) * k).sin();
        (120.0 + 30.0 * wave(9.0, 0.3) + 25.0 * wave(23.0, 1.9) + 20.0 * wave(41.0, 2.7)) as u8
    }

    fn camera(t: usize) -> Camera {
        Camera {
            intrinsics: Intrinsics::centred(W, H, 80.0),
            c2w: Se3::identity().retract(&Vector6::new(0.04 * t as f64, 0.0, 0.0, 0.0, 0.0, 0.0)),
        }
    }

    /// A square in front of a wall at depth 4, which it darkens on the left of itself.
    fn inside(t: usize, x: usize, y: usize) -> bool {
        let left = 20 + 2 * t;
        (left..left + 16).contains(&x) && (25..45).contains(&y)
    }

    fn share(a: &[u8], b: &[u8]) -> f64 {
        let both = a.iter().zip(b).filter(|(a, b)| **a > 0 && **b > 0).count();
        let any = a.iter().zip(b).filter(|(a, b)| **a > 0 || **b > 0).count();
        both as f64 / any as f64
    }

    #[test]
    fn background_recurs_between_the_colours_of_a_rotor_and_texture_that_sways_does_not() {
        let background = [120.0, 90.0, 60.0];
        let noise = |k: usize| [3.0, -4.0, 2.0, 0.0, -2.0][k % 5];
        // two blades of different colours, with the background between them for half of the time
        let rotor: Vec<[f32; 3]> = (0..32)
            .map(|k| match k % 8 {
                0 | 1 => [200.0, 30.0, 30.0],
                4 | 5 => [30.0, 30.0, 200.0],
                _ => background.map(|v| v + noise(k)),
            })
            .collect();
        let actual = recurring(&rotor).unwrap().colour;
        assert!(
            (0..3).all(|c| (actual[c] - background[c]).abs() < 3.0),
            "{actual:?}"
        );
        let sways: Vec<[f32; 3]> = (0..32)
            .map(|k| [100.0 + 40.0 * (0.8 * k as f32).sin(); 3])
            .collect();
        assert!(recurring(&sways).is_none());
        // a flat part of an object that stays in place is never interrupted
        assert!(recurring(&[background; 32]).is_none());
        assert!(recurring(&[]).is_none());
    }

    fn shots(shown: impl Fn(usize, usize, usize) -> [u8; 3]) -> Vec<Shot> {
        (0..FRAMES)
            .map(|t| Shot::of_colours(&Plane::from_fn(W, H, |x, y| shown(t, x, y))))
            .collect()
    }

    /// What the wall shows.
    fn wall(cameras: &[Camera], t: usize, x: usize, y: usize) -> u8 {
        let at: Vector3<f64> = cameras[t].unproject(x as f64, y as f64, 4.0);
        pattern(at.x, at.y)
    }

    #[test]
    fn wide_mask_shrinks_to_the_object_without_its_shadow() {
        let cameras: Vec<Camera> = (0..FRAMES).map(camera).collect();
        let truth: Vec<Vec<u8>> = (0..FRAMES)
            .map(|t| {
                (0..W * H)
                    .map(|p| if inside(t, p % W, p / W) { 255 } else { 0 })
                    .collect()
            })
            .collect();
        let shots = shots(|t, x, y| {
            if inside(t, x, y) {
                return [230, 200 - 6 * (x % 4) as u8, 40];
            }
            let shadow = x < W - 6 && inside(t, x + 6, y);
            let v = wall(&cameras, t, x, y);
            [if shadow {
                (f32::from(v) * 0.7) as u8
            } else {
                v
            }; 3]
        });
        let before: Vec<Vec<u8>> = truth.iter().map(|m| dilated(m, W, H, 4)).collect();
        let near: Vec<Vec<u8>> = before.iter().map(|m| dilated(m, W, H, 2)).collect();
        let background = vec![vec![0.25f32; W * H]; FRAMES];
        let scene = scene(&cameras, &shots, &background, &near);
        let t = FRAMES / 2;
        let smoother = Smoother::new(W, H, &shots[t].frame.rgb, 8.0);
        let after = sharpen(&scene, t, &before[t], &smoother);
        let (wide, sharp) = (share(&before[t], &truth[t]), share(&after, &truth[t]));
        assert!(wide < 0.55 && sharp > 0.8, "{wide} {sharp}");
    }

    #[test]
    fn faint_objects_are_found_where_the_frames_agree_on_the_background() {
        let cameras: Vec<Camera> = (0..FRAMES).map(camera).collect();
        let near: Vec<Vec<u8>> = (0..FRAMES)
            .map(|t| {
                (0..W * H)
                    .map(|p| u8::from(inside(t, p % W, p / W)))
                    .collect()
            })
            .collect();
        let background = vec![vec![0.25f32; W * H]; FRAMES];
        let t = FRAMES / 2;
        // the share of the object that speaks for motion, by how much the light flickers
        let measure = |flicker: u8| {
            let light = |t: usize| [0, flicker, 2 * flicker][t % 3];
            let shots = shots(|t, x, y| {
                [wall(&cameras, t, x, y) + light(t) + 15 * u8::from(inside(t, x, y)); 3]
            });
            let scene = scene(&cameras, &shots, &background, &near);
            let backgrounds = backgrounds(&scene, t, &near[t]);
            let evidence = evidence(&scene, t, &near[t], &backgrounds);
            let object: Vec<f32> = (0..W * H)
                .filter(|p| near[t][*p] > 0)
                .filter_map(|p| evidence[p])
                .collect();
            object.iter().filter(|e| **e > 0.0).count() as f64 / object.len() as f64
        };
        let (steady, flickering) = (measure(0), measure(6));
        assert!(steady > 0.9 && flickering < 0.1, "{steady} {flickering}");
    }

    fn scene<'a>(
        cameras: &'a [Camera],
        shots: &'a [Shot],
        background: &'a [Vec<f32>],
        near: &'a [Vec<u8>],
    ) -> BackgroundInputs<'a> {
        BackgroundInputs {
            width: W,
            height: H,
            parallax: true,
            rate: FrameRate::FILM,
            cameras,
            shots,
            background,
            near,
        }
    }

    #[test]
    fn passing_objects_differ_from_the_background() {
        let frame = |k: usize| {
            let image = Plane::from_fn(40, 32, |x, y| {
                if (3 * k..3 * k + 4).contains(&x) && (10..20).contains(&y) {
                    [250; 3]
                } else {
                    [(x * 3) as u8; 3]
                }
            });
            ScaledFrame::new(&image, (40, 32))
        };
        let frames: Vec<ScaledFrame> = (0..11).map(frame).collect();
        let evidence = difference_evidence(&median_colours(&frames), &frames[5]);
        for (i, e) in evidence.iter().enumerate() {
            let (x, y) = (i % 40, i / 40);
            let inside = (15..19).contains(&x) && (10..20).contains(&y);
            assert_eq!(*e > 0.0, inside, "{x}, {y}: {e}");
        }
    }
}
