//! What is known of a part of the coarse mask, as a segmenter takes it.

use super::distance::to_outside;
use super::source::SegmentPrompt;
use super::{BELIEF_LIMIT, BELIEF_PER_PX, POINTS};

/// How much farther from each other than from the part's edge points are to lie.
const APART: f32 = 3.0;

/// The prompt for the pixels at which `part` holds; `None` if there are none.
pub fn prompt(width: usize, height: usize, part: impl Fn(usize) -> bool + Copy) -> Option<SegmentPrompt> {
    let inner = to_outside(width, height, part);
    let outer = to_outside(width, height, |p| !part(p));
    Some(SegmentPrompt {
        points_px: points_apart(width, height, &inner, POINTS),
        off_points_px: Vec::new(),
        box_px: bounds(width, height, part)?,
        belief: belief(&inner, &outer),
    })
}

/// Logits that grow by [`BELIEF_PER_PX`] with the distance from the edge of a part up to [`BELIEF_LIMIT`]; `inner` is the distance of each pixel to what is outside
/// of the part, `outer` that to the part.
pub(crate) fn belief(inner: &[f32], outer: &[f32]) -> Vec<f32> {
    let logit = |(inner, outer): (&f32, &f32)| {
        let beyond_edge_px = if *inner > 0.0 { inner - 0.5 } else { 0.5 - outer };
        (BELIEF_PER_PX * beyond_edge_px).clamp(-BELIEF_LIMIT, BELIEF_LIMIT)
    };
    inner.iter().zip(outer).map(logit).collect()
}

fn bounds(width: usize, height: usize, part: impl Fn(usize) -> bool) -> Option<[f32; 4]> {
    let pixels = (0..width * height).filter(|&p| part(p));
    let ends = pixels.fold(None, |ends: Option<[usize; 4]>, p| {
        let (x, y) = (p % width, p / width);
        let [x0, y0, x1, y1] = ends.unwrap_or([x, y, x, y]);
        Some([x0.min(x), y0.min(y), x1.max(x), y1.max(y)])
    });
    ends.map(|ends| ends.map(|v| v as f32 + 0.5))
}

/// The place deepest inside (the image's border counts as an edge), then again and again the one that is both deep and far from those
/// before it; `inner` is the distance to what is outside.
pub(crate) fn points_apart(width: usize, height: usize, inner: &[f32], count: usize) -> Vec<[f32; 2]> {
    let mut depth: Vec<f32> = (0..width * height)
        .map(|p| {
            let (x, y) = (p % width, p / width);
            let border = (x + 1).min(width - x).min(y + 1).min(height - y);
            inner[p].min(border as f32)
        })
        .collect();
    let mut out = Vec::new();
    for _ in 0..count {
        let deepest = depth.iter().enumerate().fold(
            (0, 0.0),
            |best: (usize, f32), (p, &d)| if d > best.1 { (p, d) } else { best },
        );
        if deepest.1 <= 0.0 {
            break;
        }
        let (x, y) = (deepest.0 % width, deepest.0 / width);
        out.push([x as f32 + 0.5, y as f32 + 0.5]);
        for (p, d) in depth.iter_mut().enumerate() {
            let away = ((p % width) as f32 - x as f32).hypot((p / width) as f32 - y as f32);
            *d = d.min(away / APART);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::{BELIEF_LIMIT, BELIEF_PER_PX, POINTS};
    use super::prompt;

    #[test]
    fn prompts_hold_the_box_and_confident_points() {
        let (w, h) = (40, 30);
        // A bar of 24 x 6 pixels.
        let part = |p: usize| (8..32).contains(&(p % w)) && (10..16).contains(&(p / w));
        let found = prompt(w, h, part).unwrap();
        assert_eq!(found.box_px, [8.5, 10.5, 31.5, 15.5]);
        assert_eq!(found.points_px.len(), POINTS);
        for (i, &[x, y]) in found.points_px.iter().enumerate() {
            assert!(part(y as usize * w + x as usize), "{x} {y}");
            for &[ox, oy] in &found.points_px[..i] {
                assert!((x - ox).hypot(y - oy) > 4.0, "{x} {y} {ox} {oy}");
            }
        }
        let at = |x: usize, y: usize| found.belief[y * w + x];
        assert_eq!((at(8, 12), at(7, 12)), (0.5 * BELIEF_PER_PX, -0.5 * BELIEF_PER_PX));
        assert_eq!(at(0, 0), -BELIEF_LIMIT);
        assert_eq!(at(16, 12), 2.5 * BELIEF_PER_PX);
        assert!(prompt(w, h, |_| false).is_none());
    }
}
