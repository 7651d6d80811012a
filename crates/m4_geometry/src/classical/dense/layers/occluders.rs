//! Static pixels that occlude dynamic regions: where a mask ends at the same place for many frames
//! while what is inside it moves across that edge, it is cut off by something static in front of
//! it.

use super::super::rigid_objects::ROUND_TRIP_PX;
use super::super::shot::{Pair, Shot};
use super::super::working::{WorkingClip, pixel_at};
use crate::smooth::Smoother;
use m4_core::{Camera, Intrinsics};

/// Frames that the colours of the canvas are the median of, spread over the clip.
const SAMPLES: usize = 25;
/// Least motion across an edge that counts, pixels per frame: above the noise of the flow.
const LEAST_STEP_PX: f32 = 0.5;
/// Most motion that one frame may contribute, pixels: one frame with a wrong flow is no evidence.
const MOST_STEP_PX: f32 = 2.0;
/// Motion across an edge, all frames together, from which on it cuts off a dynamic region, in image
/// widths.
const LEAST_TRAVEL: f32 = 0.02;
/// How deep inside a mask the flow is read: at its very edge it is a mixture.
const DEPTH_PX: isize = 3;
/// Weight of the assumption that a pixel is background, against 1 for an edge that just counts.
const PRIOR: f32 = 0.02;
/// Colour difference (0..255) over which the coupling of neighbours falls by e.
const SIGMA: f32 = 10.0;
/// Strength of the edge-aware spreading, pixels squared.
const LAMBDA: f32 = 500.0;

/// Which directions from the camera an occluder lies in.
pub(super) struct Occluders {
    /// Looks where the middle of the clip looks, with twice the image on either axis.
    camera: Camera,
    /// `[height][width]` of the canvas; empty where nothing occludes.
    occludes: Vec<bool>,
}

impl Occluders {
    /// Looks for them; `shots` have the colours.
    pub fn find(clip: &WorkingClip<'_>, shots: &[Shot]) -> Self {
        let (w, h) = (clip.width, clip.height);
        let camera = canvas(&clip.cameras[clip.cameras.len() / 2]);
        let (cw, ch) = (camera.intrinsics.width, camera.intrinsics.height);
        let mut travel = vec![0.0f32; cw * ch];
        let mut covered = vec![false; cw * ch];
        for (i, dynamic) in clip.dynamic.iter().enumerate() {
            let pair = Pair::new(&clip.cameras[i], &camera);
            let at = |p: usize| on_sphere(&pair, p, w, (cw, ch));
            for p in (0..w * h).filter(|&p| dynamic[p] > 0) {
                if let Some(q) = at(p) {
                    covered[q] = true;
                }
            }
            if i + 1 < clip.dynamic.len() {
                for (p, step) in crossings(clip, i) {
                    if let Some(q) = at(p) {
                        travel[q] += step;
                    }
                }
            }
        }
        let least = LEAST_TRAVEL * w as f32;
        let seeds: Vec<usize> = (0..cw * ch)
            .filter(|&q| travel[q] >= least && !covered[q])
            .collect();
        if seeds.is_empty() {
            return Self {
                camera,
                occludes: Vec::new(),
            };
        }
        let (mut value, mut weight) = (vec![-1.0f32; cw * ch], vec![PRIOR; cw * ch]);
        for q in (0..cw * ch).filter(|&q| covered[q]) {
            weight[q] = 1.0;
        }
        for q in seeds {
            (value[q], weight[q]) = (1.0, (travel[q] / least).min(4.0));
        }
        let smoother = Smoother::new(cw, ch, &colours(clip, shots, &camera), SIGMA);
        let (score, _) = smoother.fill(&value, &weight, LAMBDA);
        let occludes = score
            .iter()
            .zip(&covered)
            .map(|(s, covered)| *s > 0.0 && !covered)
            .collect();
        Self { camera, occludes }
    }

    /// `[height][width]` of a frame: whether a static pixel lies in front of the dynamic regions.
    pub fn in_frame(&self, camera: &Camera, w: usize, h: usize) -> Vec<bool> {
        if self.occludes.is_empty() {
            return vec![false; w * h];
        }
        let pair = Pair::new(camera, &self.camera);
        let k = &self.camera.intrinsics;
        (0..w * h)
            .map(|p| on_sphere(&pair, p, w, (k.width, k.height)).is_some_and(|q| self.occludes[q]))
            .collect()
    }
}

