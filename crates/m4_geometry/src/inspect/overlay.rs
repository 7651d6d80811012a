//! Logos, subtitles and other marks that lie over the image and stay while the scene moves.

use super::fill::fill;
use super::small;
use super::timeline::Shown;
use m4_core::{Mask, Plane, RgbImage};
use rayon::prelude::*;
use std::ops::Range;

/// Longest side of the images on which overlays are looked for, pixels.
const SIDE_PX: usize = 640;
/// Least difference across an edge, grey levels per pixel.
const EDGE: f32 = 10.0;
/// An edge is the same while its gradient, along the mean, is within this share of it.
const SAME: std::ops::RangeInclusive<f32> = 0.5..=1.5;
/// ... in this share of the frames of a part of the clip, and at this share of its pixels in a
/// frame that shows the overlay.
const IN_FRAMES: f64 = 0.85;
const IN_PIXELS: f64 = 0.6;
/// Frames of a part that are compared, at least and at most.
const MIN_FRAMES: usize = 8;
const MOST_FRAMES: usize = 32;
/// Least motion of the scene meanwhile, image widths: in all quadrants but one.
const MIN_MOTION: f32 = 0.03;
/// Overlays that come and go stay this long, seconds, and are looked for at this interval.
const PART_S: f64 = 1.0;
const INTERVAL_S: f64 = 0.25;
/// More of the edges than this share hold still in a scene that does not move.
const MOST_EDGES: f64 = 0.3;
/// Fewest pixels of edges of an overlay.
const MIN_EDGES: usize = 20;
/// Edges fill at least this share of the surroundings within reach: those of a part of the scene
/// around which the camera turns hold still here and there.
const MIN_DENSITY: f64 = 0.08;
/// Around an overlay the scene moves: the mean of its gradients has at most this share of their
/// mean length. Around a place that the camera turns about it hardly moves.
const MOST_AROUND: f32 = 0.4;
/// Edges run in several directions: the lesser of the eigenvalues of their gradients' covariance
/// over the greater. A long edge along the motion of the camera holds still, too.
const MIN_SPREAD: f32 = 0.15;
/// Most of the image that one overlay takes.
const MOST_AREA: f64 = 0.15;
/// Edges this near to each other are of one overlay, and it reaches this far beyond them, share of
/// the longest side.
const REACH: f64 = 0.012;

/// A pixel of an edge and its gradient.
type Edge = (usize, [f32; 2]);

/// Of a pixel, the length of the mean of its gradients, and the mean of their lengths.
type Lengths = [f32; 2];

/// One overlay.
#[derive(Debug)]
struct Region {
    edges: Vec<Edge>,
    area: Vec<usize>,
}

/// The overlays of the frames of a shot.
#[derive(Debug)]
pub struct Overlays {
    /// At working size.
    size: (usize, usize),
    regions: Vec<Region>,
    /// Of each frame, which regions it shows.
    shown: Vec<Vec<usize>>,
}

impl Overlays {
    /// Looks for edges that hold still in `images`, all of one size, while the points of the scene
    /// move; `frames` says how far. A scene that does not move reveals none.
    ///
    /// # Panics
    ///
    /// If there are not as many frames as images.
    #[must_use]
    pub fn of(images: &[&RgbImage], frames: &[Shown]) -> Self {
        assert_eq!(images.len(), frames.len(), "a frame per image");
        let luma: Vec<Plane<u8>> = images
            .par_iter()
            .map(|image| small(image, SIDE_PX).map(|v| v.round() as u8))
            .collect();
        let size = luma.first().map_or((0, 0), Plane::size);
        let parts: Vec<Vec<usize>> = parts(frames)
            .into_iter()
            .filter(|part| moves(frames, part))
            .collect();
        let each: Vec<Vec<Region>> = parts
            .par_iter()
            .map(|part| regions(&part.iter().map(|&i| &luma[i]).collect::<Vec<_>>()))
            .collect();
        let regions: Vec<Region> = each.into_iter().flatten().collect();
        let shown = luma
            .par_iter()
            .map(|image| {
                let shows = |region: &Region| region.is_in(image);
                (0..regions.len()).filter(|&r| shows(&regions[r])).collect()
            })
            .collect();
        Self {
            size,
            regions,
            shown,
        }
    }

