//! A capture as the arrays of MegaSaM.

use super::depth::{self, CLIP, LEAST_DEPTH, Stored};
use super::{Layout, lens, motion, pose};
use crate::npy::Pieces;
use m4_scene::{Capture, CaptureFrame};

/// Largest difference between the lenses of frames, relative, that one matrix may hide.
const SAME_LENS: f64 = 1e-4;

/// A capture whose frames were found to be of one size, and what of them is written.
pub(super) struct Output<'a> {
    capture: &'a Capture,
    /// Width and height that are written, pixels.
    size: (usize, usize),
    layout: Layout,
}

impl<'a> Output<'a> {
    /// Checks that `layout` can hold the capture.
    ///
    /// # Errors
    ///
    /// What is in the way, and what to do, in words.
    pub fn new(capture: &'a Capture, layout: Layout) -> Result<Self, String> {
        let frames = &capture.frames;
        let first = frames.first().ok_or("it has no frames")?;
        let size = first.rgb.size();
        if let Some(i) = frames.iter().position(|f| f.rgb.size() != size) {
            let (w, h) = frames[i].rgb.size();
            return Err(format!(
                "frame {i} is {w} x {h} pixels and frame 0 {} x {}; scale the pictures to one size",
                size.0, size.1
            ));
        }
        if frames.iter().all(|f| f.depth.is_none()) {
            return Err("it has no depth, which these files need; make one with depth (`minute4d geometry`)".into());
        }
        for (i, frame) in frames.iter().enumerate() {
            let pose = frame.camera.c2w.matrix();
            if !pose
                .iter()
                .chain(&lens::numbers(&frame.camera.intrinsics))
                .all(|v| v.is_finite())
            {
                return Err(format!("the camera of frame {i} holds a value that is not a number"));
            }
        }
        let blocks = (size.0 / motion::BLOCK, size.1 / motion::BLOCK);
        if layout == Layout::Reconstruction {
            if blocks.0 * blocks.1 == 0 {
                return Err(format!(
                    "pictures of {} x {} pixels have no block of 8 x 8",
                    size.0, size.1
                ));
            }
            let size = (blocks.0 * motion::BLOCK, blocks.1 * motion::BLOCK);
            return Ok(Self { capture, size, layout });
        }
        let of = |frame: &CaptureFrame| lens::numbers(&frame.camera.intrinsics);
        let k = of(first);
        let other = |frame: &CaptureFrame| of(frame).iter().zip(&k).any(|(a, b)| (a - b).abs() > SAME_LENS * k[0]);
        if let Some(i) = frames.iter().position(other) {
            return Err(format!(
                "frame {i} has another lens (fx fy cx cy = {:?}) than frame 0 ({k:?}), and a npz has one for all; write \
                 megasam-reconstruction, which has one a frame",
                of(&frames[i])
            ));
        }
        Ok(Self { capture, size, layout })
    }

    /// What the files cannot hold, and what they hold with fewer digits.
    pub fn losses(&self) -> (Vec<String>, Vec<String>) {
        let capture = self.capture;
        let frames = &capture.frames;
        let (mut dropped, mut rounded) = (Vec::new(), vec!["poses to 32 bits".to_owned()]);
        if capture.metric {
            dropped.push("that a unit is a metre".into());
        }
        if capture.duration_s.is_some() {
            dropped.push("how long the clip lasts: give the frames a second to who reads it".into());
        }
        if capture.tracks.is_some() {
            dropped.push("tracks".into());
        }
        if self.layout != Layout::Reconstruction && frames.iter().any(|f| f.mask.is_some()) {
            dropped
                .push("masks: megasam-reconstruction holds them, best in reconstructions/NAME beside the file".into());
        }
        let size = frames.first().map_or(self.size, |f| f.rgb.size());
        if size != self.size {
            let (w, h) = (size.0 - self.size.0, size.1 - self.size.1);
            dropped.push(format!(
                "{w} columns at the right and {h} rows at the bottom: sides are multiples of 8"
            ));
        }
        let of_other_size = |f: &&CaptureFrame| f.depth.as_ref().is_some_and(|d| d.size() != f.rgb.size());
        if frames.iter().any(|f| of_other_size(&f)) {
            rounded.push("depth, resampled to the size of the pictures".into());
        }
        let depths = || {
            frames
                .iter()
                .filter_map(|f| f.depth.as_ref())
                .flat_map(|d| d.every(1))
                .filter(|z| *z > 0.0)
        };
        let near = depths().filter(|z| f64::from(*z) < LEAST_DEPTH).count();
        if near > 0 {
            dropped.push(format!(
                "{near} depths below {LEAST_DEPTH}, which MegaSaM takes for unknown"
            ));
        }
        match self.layout {
            Layout::Cvd => {
                rounded.push("depth to 16 bits (0.05 %)".into());
                let far = depths().filter(|z| f64::from(*z) > CLIP.1).count();
                if far > 0 {
                    dropped.push(format!("{far} depths above {}, which were written as that", CLIP.1));
                }
            }
            Layout::Reconstruction => {
                if frames.iter().any(|f| f.mask.is_some()) {
                    rounded.push("masks to shares of 8 x 8 pixels".into());
                }
            }
            Layout::Droid => {}
        }
        (dropped, rounded)
    }

