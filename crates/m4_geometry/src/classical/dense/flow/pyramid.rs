//! Images at halving sizes with a border, so that patches may hang over the edge.

/// Pixels of replicated border on every side: a patch may leave the image by this much.
pub(super) const BORDER: usize = 16;

/// One image with its gradient.
#[derive(Debug, Clone)]
pub(super) struct Level {
    pub width: usize,
    pub height: usize,
    /// `[height][width]`, 0..255.
    pub image: Vec<f32>,
    /// `[height + 2 BORDER][width + 2 BORDER]`.
    pub padded: Vec<f32>,
    /// `[height][width]`: central differences.
    pub dx: Vec<f32>,
    /// `[height][width]`.
    pub dy: Vec<f32>,
}

/// Finest first.
#[derive(Debug, Clone)]
pub(crate) struct Pyramid {
    pub(super) levels: Vec<Level>,
}

impl Pyramid {
    /// Halves the image until its shorter side is below 24 px.
    pub fn new(width: usize, height: usize, image: &[f32]) -> Self {
        let mut levels = vec![Level::new(width, height, smooth(width, height, image))];
        while let Some(last) = levels.last() {
            let (w, h) = (last.width / 2, last.height / 2);
            if w.min(h) < 12 {
                break;
            }
            let mut half = vec![0.0; w * h];
            for y in 0..h {
                for x in 0..w {
                    let i = 2 * y * last.width + 2 * x;
                    let p = &last.image;
                    half[y * w + x] = 0.25 * (p[i] + p[i + 1] + p[i + last.width] + p[i + last.width + 1]);
                }
            }
            levels.push(Level::new(w, h, half));
        }
        Self { levels }
    }
}

/// A 1-6-1 blur each way: enough to make central differences meaningful.
fn smooth(width: usize, height: usize, image: &[f32]) -> Vec<f32> {
    let pass = |source: &[f32], step: usize, at: &dyn Fn(usize) -> (usize, usize)| -> Vec<f32> {
        (0..source.len())
            .map(|i| {
                let (position, n) = at(i);
                let before = if position > 0 { source[i - step] } else { source[i] };
                let after = if position + 1 < n { source[i + step] } else { source[i] };
                0.125 * (before + after) + 0.75 * source[i]
            })
            .collect()
    };
    let rows = pass(image, 1, &|i| (i % width, width));
    pass(&rows, width, &|i| (i / width, height))
}

impl Level {
    fn new(width: usize, height: usize, image: Vec<f32>) -> Self {
        let padded_width = width + 2 * BORDER;
        let mut padded = vec![0.0; padded_width * (height + 2 * BORDER)];
        for (y, row) in padded.chunks_exact_mut(padded_width).enumerate() {
            let source = y.saturating_sub(BORDER).min(height - 1) * width;
            let source = &image[source..source + width];
            row[..BORDER].fill(source[0]);
            row[BORDER..BORDER + width].copy_from_slice(source);
            row[BORDER + width..].fill(source[width - 1]);
        }
        let (dx, dy) = gradient(width, height, &image);
        Self { width, height, image, padded, dx, dy }
    }
}

/// Central differences, one-sided halves at the edge.
pub(super) fn gradient(width: usize, height: usize, image: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let (mut dx, mut dy) = (vec![0.0; image.len()], vec![0.0; image.len()]);
    for y in 0..height {
        let (above, below) = (y.saturating_sub(1) * width, (y + 1).min(height - 1) * width);
        let row = y * width;
        for x in 0..width {
            dx[row + x] = 0.5 * (image[row + (x + 1).min(width - 1)] - image[row + x.saturating_sub(1)]);
            dy[row + x] = 0.5 * (image[below + x] - image[above + x]);
        }
    }
    (dx, dy)
}
