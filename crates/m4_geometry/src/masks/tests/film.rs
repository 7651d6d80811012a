//! A clip whose things are known.

use crate::classical::dense::{SegmentMask, SegmentPrompt, SourceError};
use crate::masks::{Coarse, Refined};
use m4_core::{CompactMask, Plane, RgbImage};

pub const SIZE: (usize, usize) = (160, 120);
pub const FRAMES: usize = 30;

/// From where on the coarse masks show the late thing, and from where on the images do.
pub const LATE_COARSE: usize = 9;
pub const LATE_SEEN: usize = 5;
/// The static thing is in the coarse masks of the first frames.
pub const REST_COARSE: usize = 1;
/// What is in the coarse mask of this frame only.
pub const FLICKER: usize = 20;

/// Column and row of where a thing is in frame `i`.
fn walker(i: usize) -> (f32, f32) {
    (36.0 + 2.6 * i as f32, 34.0 + 4.0 * (0.4 * i as f32).sin())
}

fn late(i: usize) -> (f32, f32) {
    // It comes in from the right.
    (172.0 - 3.0 * i as f32 + 3.0 * LATE_SEEN as f32 - 4.0, 92.0)
}

fn leaver(i: usize) -> (f32, f32) {
    (44.0 - 4.0 * i as f32, 88.0)
}

const REST: (f32, f32) = (125.0, 25.0);
const GHOST: (f32, f32) = (80.0, 66.0);

fn disc(x: usize, y: usize, at: (f32, f32), radius: f32) -> bool {
    (x as f32 - at.0).hypot(y as f32 - at.1) < radius
}

fn block(x: usize, y: usize, at: (f32, f32), half: f32) -> bool {
    (x as f32 - at.0).abs() < half && (y as f32 - at.1).abs() < half
}

/// 1 the walker, 2 what comes late, 3 what leaves, 4 the static thing, 0 the background.
pub fn thing_at(x: usize, y: usize, i: usize) -> u8 {
    if disc(x, y, walker(i), 14.0) {
        1
    } else if i >= LATE_SEEN && block(x, y, late(i), 12.0) {
        2
    } else if disc(x, y, leaver(i), 12.0) {
        3
    } else if block(x, y, REST, 9.0) {
        4
    } else {
        0
    }
}

/// A pattern of many lengths, 0 to 1.
fn pattern(x: f32, y: f32) -> f32 {
    let wave = |k: u32| {
        let (length, turn) = (40.0 * 0.75f32.powi(k as i32), 2.4 * k as f32);
        let phase = (x * turn.cos() + y * turn.sin()) * std::f32::consts::TAU / length;
        length.sqrt() * (phase + 1.7 * k as f32).sin()
    };
    (0.5 + 0.025 * (0..7).map(wave).sum::<f32>()).clamp(0.0, 1.0)
}

/// The image: each thing in a hue of its own and with a pattern that goes along.
pub fn image(i: usize) -> RgbImage {
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
        let with = |at: (f32, f32)| {
            (60.0 + 90.0 * pattern(1.4 * (x as f32 - at.0) + 300.0, 1.4 * (y as f32 - at.1))) as u8
        };
        match thing_at(x, y, i) {
            1 => [250, with(walker(i)), 40],
            2 => [40, with(late(i)), 250],
            3 => [with(leaver(i)), 250, 40],
            4 => [250, with(REST), 250],
            _ => {
                let v = (40.0 + 130.0 * pattern(x as f32, y as f32)) as u8;
                [v, v, v]
            }
        }
    })
}

pub fn images() -> Vec<RgbImage> {
    (0..FRAMES).map(image).collect()
}

pub fn truth(i: usize) -> CompactMask {
    CompactMask::from_fn(SIZE.0, SIZE.1, |x, y| (1..=3).contains(&thing_at(x, y, i)))
}

/// Whether the coarse mask has the pixel: things too wide and shifted, the static thing for a
/// moment, and a ghost.
fn coarse_at(x: usize, y: usize, i: usize) -> bool {
    let moved = |at: (f32, f32)| (at.0 + 3.0, at.1 + 2.0);
    disc(x, y, moved(walker(i)), 16.0)
        || i >= LATE_COARSE && block(x, y, moved(late(i)), 13.0)
        || disc(x, y, moved(leaver(i)), 13.0)
        || i <= REST_COARSE && block(x, y, REST, 8.0)
        || i == FLICKER && block(x, y, GHOST, 7.0)
}

pub fn coarse_masks() -> Vec<CompactMask> {
    (0..FRAMES)
        .map(|i| CompactMask::from_fn(SIZE.0, SIZE.1, |x, y| coarse_at(x, y, i)))
        .collect()
}

/// Maps of a quarter of the size: how much of each 4 x 4 pixels is coarse.
pub fn motion_maps() -> Vec<Plane<u8>> {
    let map = |i: usize| {
        Plane::from_fn(SIZE.0 / 4, SIZE.1 / 4, |x, y| {
            let inside = (0..16)
                .filter(|k| coarse_at(4 * x + k % 4, 4 * y + k / 4, i))
                .count();
            (15 + 14 * inside) as u8
        })
    };
    (0..FRAMES).map(map).collect()
}

/// Mean intersection over union with the truth.
pub fn iou(masks: impl Iterator<Item = CompactMask>) -> f64 {
    let (mut both, mut any) = (0usize, 0usize);
    for (i, mask) in masks.enumerate() {
        let truth = truth(i);
        let common = mask.set_pixels().filter(|&(x, y)| truth.at(x, y)).count();
        both += common;
        any += mask.count() + truth.count() - common;
    }
    both as f64 / any as f64
}

pub fn iou_of(refined: &Refined) -> f64 {
    iou(refined.frames.iter().map(|f| f.mask.clone()))
}

pub fn as_motion(maps: &[Plane<u8>]) -> Coarse<'_> {
    Coarse::Motion(maps.iter().collect())
}

pub fn as_masks(masks: &[CompactMask]) -> Coarse<'_> {
    Coarse::Masks(masks.iter().collect())
}

fn hue(c: [u8; 3]) -> [i32; 3] {
    let c = c.map(i32::from);
    let grey = c.iter().max().unwrap() - c.iter().min().unwrap() < 20;
    if grey {
        [0; 3]
    } else {
        c.map(|v| {
            if v > 240 {
                2
            } else if v < 50 {
                1
            } else {
                0
            }
        })
    }
}

/// Takes everything of the hue at the prompt's first point for the thing.
pub fn hues(
    image: &RgbImage,
    size: (usize, usize),
    prompts: &[SegmentPrompt],
) -> Result<Vec<SegmentMask>, SourceError> {
    assert_eq!(image.size(), size);
    let of = |prompt: &SegmentPrompt| {
        let [x, y] = prompt.points_px[0];
        let wanted = hue(image[(x as usize, y as usize)]);
        SegmentMask {
            logits: image
                .data()
                .iter()
                .map(|c| if hue(*c) == wanted { 3.0 } else { -3.0 })
                .collect(),
            quality: 0.9,
        }
    };
    Ok(prompts.iter().map(of).collect())
}

/// Grabs the background: all of it, or a corner of `corner_px` pixels a side.
pub fn grabbed(corner_px: usize, (w, h): (usize, usize), prompts: usize) -> Vec<SegmentMask> {
    let corner = |p: usize| p % w < corner_px && p / w < corner_px;
    let mask = SegmentMask {
        logits: (0..w * h)
            .map(|p| if corner(p) { 1.0 } else { -1.0 })
            .collect(),
        quality: 1.0,
    };
    vec![mask; prompts]
}