    /// Number of frames with an overlay.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.shown.iter().filter(|shown| !shown.is_empty()).count()
    }

    /// The rectangle around all overlays, as shares of the sides: left, top, right, bottom.
    #[must_use]
    pub fn extent(&self) -> Option<[f64; 4]> {
        let (w, h) = self.size;
        let used = self.shown.iter().flatten().map(|&r| &self.regions[r]);
        let pixels = used.flat_map(|region| &region.area);
        pixels.fold(None, |extent, &i| {
            let (x, y) = ((i % w) as f64 / w as f64, (i / w) as f64 / h as f64);
            let (right, bottom) = (x + 1.0 / w as f64, y + 1.0 / h as f64);
            let [a, b, c, d] = extent.unwrap_or([x, y, right, bottom]);
            Some([a.min(x), b.min(y), c.max(right), d.max(bottom)])
        })
    }

    /// The overlay of frame `i`, 255 where it is, for an image of `size`; `None` where it has none.
    ///
    /// # Panics
    ///
    /// If there is no such frame.
    #[must_use]
    pub fn mask(&self, i: usize, size: (usize, usize)) -> Option<Mask> {
        if self.shown[i].is_empty() {
            return None;
        }
        let mut all: Mask = Plane::filled(self.size.0, self.size.1, 0);
        for &r in &self.shown[i] {
            for &pixel in &self.regions[r].area {
                all.data_mut()[pixel] = 255;
            }
        }
        let at = |v: usize, n: usize, of: usize| (v * of / n.max(1)).min(of - 1);
        Some(Plane::from_fn(size.0, size.1, |x, y| {
            all[(at(x, size.0, self.size.0), at(y, size.1, self.size.1))]
        }))
    }

    /// Replaces the overlay of frame `i` by a smooth continuation of the image around it.
    ///
    /// # Panics
    ///
    /// If there is no such frame.
    pub fn remove(&self, i: usize, image: &mut RgbImage) {
        if let Some(mask) = self.mask(i, image.size()) {
            fill(image, &mask.map(|&v| v > 0));
        }
    }
}

/// The whole shot and its parts, as indices of frames that are evenly spaced along the way of the
/// scene: frozen and slow stretches count little.
fn parts(frames: &[Shown]) -> Vec<Vec<usize>> {
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
        return Vec::new();
    };
    let mut ways = vec![0.0];
    for pair in frames.windows(2) {
        ways.push(ways[ways.len() - 1] + way(&pair[0], &pair[1]));
    }
    let thin = |range: Range<usize>| -> Vec<usize> {
        let (from, to) = (ways[range.start], ways[range.end - 1]);
        let step = (to - from) / MOST_FRAMES as f32;
        let mut chosen: Vec<usize> = Vec::new();
        for i in range {
            if chosen.last().is_none_or(|&j| ways[i] - ways[j] > step) {
                chosen.push(i);
            }
        }
        chosen
    };
    let mut parts = vec![thin(0..frames.len())];
    let mut start_s = first.time_s;
    while start_s + PART_S < last.time_s {
        let start = frames.partition_point(|frame| frame.time_s < start_s);
        let end = frames.partition_point(|frame| frame.time_s <= start_s + PART_S);
        if start < end {
            parts.push(thin(start..end));
        }
        start_s += INTERVAL_S;
    }
    parts.retain(|part| part.len() >= MIN_FRAMES);
    parts
}