    /// The arrays, in the order in which they are written.
    pub fn arrays(&self) -> Vec<Pieces<'_>> {
        match self.layout {
            Layout::Droid => self.archive("<f4", Stored::Depth),
            Layout::Cvd => self.archive("<f2", Stored::Clipped),
            Layout::Reconstruction => self.folder(),
        }
    }

    fn archive(&self, depth: &'static str, stored: Stored) -> Vec<Pieces<'_>> {
        let n = self.capture.frames.len();
        let (w, h) = self.size;
        let lens = self.capture.frames.first().map(|f| lens::matrix(&f.camera.intrinsics));
        let pose = |i: usize| self.capture.frames[i].camera.c2w.matrix();
        vec![
            self.frames("images", "|u1", vec![n, h, w, 3], move |i| {
                self.pixels(i).flatten().collect()
            }),
            self.frames("depths", depth, vec![n, h, w], move |i| self.depth(i, stored)),
            Pieces {
                name: "intrinsic",
                descr: "<f8",
                shape: vec![3, 3],
                count: 1,
                piece: Box::new(move |_| lens.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()),
            },
            // nalgebra runs down the columns
            self.frames("cam_c2w", "<f4", vec![n, 4, 4], move |i| {
                floats(pose(i).transpose().iter())
            }),
        ]
    }

    fn folder(&self) -> Vec<Pieces<'_>> {
        let frames = &self.capture.frames;
        let n = frames.len();
        let (w, h) = self.size;
        let mut arrays = vec![
            self.frames("images", "|u1", vec![n, 3, h, w], move |i| {
                [2, 1, 0]
                    .into_iter()
                    .flat_map(|c| self.pixels(i).map(move |p| p[c]))
                    .collect()
            }),
            self.frames("disps", "<f4", vec![n, h, w], move |i| self.depth(i, Stored::Disparity)),
            self.frames("poses", "<f4", vec![n, 7], move |i| {
                floats(pose::to_w2c(&frames[i].camera.c2w).iter())
            }),
            self.frames("intrinsics", "<f4", vec![n, 4], move |i| {
                floats(lens::numbers(&frames[i].camera.intrinsics).iter())
            }),
        ];
        if frames.iter().any(|f| f.mask.is_some() || f.motion.is_some()) {
            let shape = vec![n, h / motion::BLOCK, w / motion::BLOCK];
            arrays.push(self.frames("motion_prob", "<f4", shape, move |i| {
                let still = motion::still_share(self.size, |x, y| self.moves(i, x, y));
                still.iter().flat_map(|v| v.to_le_bytes()).collect()
            }));
        }
        arrays
    }

    fn frames<'b>(
        &self,
        name: &'static str,
        descr: &'static str,
        shape: Vec<usize>,
        piece: impl Fn(usize) -> Vec<u8> + 'b,
    ) -> Pieces<'b> {
        Pieces {
            name,
            descr,
            shape,
            count: self.capture.frames.len(),
            piece: Box::new(piece),
        }
    }

    /// The pixels of frame `i`, row by row.
    fn pixels(&self, i: usize) -> impl Iterator<Item = [u8; 3]> + '_ {
        let rgb = &self.capture.frames[i].rgb;
        let (w, h) = self.size;
        (0..h).flat_map(move |y| rgb.row(y)[..w].iter().copied())
    }

    /// The depth of frame `i`, row by row; unknown where the frame has none.
    fn depth(&self, i: usize, stored: Stored) -> Vec<u8> {
        let frame = &self.capture.frames[i];
        let mut out = Vec::new();
        for y in 0..self.size.1 {
            for x in 0..self.size.0 {
                let z = frame.depth.as_ref().map_or(0.0, |map| {
                    let (x, y) = nearest((x, y), frame.rgb.size(), map.size());
                    map.at(x, y)
                });
                depth::write(stored, z, &mut out);
            }
        }
        out
    }

    /// How likely pixel `(x, y)` of frame `i` moves: by its map of motion, else by its mask.
    fn moves(&self, i: usize, x: usize, y: usize) -> f32 {
        let frame = &self.capture.frames[i];
        if let Some(motion) = &frame.motion {
            return f32::from(motion[nearest((x, y), frame.rgb.size(), motion.size())]) / 255.0;
        }
        let moves = frame.mask.as_ref().is_some_and(|mask| {
            let (x, y) = nearest((x, y), frame.rgb.size(), mask.size());
            mask.at(x, y)
        });
        f32::from(u8::from(moves))
    }
}

/// The pixel of a map of size `to` at the centre of a pixel of a picture of size `of`.
fn nearest((x, y): (usize, usize), of: (usize, usize), to: (usize, usize)) -> (usize, usize) {
    ((2 * x + 1) * to.0 / (2 * of.0), (2 * y + 1) * to.1 / (2 * of.1))
}

fn floats<'a>(values: impl Iterator<Item = &'a f64>) -> Vec<u8> {
    values.flat_map(|v| (*v as f32).to_le_bytes()).collect()
}
