//! Connected parts of a mask.

/// Connected parts (by edges and corners) of the pixels above 0.
pub(crate) struct Components {
    /// `[height][width]`: 0 outside, else one plus the index of the part.
    pub label: Vec<u32>,
    /// Pixels of each part, in order of rows.
    pub pixels: Vec<Vec<u32>>,
}

impl Components {
    pub fn of(width: usize, height: usize, mask: &[u8]) -> Self {
        let mut out = Self { label: vec![0; width * height], pixels: Vec::new() };
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
        let part: Vec<u8> = mask.iter().map(|&m| if m == value { 255 } else { 0 }).collect();
        for pixels in Components::of(width, height, &part).pixels {
            if pixels.len() < least {
                for i in pixels {
                    mask[i as usize] = 255 - value;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Components, clean};

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
        let mut mask = vec![0u8; w * h];
        for y in 2..9 {
            for x in 2..9 {
                mask[y * w + x] = 255;
            }
        }
        mask[5 * w + 5] = 0;
        mask[11 * w + 11] = 255;
        clean(w, h, &mut mask, 4);
        assert_eq!(mask.iter().filter(|&&m| m == 255).count(), 49);
    }
}
