//! The training frames at the size that an iteration wants.

use m4_kernels::photo::cpu::Target;
use m4_scene::{Capture, CaptureFrame, CompactDepth, Intrinsics, RgbImage};
use rayon::prelude::*;

/// Rows of depth that one task makes at least.
const ROWS: usize = 32;

/// A frame of the capture, and what the trainer keeps of it.
#[derive(Debug)]
struct Stored<'a> {
    frame: &'a CaptureFrame,
    cached: Option<Target>,
}

/// All frames, and as many prepared pictures as fit the budget.
///
/// Depth is made of what the capture holds where it is asked for, which spares the four bytes a pixel of keeping it.
#[derive(Debug)]
pub(crate) struct FrameStore<'a> {
    frames: Vec<Stored<'a>>,
    factor: usize,
    budget: usize,
    used: usize,
    /// The picture prepared last that did not fit; its memory is used again for the next.
    spare: Target,
    spare_of: Option<usize>,
    /// Depth of the frame asked for last; empty when it has none.
    depth: Vec<f32>,
    depth_of: Option<usize>,
}

impl<'a> FrameStore<'a> {
    pub fn new(capture: &'a Capture, budget_mb: usize) -> Self {
        let frames = capture.frames.iter().map(|frame| Stored { frame, cached: None });
        Self {
            frames: frames.collect(),
            factor: 1,
            budget: budget_mb * 1_000_000,
            used: 0,
            spare: Target::default(),
            spare_of: None,
            depth: Vec::new(),
            depth_of: None,
        }
    }

    /// Prepares every picture, as the first epoch would.
    pub fn prepare_all(&mut self, factor: usize) {
        for i in 0..self.frames.len() {
            self.target(i, factor);
        }
    }

    /// Every picture at that size and, if wanted, its depth, for somebody else to keep; what is kept here is forgotten.
    pub fn hand_over(&mut self, factor: usize, with_depth: bool) -> (Vec<Target>, Vec<Option<Vec<f32>>>) {
        self.resize(factor);
        self.frames.iter_mut().for_each(|f| f.cached = None);
        self.used = 0;
        let prepared = self.frames.iter().map(|stored| {
            let mut target = Target::default();
            prepare(stored.frame, factor, &mut target);
            target
        });
        let prepared = prepared.collect();
        let depths = self.frames.iter().filter(|_| with_depth).map(|stored| {
            stored.frame.depth.as_ref().map(|depth| {
                let mut z = Vec::new();
                resample(depth, stored.frame.rgb.size(), factor, &mut z);
                z
            })
        });
        (prepared, depths.collect())
    }

    /// Whether frame `i` has depth.
    pub fn has_depth(&self, i: usize) -> bool {
        self.frames[i].frame.depth.is_some()
    }

    /// The picture of frame `i`, each side divided by `factor`.
    pub fn target(&mut self, i: usize, factor: usize) -> &Target {
        self.resize(factor);
        let frame = self.frames[i].frame;
        if self.frames[i].cached.is_none() && self.spare_of != Some(i) {
            let bytes = bytes(frame, factor);
            if self.used + bytes <= self.budget {
                self.used += bytes;
                let mut prepared = Target::default();
                prepare(frame, factor, &mut prepared);
                self.frames[i].cached = Some(prepared);
            } else {
                prepare(frame, factor, &mut self.spare);
                self.spare_of = Some(i);
            }
        }
        self.frames[i].cached.as_ref().unwrap_or(&self.spare)
    }

    /// z-depth of frame `i` at the size of its picture, 0 or not finite where unknown; empty when the frame has none.
    pub fn depth(&mut self, i: usize, factor: usize) -> &[f32] {
        self.resize(factor);
        if self.depth_of != Some(i) {
            let frame = self.frames[i].frame;
            match &frame.depth {
                Some(depth) => resample(depth, frame.rgb.size(), factor, &mut self.depth),
                None => self.depth.clear(),
            }
            self.depth_of = Some(i);
        }
        &self.depth
    }

    /// Forgets everything prepared at another size.
    fn resize(&mut self, factor: usize) {
        if factor != self.factor {
            self.frames.iter_mut().for_each(|f| f.cached = None);
            (self.factor, self.used, self.spare_of, self.depth_of) = (factor, 0, None, None);
        }
    }
}

