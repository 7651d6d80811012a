//! The training frames at the size that an iteration wants.

use m4_kernels::photo::cpu::Target;
use m4_scene::{Capture, CaptureFrame, Intrinsics, RgbImage};
use rayon::prelude::*;

/// A frame of the capture, and what the trainer keeps of it.
#[derive(Debug)]
struct Stored<'a> {
    frame: &'a CaptureFrame,
    cached: Option<Prepared>,
}

/// A frame ready for the loss.
#[derive(Debug, Default)]
pub(crate) struct Prepared {
    /// The picture.
    pub target: Target,
    /// z-depth at the size of the picture, 0 where unknown; empty when the frame has none.
    pub depth: Vec<f32>,
}

/// All frames, and as many prepared ones as fit the budget.
#[derive(Debug)]
pub(crate) struct FrameStore<'a> {
    frames: Vec<Stored<'a>>,
    factor: usize,
    budget: usize,
    used: usize,
    /// The frame prepared last that did not fit; its memory is used again for the next.
    spare: Prepared,
    spare_of: Option<usize>,
}

impl<'a> FrameStore<'a> {
    pub fn new(capture: &'a Capture, budget_mb: usize) -> Self {
        let frames = capture.frames.iter().map(|frame| Stored { frame, cached: None });
        Self {
            frames: frames.collect(),
            factor: 1,
            budget: budget_mb * 1_000_000,
            used: 0,
            spare: Prepared::default(),
            spare_of: None,
        }
    }

    /// Frame `i`, each side divided by `factor`.
    pub fn get(&mut self, i: usize, factor: usize) -> &Prepared {
        if factor != self.factor {
            self.frames.iter_mut().for_each(|f| f.cached = None);
            (self.factor, self.used, self.spare_of) = (factor, 0, None);
        }
        let frame = self.frames[i].frame;
        if self.frames[i].cached.is_none() && self.spare_of != Some(i) {
            let (width, height) = frame.rgb.size();
            // colours, windowed means and variances, depth
            let bytes = 10 * 4 * (width / factor) * (height / factor);
            if self.used + bytes <= self.budget {
                self.used += bytes;
                let mut prepared = Prepared::default();
                prepare(frame, factor, &mut prepared);
                self.frames[i].cached = Some(prepared);
            } else {
                prepare(frame, factor, &mut self.spare);
                self.spare_of = Some(i);
            }
        }
        self.frames[i].cached.as_ref().unwrap_or(&self.spare)
    }
}

/// The lens for frames whose sides are divided by `factor`; what does not divide is cut off at the
/// right and the bottom.
pub(crate) fn smaller(k: &Intrinsics, factor: usize) -> Intrinsics {
    let f = factor as f64;
    Intrinsics {
        width: k.width / factor,
        height: k.height / factor,
        fx: k.fx / f,
        fy: k.fy / f,
        cx: k.cx / f,
        cy: k.cy / f,
    }
}

fn prepare(frame: &CaptureFrame, factor: usize, out: &mut Prepared) {
    let (full_w, full_h) = frame.rgb.size();
    let (w, h) = (full_w / factor, full_h / factor);
    let size = w.max(1);
    out.target.replace(w, h, |[red, green, blue]| {
        let rows = red.par_chunks_mut(size).zip(green.par_chunks_mut(size));
        rows.zip(blue.par_chunks_mut(size))
            .enumerate()
            .for_each(|(y, ((red, green), blue))| colours(&frame.rgb, factor, y, [red, green, blue]));
    });
    let Some(depth) = &frame.depth else {
        out.depth.clear();
        return;
    };
    // The nearest sample: blends of two surfaces lie on neither.
    let (dw, dh) = depth.size();
    let at = |i: usize, n: usize, full: usize| {
        let centre = (i as f64 + 0.5) * factor as f64 * n as f64 / full as f64;
        (centre as usize).min(n - 1)
    };
    let columns: Vec<usize> = (0..w).map(|x| at(x, dw, full_w)).collect();
    out.depth.resize(w * h, 0.0);
    out.depth.par_chunks_mut(size).enumerate().for_each(|(y, row)| {
        let from = depth.row(at(y, dh, full_h));
        for (z, &x) in row.iter_mut().zip(&columns) {
            *z = if from[x].is_finite() && from[x] > 0.0 {
                from[x]
            } else {
                0.0
            };
        }
    });
}

/// Row `y` of the picture whose sides are divided by `factor`: means of whole blocks of pixels, 0..1.
fn colours(picture: &RgbImage, factor: usize, y: usize, planes: [&mut [f32]; 3]) {
    let [red, green, blue] = planes;
    let scale = 1.0 / (255.0 * (factor * factor) as f32);
    let pixels = red.iter_mut().zip(green).zip(blue).enumerate();
    if factor == 1 {
        for ((_, ((r, g), b)), p) in pixels.zip(picture.row(y)) {
            [*r, *g, *b] = p.map(|v| f32::from(v) * scale);
        }
        return;
    }
    for (x, ((r, g), b)) in pixels {
        let mut sum = [0u32; 3];
        for dy in 0..factor {
            for p in &picture.row(y * factor + dy)[x * factor..(x + 1) * factor] {
                for c in 0..3 {
                    sum[c] += u32::from(p[c]);
                }
            }
        }
        [*r, *g, *b] = sum.map(|v| v as f32 * scale);
    }
}

#[cfg(test)]
mod tests {
    use super::FrameStore;
    use m4_math::Se3;
    use m4_scene::{Camera, Capture, CaptureFrame, Intrinsics, Plane};

    fn capture() -> Capture {
        let frame = |i: usize| CaptureFrame {
            name: i.to_string(),
            camera: Camera {
                intrinsics: Intrinsics::centred(5, 4, 5.0),
                c2w: Se3::identity(),
            },
            t: i as f64,
            rgb: Plane::from_fn(5, 4, |x, y| [(x * 10) as u8, (y * 20) as u8, i as u8]),
            depth: Some(Plane::from_fn(10, 8, |x, _| if x == 0 { f32::NAN } else { x as f32 })),
            mask: None,
            camera_index: None,
        };
        Capture {
            frames: (0..3).map(frame).collect(),
            time_frames: 3,
            duration_s: None,
            metric: false,
        }
    }

    #[test]
    fn half_size_is_the_mean_of_four() {
        let capture = capture();
        let mut store = FrameStore::new(&capture, 100);
        let half = store.get(1, 2);
        assert_eq!((half.target.width(), half.target.height()), (2, 2));
        let close = |got: f32, want: f32| (got - want / 255.0).abs() < 1e-6;
        assert!(close(half.target.rgb()[0][1], 25.0) && close(half.target.rgb()[1][2], 50.0));
        assert_eq!(half.depth, [2.0, 6.0, 2.0, 6.0]);
        let full = store.get(1, 1);
        assert_eq!(full.target.rgb()[0].len(), 20);
        assert_eq!(full.depth[0], 1.0);
    }

    #[test]
    fn frames_beyond_the_budget_are_prepared_anew() {
        let capture = capture();
        let mut store = FrameStore::new(&capture, 0);
        for i in [0, 1, 2, 1, 1] {
            let blue = store.get(i, 1).target.rgb()[2][0];
            assert!((blue * 255.0 - i as f32).abs() < 1e-4);
        }
    }
}
