//! A mask carried to the next frame along the flow, and sharpened there along the edges of the
//! frame.

use crate::classical::dense::to_outside;
use crate::flow::{FlowPair, ScaledFrame};
use crate::smooth::Smoother;
use m4_core::{CompactMask, bilinear};

/// A pixel whose way there and back misses by this much counts half, pixels of the masks' size.
const ROUND_TRIP_PX: f32 = 1.0;
/// Strength of the smoothing of a carried mask along the edges of the frame, pixels squared.
const SMOOTH_LAMBDA: f32 = 40.0;
/// How wide of its edge a coarse part may be, pixels: nearer to the edge than this, colours decide
/// more than the part does, where there is no segmenter.
const RIM_PX: f32 = 6.0;
/// Colour difference (0..255) that stops the smoothing.
const EDGE_SIGMA: f32 = 8.0;
/// A thing of which less than this share arrives in the next frame is lost.
const LEAST_KEPT: f32 = 0.2;
/// A thing of a smaller share of the image is lost.
const LEAST_SHARE: f32 = 0.0003;
/// How far beyond the carried pixels of a thing its mask may reach after sharpening, pixels.
const MARGIN_PX: usize = 16;

/// Weight of pixels without support: its neighbours of the same colour decide.
const UNKNOWN: f32 = 1e-6;

/// Share of 0 to 1 by which a pixel counts whose way there and back misses by `miss_px`. It falls
/// fast: what comes out from behind a thing fetches its value from the thing, and misses by the
/// thing's way.
fn trust(miss_px: f32) -> f32 {
    let r = miss_px / ROUND_TRIP_PX;
    if r < 2.0 {
        1.0 / (1.0 + r.powi(4))
    } else {
        0.0
    }
}

/// A coarse mask with its edge moved to an edge of the image: pixels count the less the nearer they
/// are to where the mask ends.
pub fn snap(mask: &CompactMask, image: &ScaledFrame) -> CompactMask {
    let (w, h) = mask.size();
    let inside = |p: usize| mask.at(p % w, p / w);
    let inner = to_outside(w, h, inside);
    let outer = to_outside(w, h, |p| !inside(p));
    let value: Vec<f32> = (0..w * h)
        .map(|p| if inside(p) { 1.0 } else { -1.0 })
        .collect();
    let sure = |(i, o): (&f32, &f32)| (i.max(*o) / RIM_PX).min(1.0).powi(2).max(UNKNOWN);
    let weight: Vec<f32> = inner.iter().zip(&outer).map(sure).collect();
    let smoother = Smoother::new(w, h, &image.rgb, EDGE_SIGMA);
    let field = smoother.fill(&value, &weight, SMOOTH_LAMBDA).0;
    CompactMask::from_fn(w, h, |x, y| field[y * w + x] > 0.0)
}

/// The mask in the other frame, whose image is `onto`; `None` where too little of the thing
/// arrives. `step` leads from the frame of the mask to the other, at the size of the mask: forward
/// says what arrives, backward fetches values.
pub fn carry(mask: &CompactMask, step: &FlowPair, onto: &ScaledFrame) -> Option<CompactMask> {
    let (w, h) = mask.size();
    let (mut area, mut arrives) = (0.0f32, 0.0f32);
    let mut ends: Option<[usize; 4]> = None;
    for (x, y) in mask.set_pixels() {
        let p = y * w + x;
        let t = trust(step.there().round_trip_px(p));
        area += 1.0;
        arrives += t;
        if t > 0.0 {
            let qx = (x as f32 + step.forward.u[p] + 0.5).max(0.0) as usize;
            let qy = (y as f32 + step.forward.v[p] + 0.5).max(0.0) as usize;
            let (qx, qy) = (qx.min(w - 1), qy.min(h - 1));
            let [x0, y0, x1, y1] = ends.unwrap_or([qx, qy, qx, qy]);
            ends = Some([x0.min(qx), y0.min(qy), x1.max(qx), y1.max(qy)]);
        }
    }
    if arrives < LEAST_KEPT * area {
        return None;
    }
    let [x0, y0, x1, y1] = ends?;
    let (x0, y0) = (x0.saturating_sub(MARGIN_PX), y0.saturating_sub(MARGIN_PX));
    let (x1, y1) = ((x1 + MARGIN_PX + 1).min(w), (y1 + MARGIN_PX + 1).min(h));
    let (cw, ch) = (x1 - x0, y1 - y0);
    let side: Vec<f32> = (0..w * h)
        .map(|p| if mask.at(p % w, p / w) { 1.0 } else { -1.0 })
        .collect();
    let (mut value, mut weight) = (vec![0.0; cw * ch], vec![0.0; cw * ch]);
    let mut guide = vec![[0u8; 3]; cw * ch];
    for y in 0..ch {
        for x in 0..cw {
            let (i, q) = (y * cw + x, (y0 + y) * w + x0 + x);
            let (px, py) = (
                (x0 + x) as f32 + step.backward.u[q],
                (y0 + y) as f32 + step.backward.v[q],
            );
            value[i] = bilinear(w, h, &side, px, py);
            weight[i] = trust(step.back().round_trip_px(q)).max(UNKNOWN);
            guide[i] = onto.rgb[q];
        }
    }
    let field = if cw > 1 && ch > 1 {
        Smoother::new(cw, ch, &guide, EDGE_SIGMA)
            .fill(&value, &weight, SMOOTH_LAMBDA)
            .0
    } else {
        value
    };
    let inside = |x: usize, y: usize| {
        x >= x0 && y >= y0 && x < x1 && y < y1 && field[(y - y0) * cw + x - x0] > 0.0
    };
    let out = CompactMask::from_fn(w, h, inside);
    (out.count() as f32 >= (LEAST_SHARE * (w * h) as f32).max(1.0)).then_some(out)
}