/// The camera with half an image more on every side.
fn canvas(camera: &Camera) -> Camera {
    let k = &camera.intrinsics;
    Camera {
        intrinsics: Intrinsics {
            width: 2 * k.width,
            height: 2 * k.height,
            cx: k.cx + (k.width / 2) as f64,
            cy: k.cy + (k.height / 2) as f64,
            ..*k
        },
        c2w: camera.c2w,
    }
}

/// Where another camera sees pixel `p` of rows of `w`, at about distance 1: an index into its
/// `width` x `height` pixels, if it does.
fn on_sphere(pair: &Pair, p: usize, w: usize, (width, height): (usize, usize)) -> Option<usize> {
    let target = pair.project((p % w) as f32, (p / w) as f32, 1.0);
    pixel_at(width, height, target.x, target.y).filter(|_| target.disparity > 0.0)
}

/// Static pixels of frame `i` beside a dynamic one that stay so until the next frame, and how far
/// what is inside the mask moves across the edge meanwhile, pixels.
fn crossings(clip: &WorkingClip<'_>, i: usize) -> Vec<(usize, f32)> {
    let (w, h) = (clip.width, clip.height);
    let (now, next) = (&clip.dynamic[i], &clip.dynamic[i + 1]);
    let flow = &clip.flows[i];
    let camera = Pair::new(&clip.cameras[i], &clip.cameras[i + 1]);
    let mut out = Vec::new();
    let rim = DEPTH_PX as usize + 1;
    for y in rim..h.saturating_sub(rim) {
        for x in rim..w.saturating_sub(rim) {
            let p = y * w + x;
            if now[p] > 0 {
                continue;
            }
            let mut most = 0.0f32;
            for (dx, dy) in [(1isize, 0isize), (-1, 0), (0, 1), (0, -1)] {
                let beside =
                    |n: isize| y.wrapping_add_signed(n * dy) * w + x.wrapping_add_signed(n * dx);
                let (edge, inside) = (beside(1), beside(DEPTH_PX));
                if now[edge] == 0
                    || now[inside] == 0
                    || flow.there().round_trip_px(inside) > ROUND_TRIP_PX
                {
                    continue;
                }
                let later = |q: usize| on_sphere(&camera, q, w, (w, h)).map(|q| next[q] > 0);
                if later(p) != Some(false) || later(edge) != Some(true) {
                    continue;
                }
                let (ix, iy) = ((inside % w) as f32, (inside / w) as f32);
                let still = camera.project(ix, iy, 1.0);
                let (u, v) = (
                    flow.forward.u[inside] - (still.x - ix),
                    flow.forward.v[inside] - (still.y - iy),
                );
                most = most.max((u * dx as f32 + v * dy as f32).abs());
            }
            if most >= LEAST_STEP_PX {
                out.push((p, most.min(MOST_STEP_PX)));
            }
        }
    }
    out
}

/// The usual colour in every direction of the canvas, grey where no frame looks.
fn colours(clip: &WorkingClip<'_>, shots: &[Shot], canvas: &Camera) -> Vec<[u8; 3]> {
    let (w, h) = (clip.width, clip.height);
    let k = &canvas.intrinsics;
    let count = SAMPLES.min(shots.len());
    let chosen: Vec<(&Shot, Pair)> = (0..count)
        .map(|s| s * shots.len() / count)
        .map(|i| (&shots[i], Pair::new(canvas, &clip.cameras[i])))
        .collect();
    let mut colours: Vec<[u8; 3]> = Vec::with_capacity(count);
    (0..k.width * k.height)
        .map(|q| {
            colours.clear();
            for (shot, pair) in &chosen {
                colours.extend(on_sphere(pair, q, k.width, (w, h)).map(|p| shot.frame.rgb[p]));
            }
            let middle = colours.len() / 2;
            std::array::from_fn(|c| {
                colours.sort_unstable_by_key(|rgb| rgb[c]);
                colours.get(middle).map_or(128, |rgb| rgb[c])
            })
        })
        .collect()
}
