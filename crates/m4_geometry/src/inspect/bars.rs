//! Bars at the borders: letterbox and pillarbox.

use m4_core::Plane;

/// A part of an image, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rectangle {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Rectangle {
    /// All of an image of `size`.
    #[must_use]
    pub fn whole((width, height): (usize, usize)) -> Self {
        Self {
            x: 0,
            y: 0,
            width,
            height,
        }
    }
}

/// A bar takes at least this share of the side of the image.
const MIN_SHARE: f64 = 0.02;
/// Most of a side that bars may take together: more is a dark image.
const MOST_SHARE: f64 = 0.8;
/// Pixels of a bar are this close to its luma, grey levels: noise of compression.
const TOLERANCE: f32 = 8.0;
/// A dark bar is no brighter, grey levels.
const DARK: f32 = 40.0;
/// Share of the pixels of a line, over all frames, that have the luma of the bar: of the outermost
/// line, of its worst (subtitles lie in bars), and at most beyond its edge.
const CLEAN: f64 = 0.97;
const WORST: f64 = 0.85;
const BEYOND: f64 = 0.75;
/// Share of the lines of a bar that are as clean as the outermost.
const CLEAN_LINES: f64 = 0.4;
/// The edge of a bar is at most this wide, share of the side, and at least two lines.
const EDGE_SHARE: f64 = 0.01;

/// The part of the images within their bars: lines at a border that have one constant luma in all
/// of them and end at a sharp edge. Dark ones, and bright ones that are alike on both sides (a sky
/// may be white from edge to edge).
///
/// `images` are luma in 0..=255, all of one size.
#[must_use]
pub fn bars(images: &[&Plane<f32>]) -> Rectangle {
    let Some(first) = images.first() else {
        return Rectangle::whole((0, 0));
    };
    let (w, h) = first.size();
    let rows: Vec<Vec<&[f32]>> = (0..h)
        .map(|y| images.iter().map(|image| image.row(y)).collect())
        .collect();
    let turned: Vec<Plane<f32>> = images
        .iter()
        .map(|image| Plane::from_fn(h, w, |x, y| image[(y, x)]))
        .collect();
    let columns: Vec<Vec<&[f32]>> = (0..w)
        .map(|x| turned.iter().map(|image| image.row(x)).collect())
        .collect();
    let (top, bottom) = both(&rows);
    let (left, right) = both(&columns);
    Rectangle {
        x: left,
        y: top,
        width: w - left - right,
        height: h - top - bottom,
    }
}

/// A bar from one side inwards.
#[derive(Clone, Copy)]
struct Bar {
    lines: usize,
    luma: f32,
}

/// Lines to cut off at both ends.
fn both(lines: &[Vec<&[f32]>]) -> (usize, usize) {
    let n = lines.len();
    let order: Vec<usize> = (0..n).collect();
    let reversed: Vec<usize> = (0..n).rev().collect();
    let bars = [bar(lines, &order), bar(lines, &reversed)];
    let dark = |bar: &Bar| bar.luma <= DARK;
    let kept = match bars {
        [Some(a), Some(b)] => {
            let alike = a.lines.abs_diff(b.lines) <= edge(n) && (a.luma - b.luma).abs() < TOLERANCE;
            bars.map(|bar| bar.filter(|bar| alike || dark(bar)))
        }
        _ => bars.map(|bar| bar.filter(dark)),
    };
    let [a, b] = kept.map(|bar| bar.map_or(0, |bar| bar.lines));
    if (a + b) as f64 > MOST_SHARE * n as f64 {
        return (0, 0);
    }
    (a, b)
}

fn edge(n: usize) -> usize {
    ((EDGE_SHARE * n as f64).round() as usize).max(2)
}

