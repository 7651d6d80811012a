//! Depth reversal: from afar, a shape and its mirror image that turns the other way look alike
//! (Szeliski and Kang 1997). An adjustment that starts from a flat part may take one of them in
//! some frames and the other in the next. Where the reliefs of neighbouring frames contradict each
//! other, or single frames find the mirror image more probable ([`super::shape_prior`]), the frames
//! before or after are mirrored and adjusted again, and the better result stays.

use super::residual::{offset_px, ray};
use crate::FrameRate;
use crate::dba::{Factor, Geometry};
use m4_core::Se3;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeSet;

/// Time on each side of a moment over which reliefs are compared, seconds.
const AROUND_S: f64 = 1.0 / 6.0;
/// A result is better if its robust squared residuals are lower by this share (with 2 %, parts that
/// are not rigid are mirrored at random), if its shape is more probable by this logarithm, or both
/// in part.
const BETTER: f64 = 0.05;
const SURE: f64 = 6.0;
/// Most corrections of a part.
const ROUNDS: usize = 4;
/// Reliefs count up to this logarithm of depth.
const MOST_RELIEF: f64 = 0.3;
/// Fewest pixels that two frames are compared by.
const LEAST_SHARED: usize = 8;
/// Nearest depth of a mirrored pixel, as a share of the part's.
const NEAREST: f64 = 0.3;

/// Mirrors frames of an adjusted part where that explains the flow and single frames better;
/// `again` adjusts a geometry, `prior` is the logarithm of the probability of its shape by frame,
/// and `cauchy_px` is the residual that counts half, in pixels of the grid.
pub(super) fn resolve(
    geometry: &mut Geometry<f32>,
    edges: &[&Factor<f32>],
    rate: FrameRate,
    cauchy_px: f64,
    prior: impl Fn(&Geometry<f32>) -> Vec<f64>,
    again: impl Fn(&mut Geometry<f32>) -> Option<()>,
) {
    let frames = geometry.frames();
    let reach = rate.frames(AROUND_S).max(2);
    let evidence = |geometry: &Geometry<f32>| {
        let prior: f64 = prior(geometry).iter().sum();
        prior / SURE - cost(geometry, edges, cauchy_px).ln() / BETTER
    };
    let mut most = evidence(geometry);
    for _ in 0..ROUNDS {
        let mut spans = BTreeSet::from([(0, frames)]);
        for moment in contradictions(geometry, reach) {
            spans.extend([(0, moment), (moment, frames)]);
        }
        if let Some(other) = mirrored(geometry, 0, frames) {
            spans.extend(improbable(&prior(geometry), &prior(&other)));
        }
        let best = spans
            .into_iter()
            .filter_map(|(from, end)| {
                let mut other = mirrored(geometry, from, end)?;
                again(&mut other)?;
                Some((evidence(&other), other))
            })
            .max_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((evidence, other)) if evidence > most + 1.0 => {
                (most, *geometry) = (evidence, other);
            }
            _ => return,
        }
    }
}

/// The run of first frames, and that of last ones, that gain most by mirroring (logarithms of
/// probabilities by frame, before and after), if they gain.
fn improbable(own: &[f64], other: &[f64]) -> Vec<(usize, usize)> {
    let gain =
        |(from, end): (usize, usize)| -> f64 { (from..end).map(|k| other[k] - own[k]).sum() };
    let most = |spans: &mut dyn Iterator<Item = (usize, usize)>| {
        spans
            .max_by(|a, b| gain(*a).total_cmp(&gain(*b)))
            .filter(|span| gain(*span) > 0.0)
    };
    let frames = own.len();
    let first = most(&mut (1..frames).map(|moment| (0, moment)));
    let last = most(&mut (1..frames).map(|moment| (moment, frames)));
    first.into_iter().chain(last).collect()
}

/// The part's own pixels of a frame.
fn pixels(geometry: &Geometry<f32>, k: usize) -> impl Iterator<Item = usize> + '_ {
    (0..geometry.grid.len())
        .filter(move |&g| geometry.sensor[k][g] > 0.0 && geometry.disparity[k][g] > 0.0)
}