/// How far all quadrants but one move at least, image widths.
fn way(from: &Shown, to: &Shown) -> f32 {
    let mut lengths: [f32; 4] = std::array::from_fn(|quadrant| {
        let (a, b) = (from.place[quadrant], to.place[quadrant]);
        (b[0] - a[0]).hypot(b[1] - a[1])
    });
    lengths.sort_by(f32::total_cmp);
    lengths[1]
}

/// Whether the scene moves enough in these frames.
fn moves(frames: &[Shown], part: &[usize]) -> bool {
    let range = |quadrant: usize, axis: usize| {
        let values = part.iter().map(|&i| frames[i].place[quadrant][axis]);
        let most = values.clone().fold(f32::NEG_INFINITY, f32::max);
        most - values.fold(f32::INFINITY, f32::min)
    };
    let moving = (0..4).filter(|&q| range(q, 0).hypot(range(q, 1)) >= MIN_MOTION);
    moving.count() >= 3
}

/// Central differences at a pixel that is not at the border.
fn gradient(image: &Plane<u8>, i: usize) -> [f32; 2] {
    let (w, data) = (image.width(), image.data());
    let half = |a: u8, b: u8| 0.5 * (f32::from(b) - f32::from(a));
    [
        half(data[i - 1], data[i + 1]),
        half(data[i - w], data[i + w]),
    ]
}

fn same(g: [f32; 2], mean: [f32; 2]) -> bool {
    let square = mean[0] * mean[0] + mean[1] * mean[1];
    SAME.contains(&((g[0] * mean[0] + g[1] * mean[1]) / square))
}

/// Overlays that all of `images` show.
fn regions(images: &[&Plane<u8>]) -> Vec<Region> {
    let Some((w, h)) = images.first().map(|image| image.size()) else {
        return Vec::new();
    };
    let n = images.len() as f32;
    let (mut edges, mut typical): (Vec<Edge>, f64) = (Vec::new(), 0.0);
    let mut lengths: Vec<Lengths> = vec![[0.0; 2]; w * h];
    for y in 1..h.saturating_sub(1) {
        for i in y * w + 1..(y + 1) * w - 1 {
            let mut sum = [0.0; 2];
            let (mut length, mut strong) = (0.0, 0);
            for image in images {
                let g = gradient(image, i);
                sum = [sum[0] + g[0], sum[1] + g[1]];
                let own = g[0].hypot(g[1]);
                length += own;
                strong += usize::from(own >= EDGE);
            }
            typical += strong as f64 / f64::from(n);
            let mean = sum.map(|v| v / n);
            lengths[i] = [mean[0].hypot(mean[1]), length / n];
            if lengths[i][0] < EDGE {
                continue;
            }
            let still = images.iter().filter(|image| same(gradient(image, i), mean));
            if still.count() as f64 >= IN_FRAMES * f64::from(n) {
                edges.push((i, mean));
            }
        }
    }
    if edges.len() as f64 > MOST_EDGES * typical {
        return Vec::new();
    }
    let reach = ((REACH * w.max(h) as f64).round() as usize).max(2);
    let near = around(&edges, (w, h), reach);
    let mut regions = grouped(&edges, &near, (w, h));
    regions.retain(|region| {
        let close = region.area.iter().filter(|&&i| near[i]).count();
        region.edges.len() >= MIN_EDGES
            && region.edges.len() as f64 >= MIN_DENSITY * close as f64
            && region.spread() >= MIN_SPREAD
            && region.area.len() as f64 <= MOST_AREA * (w * h) as f64
            && region.stillness_around(&lengths, &near, (w, h), 2 * reach) <= MOST_AROUND
    });
    regions
}

/// Pixels within `reach` of edges.
fn around(edges: &[Edge], (w, h): (usize, usize), reach: usize) -> Vec<bool> {
    let mut near = vec![false; w * h];
    for &(i, _) in edges {
        let (x, y) = (i % w, i / w);
        for row in y.saturating_sub(reach)..(y + reach + 1).min(h) {
            near[row * w + x.saturating_sub(reach)..row * w + (x + reach + 1).min(w)].fill(true);
        }
    }
    near
}