/// The bar that starts at the first line of `order`.
fn bar(lines: &[Vec<&[f32]>], order: &[usize]) -> Option<Bar> {
    let outermost: Vec<f32> = lines.get(*order.first()?)?.concat();
    let luma = super::quantile(&outermost, 0.5);
    let share = |&i: &usize| {
        let like = |v: &&f32| (**v - luma).abs() <= TOLERANCE;
        let all: usize = lines[i].iter().map(|line| line.len()).sum();
        let n: usize = lines[i]
            .iter()
            .map(|line| line.iter().filter(like).count())
            .sum();
        n as f64 / all.max(1) as f64
    };
    let shares: Vec<f64> = order.iter().map(share).collect();
    let count = shares.iter().take_while(|&&s| s >= WORST).count();
    let clean = shares[..count].iter().filter(|&&s| s >= CLEAN).count();
    let beyond = shares[count..].iter().take(edge(lines.len()));
    let sharp = beyond.fold(1.0, |least: f64, &s| least.min(s)) <= BEYOND;
    let wide = count as f64 >= MIN_SHARE * lines.len() as f64;
    let even = clean as f64 >= CLEAN_LINES * count as f64 && *shares.first()? >= CLEAN;
    // A line that the edge runs through is neither.
    let blurred = shares.get(count).is_some_and(|&s| s > BEYOND);
    (sharp && wide && even).then_some(Bar {
        lines: count + usize::from(blurred),
        luma,
    })
}

#[cfg(test)]
mod tests {
    use super::{Rectangle, bars};
    use m4_core::{CounterRng, Plane};

    /// Frames of a moving texture with what `over` puts on them, and noise.
    fn frames(over: impl Fn(usize, usize, f32) -> f32) -> Rectangle {
        let frame = |t: usize| {
            let mut rng = CounterRng::new(3, 0, t as u64);
            Plane::from_fn(160, 90, |x, y| {
                let (u, v) = (x as f32 + 3.0 * t as f32, y as f32 + t as f32);
                let scene = 110.0 + 70.0 * (0.21 * u).sin() * (0.17 * v).cos();
                over(x, y, scene) + 1.5 * rng.normal() as f32
            })
        };
        let frames: Vec<Plane<f32>> = (0..12).map(frame).collect();
        bars(&frames.iter().collect::<Vec<_>>())
    }

    #[test]
    fn bars_are_cut_off_to_the_line() {
        let box_of = |x, y, width, height| Rectangle {
            x,
            y,
            width,
            height,
        };
        let letterbox = |_, y, v| if (10..80).contains(&y) { v } else { 16.0 };
        assert_eq!(frames(letterbox), box_of(0, 10, 160, 70));
        let pillarbox = |x, _, v| if (31..130).contains(&x) { v } else { 0.0 };
        assert_eq!(frames(pillarbox), box_of(31, 0, 99, 90));
        let below = |_, y, v| if y < 78 { v } else { 20.0 };
        assert_eq!(frames(below), box_of(0, 0, 160, 78));
        let white = |_, y, v| if (10..80).contains(&y) { v } else { 250.0 };
        assert_eq!(frames(white), box_of(0, 10, 160, 70));
        let subtitled = |x: usize, y, v| match y {
            80.. if (60..90).contains(&x) && x % 4 < 2 && (83..88).contains(&y) => 220.0,
            10..80 => v,
            _ => 16.0,
        };
        assert_eq!(frames(subtitled), box_of(0, 10, 160, 70));
    }

    #[test]
    fn scenes_keep_their_borders() {
        let whole = Rectangle::whole((160, 90));
        assert_eq!(frames(|_, _, v| v), whole);
        // A night sky that ends at a skyline, a white sky on one side, darkness all over.
        let skyline = |x: usize| 20 + (x * 7 % 13) + x / 8;
        let night = move |x, y, v| if y < skyline(x) { 12.0 } else { v };
        assert_eq!(frames(night), whole);
        let white = |_, y, v| if y < 20 { 255.0 } else { v };
        assert_eq!(frames(white), whole);
        assert_eq!(frames(|_, _, _| 10.0), whole);
    }
}