/// Robust sum of squared residuals (Cauchy), pixels of the grid.
fn cost(geometry: &Geometry<f32>, edges: &[&Factor<f32>], cauchy_px: f64) -> f64 {
    let of_edge = |edge: &&Factor<f32>| {
        let relative = geometry.relative(edge.source, edge.target);
        let mut sum = 0.0;
        for g in 0..geometry.grid.len() {
            let weight = 0.5 * f64::from(edge.weight[0][g] + edge.weight[1][g]);
            if weight <= 0.0 {
                continue;
            }
            let off = offset_px(geometry, edge, &relative, g);
            let squared = (off[0] * off[0] + off[1] * off[1]) / (cauchy_px * cauchy_px);
            sum += weight * squared.ln_1p();
        }
        sum
    };
    edges.iter().map(of_edge).sum()
}

/// Moments at which the reliefs before and after contradict: the worst of each interval in which
/// their correlation is below 0; a moment is the first frame after it.
fn contradictions(geometry: &Geometry<f32>, reach: usize) -> Vec<usize> {
    let frames = geometry.frames();
    let (mut out, mut worst): (Vec<usize>, Option<(f64, usize)>) = (Vec::new(), None);
    for moment in 1..frames {
        let (mut product, mut square) = (0.0, 0.0);
        for half in reach.div_ceil(2)..=reach {
            let (Some(a), b) = (moment.checked_sub(half), moment + half - 1) else {
                continue;
            };
            if b >= frames {
                continue;
            }
            for (source, target) in [(a, b), (b, a)] {
                if let Some(shared) = shared(geometry, source, target) {
                    product += shared.0;
                    square += shared.1;
                }
            }
        }
        let correlation = product / square;
        if correlation < 0.0 {
            if worst.is_none_or(|(least, _)| correlation < least) {
                worst = Some((correlation, moment));
            }
        } else {
            out.extend(worst.take().map(|(_, moment)| moment));
        }
    }
    out.extend(worst.map(|(_, moment)| moment));
    out
}

/// Sums of products of the reliefs (logarithms of depth less their mean) of the pixels of `source`,
/// carried to `target`, and of the pixels there; and of their squares.
fn shared(geometry: &Geometry<f32>, source: usize, target: usize) -> Option<(f64, f64)> {
    let (grid, lens) = (geometry.grid, &geometry.lens);
    let relative = geometry.relative(source, target);
    let mut pairs: Vec<[f64; 2]> = Vec::new();
    for g in pixels(geometry, source) {
        let d = f64::from(geometry.disparity[source][g]);
        let p = relative.rotation * ray(geometry, g) + relative.translation * d;
        if p.z <= 0.0 {
            continue;
        }
        let x = (lens.fx * p.x / p.z + lens.cx).round();
        let y = (lens.fy * p.y / p.z + lens.cy).round();
        if !(x >= 0.0 && y >= 0.0 && x < grid.width as f64 && y < grid.height as f64) {
            continue;
        }
        let there = y as usize * grid.width + x as usize;
        let own = f64::from(geometry.disparity[target][there]);
        if geometry.sensor[target][there] > 0.0 && own > 0.0 {
            pairs.push([(p.z / d).ln(), -own.ln()]);
        }
    }
    if pairs.len() < LEAST_SHARED {
        return None;
    }
    let mean = |i: usize| pairs.iter().map(|p| p[i]).sum::<f64>() / pairs.len() as f64;
    let means = [mean(0), mean(1)];
    let (mut product, mut square) = (0.0, 0.0);
    for pair in &pairs {
        let [a, b] = [0, 1].map(|i| (pair[i] - means[i]).clamp(-MOST_RELIEF, MOST_RELIEF));
        product += a * b;
        square += 0.5 * (a * a + b * b);
    }
    Some((product, square))
}

