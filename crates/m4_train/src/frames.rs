//! The training frames at the size that an iteration wants.

use m4_kernels::photo::cpu::Target;
use m4_scene::{Capture, CaptureFrame, DepthMap, Intrinsics, RgbImage};
use rayon::prelude::*;

/// A frame of the capture, and what the trainer keeps of it.
#[derive(Debug)]
struct Stored<'a> {
    frame: &'a CaptureFrame,
    cached: Option<Prepared>,
}

/// What is made of a frame.
#[derive(Debug, Default)]
struct Prepared {
    target: Target,
    /// Empty when the frame has none, or its own has the right size.
    depth: Vec<f32>,
}

/// A frame ready for the loss.
#[derive(Debug)]
pub(crate) struct FrameView<'a> {
    /// The picture.
    pub target: &'a Target,
    /// z-depth at the size of the picture, 0 or not finite where unknown; empty when the frame has none.
    pub depth: &'a [f32],
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
    pub fn get(&mut self, i: usize, factor: usize) -> FrameView<'_> {
        if factor != self.factor {
            self.frames.iter_mut().for_each(|f| f.cached = None);
            (self.factor, self.used, self.spare_of) = (factor, 0, None);
        }
        let frame = self.frames[i].frame;
        if self.frames[i].cached.is_none() && self.spare_of != Some(i) {
            let bytes = bytes(frame, factor);
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
        let prepared = self.frames[i].cached.as_ref().unwrap_or(&self.spare);
        FrameView {
            target: &prepared.target,
            depth: match own_depth(frame, factor) {
                Some(depth) => depth.data(),
                None => &prepared.depth,
            },
        }
    }
}

/// The frame's depth if it has the size of the picture already.
fn own_depth(frame: &CaptureFrame, factor: usize) -> Option<&DepthMap> {
    let (width, height) = frame.rgb.size();
    let depth = frame.depth.as_ref();
    depth.filter(|depth| depth.size() == (width / factor, height / factor))
}

/// What a prepared frame takes: a byte a colour (two where bytes are added up), and the depth.
fn bytes(frame: &CaptureFrame, factor: usize) -> usize {
    let (width, height) = frame.rgb.size();
    let colours = if factor == 1 { 3 } else { 6 };
    let has_depth = frame.depth.is_some() && own_depth(frame, factor).is_none();
    (colours + if has_depth { 4 } else { 0 }) * (width / factor) * (height / factor)
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
    if factor == 1 {
        out.target
            .replace(w, h, |planes| by_rows(w, planes, |y, row| split(frame.rgb.row(y), row)));
    } else {
        out.target.replace_sums(w, h, factor * factor, |planes| {
            by_rows(w, planes, |y, row| add_up(&frame.rgb, factor, y, row));
        });
    }
    out.depth.clear();
    let Some(depth) = &frame.depth else { return };
    if own_depth(frame, factor).is_some() {
        return;
    }
    // The nearest sample: blends of two surfaces lie on neither.
    let (dw, dh) = depth.size();
    let at = |i: usize, n: usize, full: usize| {
        let centre = (i as f64 + 0.5) * factor as f64 * n as f64 / full as f64;
        (centre as usize).min(n - 1)
    };
    let columns: Vec<usize> = (0..w).map(|x| at(x, dw, full_w)).collect();
    out.depth.resize(w * h, 0.0);
    out.depth.par_chunks_mut(w.max(1)).enumerate().for_each(|(y, row)| {
        let from = depth.row(at(y, dh, full_h));
        row.iter_mut().zip(&columns).for_each(|(z, &x)| *z = from[x]);
    });
}

/// Calls `fill` with each row of three planes of `width` columns.
fn by_rows<T: Send>(width: usize, planes: [&mut [T]; 3], fill: impl Fn(usize, [&mut [T]; 3]) + Sync) {
    let [red, green, blue] = planes.map(|plane| plane.par_chunks_mut(width.max(1)));
    let rows = red.zip(green).zip(blue).enumerate();
    rows.for_each(|(y, ((red, green), blue))| fill(y, [red, green, blue]));
}

/// A row of a picture, one plane a channel.
fn split(pixels: &[[u8; 3]], [red, green, blue]: [&mut [u8]; 3]) {
    for (((r, g), b), pixel) in red.iter_mut().zip(green).zip(blue).zip(pixels) {
        [*r, *g, *b] = *pixel;
    }
}

/// Row `y` of a picture whose sides are divided by `factor`: sums over whole blocks of pixels.
fn add_up(picture: &RgbImage, factor: usize, y: usize, [red, green, blue]: [&mut [u16]; 3]) {
    for (x, ((r, g), b)) in red.iter_mut().zip(green).zip(blue).enumerate() {
        // at most 4 x 4 bytes
        let mut sum = [0u16; 3];
        for dy in 0..factor {
            for pixel in &picture.row(y * factor + dy)[x * factor..(x + 1) * factor] {
                sum.iter_mut().zip(pixel).for_each(|(sum, &v)| *sum += u16::from(v));
            }
        }
        [*r, *g, *b] = sum;
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