/// Edges whose surroundings `near` touch, with the area that they enclose.
fn grouped(edges: &[Edge], near: &[bool], (w, h): (usize, usize)) -> Vec<Region> {
    let (labels, count) = components(near, (w, h));
    let mut all: Vec<Vec<Edge>> = vec![Vec::new(); count];
    for &edge in edges {
        all[labels[edge.0]].push(edge);
    }
    let mut areas: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (i, &label) in labels.iter().enumerate() {
        if near[i] {
            areas[label].push(i);
        }
    }
    // What is not near an edge and does not reach the border lies within an overlay.
    let outside: Vec<bool> = near.iter().map(|&n| !n).collect();
    let (holes, n_holes) = components(&outside, (w, h));
    let mut around: Vec<Option<usize>> = vec![None; n_holes];
    let mut inside = vec![true; n_holes];
    for i in (0..w * h).filter(|&i| outside[i]) {
        let (x, y) = (i % w, i / w);
        if x == 0 || y == 0 || x == w - 1 || y == h - 1 {
            inside[holes[i]] = false;
        } else if near[i - 1] {
            around[holes[i]].get_or_insert(labels[i - 1]);
        }
    }
    for i in (0..w * h).filter(|&i| outside[i] && inside[holes[i]]) {
        if let Some(label) = around[holes[i]] {
            areas[label].push(i);
        }
    }
    all.into_iter()
        .zip(areas)
        .map(|(edges, area)| Region { edges, area })
        .collect()
}

/// Numbers the connected parts of the true pixels; the numbers of others mean nothing.
fn components(map: &[bool], (w, h): (usize, usize)) -> (Vec<usize>, usize) {
    const NONE: usize = usize::MAX;
    let (mut labels, mut count) = (vec![NONE; w * h], 0);
    let mut open = Vec::new();
    for start in 0..w * h {
        if !map[start] || labels[start] != NONE {
            continue;
        }
        labels[start] = count;
        open.push(start);
        while let Some(i) = open.pop() {
            let (x, y) = (i % w, i / w);
            let next = [
                (x > 0).then(|| i - 1),
                (x + 1 < w).then(|| i + 1),
                (y > 0).then(|| i - w),
                (y + 1 < h).then(|| i + w),
            ];
            for j in next.into_iter().flatten() {
                if map[j] && labels[j] == NONE {
                    labels[j] = count;
                    open.push(j);
                }
            }
        }
        count += 1;
    }
    (labels, count)
}

impl Region {
    fn is_in(&self, image: &Plane<u8>) -> bool {
        let still = self
            .edges
            .iter()
            .filter(|(i, mean)| same(gradient(image, *i), *mean));
        still.count() as f64 >= IN_PIXELS * self.edges.len() as f64
    }

    /// The length of the mean gradients over the mean length of gradients, of the pixels within
    /// `reach` of the area that are not near edges that hold still.
    fn stillness_around(
        &self,
        lengths: &[Lengths],
        near: &[bool],
        (w, h): (usize, usize),
        reach: usize,
    ) -> f32 {
        let edges: Vec<Edge> = self.area.iter().map(|&i| (i, [0.0; 2])).collect();
        let mut ring = around(&edges, (w, h), reach);
        for &i in &self.area {
            ring[i] = false;
        }
        let pixels = (0..w * h).filter(|&i| ring[i] && !near[i]);
        let [of_mean, mean] = pixels.fold([0.0_f32; 2], |sum, i| {
            [sum[0] + lengths[i][0], sum[1] + lengths[i][1]]
        });
        of_mean / mean.max(1e-6)
    }

    /// How evenly the gradients spread over directions, 0 to 1.
    fn spread(&self) -> f32 {
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (_, [x, y]) in &self.edges {
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        }
        let (mean, half) = (
            0.5 * (xx + yy),
            (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt(),
        );
        (mean - half) / (mean + half).max(1e-6)
    }
}