/// The geometry with frames `from..end` mirrored at the plane through the part's middle that faces
/// the camera, and turned the other way from frame `from` on.
fn mirrored(geometry: &Geometry<f32>, from: usize, end: usize) -> Option<Geometry<f32>> {
    let (mut middle, mut count) = (Vector3::zeros(), 0.0);
    for k in from..end {
        let to_body = geometry.poses[k].inverse();
        for g in pixels(geometry, k) {
            middle += to_body.transform(&(ray(geometry, g) / f64::from(geometry.disparity[k][g])));
            count += 1.0;
        }
    }
    middle /= count;
    let centre = |k: usize| geometry.poses[k].transform(&middle);
    let mirror = |k: usize| {
        let axis = centre(k).try_normalize(1e-9)?;
        Some(Matrix3::identity() - 2.0 * axis * axis.transpose())
    };
    let first = geometry.poses.get(from)?.rotation;
    let first_mirror = mirror(from)?;
    let mut out = geometry.clone();
    for k in from..end {
        let turn = geometry.poses[k].rotation * first.transpose();
        let rotation = mirror(k)? * turn * first_mirror * first;
        let centre = centre(k);
        out.poses[k] = Se3 {
            rotation,
            translation: centre - rotation * middle,
        };
        for g in pixels(geometry, k) {
            let z = 2.0 * centre.z - 1.0 / f64::from(geometry.disparity[k][g]);
            out.disparity[k][g] = (1.0 / z.max(NEAREST * centre.z)) as f32;
        }
    }
    (count > 0.0).then_some(out)
}

#[cfg(test)]
mod tests {
    //! A bent sheet that turns while the camera rests, seen exactly.

    use super::{Factor, FrameRate, Geometry, cost, improbable, mirrored, ray, resolve};
    use crate::dba::{DbaOptions, Free, Grid, Pinhole, Problem, adjust};
    use m4_core::Se3;
    use nalgebra::{Vector3, Vector6};

    const FRAMES: usize = 12;
    const SIDE: usize = 12;
    const CAUCHY_PX: f64 = 0.15;
    const FILM: FrameRate = FrameRate::FILM;

    /// How the sheet is bent: its depth over its middle at a place on it.
    fn relief(x: f64, y: f64) -> f64 {
        0.5 * (x * x - y * y) + 0.2 * x
    }