/// What a prepared picture takes: a byte a colour, two where bytes are added up.
fn bytes(frame: &CaptureFrame, factor: usize) -> usize {
    let (width, height) = frame.rgb.size();
    let colours = if factor == 1 { 3 } else { 6 };
    colours * (width / factor) * (height / factor)
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

fn prepare(frame: &CaptureFrame, factor: usize, out: &mut Target) {
    let (full_w, full_h) = frame.rgb.size();
    let (w, h) = (full_w / factor, full_h / factor);
    if factor == 1 {
        out.replace(w, h, |planes| by_rows(w, planes, |y, row| split(frame.rgb.row(y), row)));
    } else {
        out.replace_sums(w, h, factor * factor, |planes| {
            by_rows(w, planes, |y, row| add_up(&frame.rgb, factor, y, row));
        });
    }
}

/// Depth at the size of the picture with its sides divided by `factor`: the nearest sample, since blends of two
/// surfaces lie on neither.
fn resample(depth: &CompactDepth, (full_w, full_h): (usize, usize), factor: usize, out: &mut Vec<f32>) {
    let (w, h) = (full_w / factor, full_h / factor);
    let (dw, dh) = depth.size();
    out.resize(w * h, 0.0);
    let rows = out.par_chunks_mut(w.max(1)).with_min_len(ROWS).enumerate();
    if (dw, dh) == (w, h) {
        rows.for_each(|(y, row)| depth.row_into(y, row));
        return;
    }
    let at = |i: usize, n: usize, full: usize| {
        let centre = (i as f64 + 0.5) * factor as f64 * n as f64 / full as f64;
        (centre as usize).min(n - 1)
    };
    let columns: Vec<usize> = (0..w).map(|x| at(x, dw, full_w)).collect();
    rows.for_each(|(y, row)| {
        let y = at(y, dh, full_h);
        row.iter_mut().zip(&columns).for_each(|(z, &x)| *z = depth.at(x, y));
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
    use m4_scene::{Camera, Capture, CaptureFrame, CompactDepth, Intrinsics, Plane};

    fn capture() -> Capture {
        let frame = |i: usize| CaptureFrame {
            name: i.to_string(),
            camera: Camera {
                intrinsics: Intrinsics::centred(5, 4, 5.0),
                c2w: Se3::identity(),
            },
            t: i as f64,
            rgb: Plane::from_fn(5, 4, |x, y| [(x * 10) as u8, (y * 20) as u8, i as u8]),
            depth: Some(Plane::from_fn(10, 8, |x, _| if x == 0 { f32::NAN } else { x as f32 }).into()),
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
        };
        Capture {
            frames: (0..3).map(frame).collect(),
            time_frames: 3,
            duration_s: None,
            metric: false,
            tracks: None,
        }
    }

    #[test]
    fn half_size_is_the_mean_of_four() {
        let capture = capture();
        let mut store = FrameStore::new(&capture, 100);
        let half = store.target(1, 2);
        assert_eq!((half.width(), half.height()), (2, 2));
        let close = |got: f32, want: f32| (got - want / 255.0).abs() < 1e-6;
        assert!(close(half.rgb()[0][1], 25.0) && close(half.rgb()[1][2], 50.0));
        assert_eq!(store.depth(1, 2), [2.0, 6.0, 2.0, 6.0]);
        assert_eq!(store.target(1, 1).rgb()[0].len(), 20);
        assert_eq!(store.depth(1, 1)[0], 1.0);
    }

    #[test]
    fn frames_beyond_the_budget_are_prepared_anew() {
        let capture = capture();
        let mut store = FrameStore::new(&capture, 0);
        for i in [0, 1, 2, 1, 1] {
            let blue = store.target(i, 1).rgb()[2][0];
            assert!((blue * 255.0 - i as f32).abs() < 1e-4);
        }
    }

    #[test]
    fn depth_is_that_of_the_frame_and_the_size_asked_for() {
        let mut capture = capture();
        // as large as the half-size picture, in steps; smaller than the picture, as floats; none
        let steps = Plane::from_fn(2, 2, |x, y| (10 * x + y) as u16);
        capture.frames[0].depth = Some(CompactDepth::from_steps(steps, 0.5));
        capture.frames[1].depth = Some(Plane::filled(1, 1, 3.0).into());
        capture.frames[2].depth = None;
        let mut store = FrameStore::new(&capture, 100);
        for _ in 0..2 {
            assert_eq!(store.depth(0, 2), [0.0, 5.0, 0.5, 5.5]);
            assert_eq!(store.depth(1, 2), [3.0; 4]);
            assert!(store.depth(2, 2).is_empty());
            assert_eq!(store.depth(0, 1)[..5], [0.0, 0.0, 5.0, 5.0, 5.0]);
            assert_eq!(store.depth(0, 4), [0.5]);
        }
    }
}
