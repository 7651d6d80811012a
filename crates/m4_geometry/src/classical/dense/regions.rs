//! Connected parts of a mask, and exact Euclidean distances in it.

/// Connected parts (by edges and corners) of the pixels above 0.
pub(crate) struct Components {
    /// `[height][width]`: 0 outside, else one plus the index of the part.
    pub label: Vec<u32>,
    /// Pixels of each part, in order of rows.
    pub pixels: Vec<Vec<u32>>,
}

impl Components {
    pub fn of(width: usize, height: usize, mask: &[u8]) -> Self {
        let mut out = Self {
            label: vec![0; width * height],
            pixels: Vec::new(),
        };
        let mut open = Vec::new();
        for seed in 0..width * height {
            if mask[seed] == 0 || out.label[seed] != 0 {
                continue;
            }
            let label = out.pixels.len() as u32 + 1;
            let mut pixels = Vec::new();
            out.label[seed] = label;
            open.push(seed);
            while let Some(i) = open.pop() {
                pixels.push(i as u32);
                let (x, y) = (i % width, i / width);
                for ny in y.saturating_sub(1)..(y + 2).min(height) {
                    for nx in x.saturating_sub(1)..(x + 2).min(width) {
                        let n = ny * width + nx;
                        if mask[n] != 0 && out.label[n] == 0 {
                            out.label[n] = label;
                            open.push(n);
                        }
                    }
                }
            }
            pixels.sort_unstable();
            out.pixels.push(pixels);
        }
        out
    }
}

/// Clears parts of fewer than `least` pixels, and fills holes of fewer.
pub(super) fn clean(width: usize, height: usize, mask: &mut [u8], least: usize) {
    for value in [255u8, 0] {
        let part: Vec<u8> = mask
            .iter()
            .map(|&m| if m == value { 255 } else { 0 })
            .collect();
        for pixels in Components::of(width, height, &part).pixels {
            if pixels.len() < least {
                for i in pixels {
                    mask[i as usize] = 255 - value;
                }
            }
        }
    }
}

/// For each pixel of the set its distance to the nearest pixel outside of the set, in pixels; 0
/// outside. Where there is no outside, the distance is larger than the image. Felzenszwalb and
/// Huttenlocher, "Distance Transforms of Sampled Functions" (2012).
pub(crate) fn to_outside(width: usize, height: usize, inside: impl Fn(usize) -> bool) -> Vec<f32> {
    let far = ((width + height) * (width + height)) as f32;
    let mut squared: Vec<f32> = (0..width * height)
        .map(|p| if inside(p) { far } else { 0.0 })
        .collect();
    let mut line = Envelope::default();
    let mut column = vec![0.0; height];
    for x in 0..width {
        for (y, value) in column.iter_mut().enumerate() {
            *value = squared[y * width + x];
        }
        line.transform(&column, |y, d| squared[y * width + x] = d);
    }
    let mut row = vec![0.0; width];
    for y in 0..height {
        row.copy_from_slice(&squared[y * width..(y + 1) * width]);
        line.transform(&row, |x, d| squared[y * width + x] = d);
    }
    for d in &mut squared {
        *d = d.sqrt();
    }
    squared
}

/// The lower envelope of parabolas over one line.
#[derive(Default)]
struct Envelope {
    /// Where the parabolas of the envelope have their feet.
    foot: Vec<usize>,
    /// From where on each of them is the lowest.
    from: Vec<f32>,
}

impl Envelope {
    /// Hands out, for each place `i`, the least of `(i - j)^2 + heights[j]` over all `j`.
    fn transform(&mut self, heights: &[f32], mut put: impl FnMut(usize, f32)) {
        self.foot.clear();
        self.from.clear();
        let above = |j: usize| heights[j] + (j * j) as f32;
        for j in 0..heights.len() {
            let mut start = f32::NEG_INFINITY;
            while let (Some(&k), Some(&from)) = (self.foot.last(), self.from.last()) {
                start = (above(j) - above(k)) / (2 * (j - k)) as f32;
                if start > from {
                    break;
                }
                self.foot.pop();
                self.from.pop();
                start = f32::NEG_INFINITY;
            }
            self.foot.push(j);
            self.from.push(start);
        }
        let mut k = 0;
        for i in 0..heights.len() {
            while self.from.get(k + 1).is_some_and(|&from| from < i as f32) {
                k += 1;
            }
            let j = self.foot[k];
            let d = i.abs_diff(j);
            put(i, (d * d) as f32 + heights[j]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Components, clean, to_outside};
    use m4_core::CounterRng;

    #[test]
    fn diagonal_neighbours_are_one_part() {
        let mask = [255, 0, 0, 0, 0, 255, 0, 255, 0, 0, 0, 255];
        let parts = Components::of(4, 3, &mask);
        assert_eq!(parts.pixels, vec![vec![0, 5], vec![7, 11]]);
        assert_eq!(parts.label[5], 1);
    }

    #[test]
    fn specks_go_and_holes_close() {
        let (w, h) = (12, 12);
        let square = |p: usize| (2..9).contains(&(p % w)) && (2..9).contains(&(p / w));
        let mut mask: Vec<u8> = (0..w * h)
            .map(|p| if square(p) { 255 } else { 0 })
            .collect();
        mask[5 * w + 5] = 0;
        mask[11 * w + 11] = 255;
        clean(w, h, &mut mask, 4);
        assert_eq!(mask.iter().filter(|&&m| m == 255).count(), 49);
    }

    #[test]
    fn distances_are_those_to_the_nearest_pixel_outside() {
        let (w, h) = (37, 23);
        let mut rng = CounterRng::new(3, 1, 4);
        let set: Vec<bool> = (0..w * h).map(|_| rng.below(12) > 0).collect();
        let actual = to_outside(w, h, |p| set[p]);
        let outside: Vec<usize> = (0..w * h).filter(|&p| !set[p]).collect();
        let mut largest = 0.0f32;
        for p in 0..w * h {
            let squared =
                |q: usize| (p % w).abs_diff(q % w).pow(2) + (p / w).abs_diff(q / w).pow(2);
            let least = outside.iter().map(|&q| squared(q)).min().unwrap();
            assert_eq!(actual[p], (least as f32).sqrt(), "pixel {p}");
            largest = largest.max(actual[p]);
        }
        assert!(largest > 3.0, "{largest}");
    }

    #[test]
    fn a_set_without_an_outside_is_deep_everywhere() {
        assert!(to_outside(5, 4, |_| true).iter().all(|&d| d >= 9.0));
    }
}