    /// The sheet, 0.6 wide at a distance of 3, which turns by 4 degrees a frame.
    fn turning() -> (Geometry<f32>, Vec<Factor<f32>>) {
        let grid = Grid {
            width: SIDE,
            height: SIDE,
        };
        let lens = Pinhole {
            fx: 60.0,
            fy: 60.0,
            cx: (SIDE as f64 - 1.0) / 2.0,
            cy: (SIDE as f64 - 1.0) / 2.0,
        };
        let middle = Vector3::new(0.0, 0.0, 3.0);
        let poses: Vec<Se3<f64>> = (0..FRAMES)
            .map(|k| {
                let turn = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.07 * k as f64, 0.02));
                Se3 {
                    translation: middle,
                    ..turn
                }
            })
            .collect();
        let mut geometry = Geometry {
            grid,
            lens,
            poses,
            disparity: vec![vec![0.0; grid.len()]; FRAMES],
            sensor: vec![vec![1.0 / 3.0; grid.len()]; FRAMES],
        };
        for k in 0..FRAMES {
            let pose = geometry.poses[k];
            for g in 0..grid.len() {
                let direction = ray(&geometry, g);
                // Where the ray meets the sheet: depth by fixed-point iteration.
                let mut z = 3.0;
                for _ in 0..50 {
                    let p = pose.inverse().transform(&(direction * z));
                    let above = Vector3::new(p.x, p.y, relief(p.x, p.y));
                    z = pose.transform(&above).z;
                }
                geometry.disparity[k][g] = (1.0 / z) as f32;
            }
        }
        let mut edges = Vec::new();
        for source in 0..FRAMES {
            for span in [1, 3] {
                for target in [source.checked_sub(span), Some(source + span)] {
                    let Some(target) = target.filter(|t| *t < FRAMES) else {
                        continue;
                    };
                    let relative = geometry.relative(source, target);
                    let seen = |g: usize| {
                        let d = f64::from(geometry.disparity[source][g]);
                        let p = relative.rotation * ray(&geometry, g) + relative.translation * d;
                        [
                            (lens.fx * p.x / p.z + lens.cx) as f32,
                            (lens.fy * p.y / p.z + lens.cy) as f32,
                        ]
                    };
                    let at: Vec<[f32; 2]> = (0..grid.len()).map(seen).collect();
                    edges.push(Factor {
                        source,
                        target,
                        target_px: [0, 1].map(|i| at.iter().map(|p| p[i]).collect()),
                        weight: [vec![1.0; grid.len()], vec![1.0; grid.len()]],
                    });
                }
            }
        }
        (geometry, edges)
    }

    #[test]
    fn a_mirrored_half_of_a_clip_is_turned_back_and_a_right_one_stays() {
        let (truth, edges) = turning();
        let refs: Vec<&_> = edges.iter().collect();
        let eta = vec![vec![1.0f32; truth.grid.len()]; FRAMES];
        let problem = Problem {
            edges: &refs,
            eta: &eta,
        };
        let again = |geometry: &mut Geometry<f32>| {
            for free in [Free::Poses, Free::PosesAndDepth] {
                let options = DbaOptions {
                    free,
                    iterations: 10,
                    ep: 1e-4,
                    prior_alpha: Some(1e-4),
                    cauchy_px: Some(CAUCHY_PX),
                    min_depth: 0.1,
                    ..DbaOptions::default()
                };
                adjust(geometry, &problem, 1..FRAMES, &options).ok()?;
            }
            Some(())
        };
        let unsure = |geometry: &Geometry<f32>| vec![0.0; geometry.frames()];
        let mut wrong = mirrored(&truth, FRAMES / 2, FRAMES).unwrap();
        again(&mut wrong).unwrap();
        let bad = cost(&wrong, &refs, CAUCHY_PX);
        resolve(&mut wrong, &refs, FILM, CAUCHY_PX, unsure, again);
        let good = cost(&wrong, &refs, CAUCHY_PX);
        assert!(good < 0.2 * bad, "{bad} {good}");

        let mut right = truth.clone();
        resolve(&mut right, &refs, FILM, CAUCHY_PX, unsure, again);
        assert_eq!(right.disparity, truth.disparity);
    }

    #[test]
    fn a_part_that_does_not_turn_has_the_more_probable_shape() {
        let (mut truth, mut edges) = turning();
        // flow that is off everywhere, whatever the shape
        for edge in &mut edges {
            for (g, x) in edge.target_px[0].iter_mut().enumerate() {
                *x = (g % SIDE) as f32 + 0.1;
            }
        }
        let refs: Vec<&_> = edges.iter().collect();
        let still = truth.poses[0];
        truth.poses.fill(still);
        let first = truth.disparity[0].clone();
        truth.disparity.fill(first);
        // the corner is nearer than the middle of the edge, and should be
        let prior = |geometry: &Geometry<f32>| -> Vec<f64> {
            let nearer = |d: &Vec<f32>| f64::from(d[0] / d[SIDE / 2] - 1.0).signum();
            geometry.disparity.iter().map(nearer).collect()
        };
        let sign = prior(&truth)[0];
        let right = |geometry: &Geometry<f32>| -> Vec<f64> {
            prior(geometry).into_iter().map(|own| own * sign).collect()
        };
        let mut wrong = mirrored(&truth, 0, FRAMES).unwrap();
        assert!(right(&wrong)[0] < 0.0);
        let again = |_: &mut Geometry<f32>| Some(());
        resolve(&mut wrong, &refs, FILM, CAUCHY_PX, right, again);
        assert!(right(&wrong)[0] > 0.0);
    }

    #[test]
    fn the_ends_of_a_clip_whose_mirror_images_are_more_probable_are_tried() {
        let own = [0.0, 0.0, -1.0, 0.5, -2.0, -2.0];
        let other = own.map(|log: f64| -log);
        assert_eq!(improbable(&own, &other), vec![(0, 5), (2, 6)]);
        assert_eq!(improbable(&other, &[0.0; 6]), vec![]);
    }

    #[test]
    fn mirroring_twice_gives_the_same_relative_motion() {
        let (truth, _) = turning();
        let once = mirrored(&truth, 0, FRAMES).unwrap();
        let twice = mirrored(&once, 0, FRAMES).unwrap();
        let turn = |g: &Geometry<f32>| g.relative(0, FRAMES - 1).rotation;
        assert!((turn(&truth) - turn(&twice)).norm() < 1e-3);
        assert!((turn(&truth) - turn(&once)).norm() > 0.1);
    }
}
