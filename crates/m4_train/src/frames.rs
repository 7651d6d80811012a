//! The training frames in the form that the loss needs.

use m4_core::{Capture, CaptureFrame};
use m4_kernels::loss::cpu::Target;
use rayon::prelude::*;

/// A frame of the capture, and what the trainer keeps of it.
#[derive(Debug)]
struct Stored<'a> {
    /// `None` where the prepared image is all there is.
    frame: Option<&'a CaptureFrame>,
    cached: Option<Target>,
}

/// All frames, and as many prepared images as fit the budget.
#[derive(Debug)]
pub(crate) struct FrameStore<'a> {
    frames: Vec<Stored<'a>>,
    budget: usize,
    used: usize,
    /// The image prepared last that did not fit; its memory is used again for the next.
    spare: Target,
    spare_of: Option<usize>,
}

impl<'a> FrameStore<'a> {
    pub fn new(capture: &'a Capture, budget_mb: usize) -> Self {
        let frames = capture.frames.iter().map(|frame| Stored {
            frame: Some(frame),
            cached: None,
        });
        Self {
            frames: frames.collect(),
            budget: budget_mb * 1_000_000,
            used: 0,
            spare: Target::default(),
            spare_of: None,
        }
    }

    /// Of images that are prepared.
    pub fn of_targets(targets: Vec<Target>) -> Self {
        let frames = targets.into_iter().map(|target| Stored {
            frame: None,
            cached: Some(target),
        });
        Self {
            frames: frames.collect(),
            budget: 0,
            used: 0,
            spare: Target::default(),
            spare_of: None,
        }
    }

    /// Prepares the images that are kept, as the first epoch would.
    pub fn prepare(&mut self) {
        for i in 0..self.frames.len() {
            self.keep(i);
        }
    }

    /// Prepares frame `i` where the budget allows to keep it.
    fn keep(&mut self, i: usize) {
        let stored = &mut self.frames[i];
        if let (Some(frame), None) = (stored.frame, &stored.cached)
            && self.used + bytes(frame) <= self.budget
        {
            self.used += bytes(frame);
            stored.cached = Some(prepared(frame));
        }
    }

    /// The image of frame `i`.
    pub fn target(&mut self, i: usize) -> &Target {
        self.keep(i);
        let stored = &self.frames[i];
        if let (Some(frame), None) = (stored.frame, &stored.cached)
            && self.spare_of != Some(i)
        {
            prepare(frame, &mut self.spare);
            self.spare_of = Some(i);
        }
        self.frames[i].cached.as_ref().unwrap_or(&self.spare)
    }
}

/// Every image of a capture.
pub(crate) fn targets(capture: &Capture) -> Vec<Target> {
    capture.frames.iter().map(prepared).collect()
}

/// What a prepared image takes: a byte a colour.
fn bytes(frame: &CaptureFrame) -> usize {
    let (width, height) = frame.rgb.size();
    3 * width * height
}

fn prepared(frame: &CaptureFrame) -> Target {
    let mut target = Target::default();
    prepare(frame, &mut target);
    target
}

fn prepare(frame: &CaptureFrame, out: &mut Target) {
    let (w, h) = frame.rgb.size();
    out.replace(w, h, |planes| {
        by_rows(w, planes, |y, row| split(frame.rgb.row(y), row))
    });
}

/// Calls `fill` with each row of three planes of `width` columns.
fn by_rows<T: Send>(
    width: usize,
    planes: [&mut [T]; 3],
    fill: impl Fn(usize, [&mut [T]; 3]) + Sync,
) {
    let [red, green, blue] = planes.map(|plane| plane.par_chunks_mut(width.max(1)));
    let rows = red.zip(green).zip(blue).enumerate();
    rows.for_each(|(y, ((red, green), blue))| fill(y, [red, green, blue]));
}

/// A row of an image, one plane per channel.
fn split(pixels: &[[u8; 3]], [red, green, blue]: [&mut [u8]; 3]) {
    for (((r, g), b), pixel) in red.iter_mut().zip(green).zip(blue).zip(pixels) {
        [*r, *g, *b] = *pixel;
    }
}

#[cfg(test)]
mod tests {
    use super::{FrameStore, targets};
    use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane, Se3};

    #[test]
    fn frames_beyond_the_budget_are_prepared_anew() {
        let frame = |i: usize| CaptureFrame {
            name: i.to_string(),
            camera: Camera {
                intrinsics: Intrinsics::centred(5, 4, 5.0),
                c2w: Se3::identity(),
            },
            t: i as f64,
            rgb: Plane::from_fn(5, 4, |x, y| [(x * 10) as u8, (y * 20) as u8, i as u8]),
            depth: None,
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        };
        let capture = Capture {
            frames: (0..3).map(frame).collect(),
            time_frames: 3,
            duration_s: None,
            metric: false,
            tracks: None,
        };
        for budget_mb in [0, 100] {
            let mut store = FrameStore::new(&capture, budget_mb);
            for i in [0, 1, 2, 1, 1] {
                let rgb = store.target(i).rgb();
                assert!((rgb[2][0] * 255.0 - i as f32).abs() < 1e-4);
                assert!(
                    (rgb[0][3] * 255.0 - 30.0).abs() < 1e-4
                        && (rgb[1][19] * 255.0 - 60.0).abs() < 1e-4
                );
            }
        }
        let handed = targets(&capture);
        assert_eq!((handed.len(), handed[2].planes()[2][19]), (3, 2));
    }
}
