//! A capture whose frames are looked at one at a time, and what is kept of it while points are
//! followed: flow and depth of the pixels that move, and nothing of the others.

use super::TrackError;
use crate::flow::{FlowPair, ScaledFrame, Way};
use crate::resample::{resize_area, working_size};
use m4_core::{Camera, Capture, DepthMap, Mask, Plane, RgbImage};

/// One frame with its geometry, all planes of the size of the camera's image.
#[derive(Debug, Clone)]
pub struct PosedFrame {
    /// sRGB.
    pub rgb: RgbImage,
    /// z-depth, world units; 0 or less, or not a number, where unknown.
    pub depth: DepthMap,
    /// Above 0 where something moves.
    pub moving: Mask,
    /// Lens and pose.
    pub camera: Camera,
}

/// A capture as a clip: images, depth and masks at one size. Frames are brought to it when they are
/// looked at, several at once from different threads, and again when they are looked at again, so
/// that a long clip is not in memory twice.
#[derive(Debug, Clone, Copy)]
pub struct CaptureClip<'a> {
    capture: &'a Capture,
    size: (usize, usize),
}

impl<'a> CaptureClip<'a> {
    /// The frames of `capture` with their longest side at most `side_px`: images are shrunk by the
    /// mean of their pixels, depth and masks read at the nearest. A frame without depth or mask has
    /// none of it, and is not followed through.
    #[must_use]
    pub fn new(capture: &'a Capture, side_px: usize) -> Self {
        let (w, h) = capture.frames.first().map_or((0, 0), |f| f.rgb.size());
        Self {
            capture,
            size: working_size(w, h, side_px.max(2)),
        }
    }

    /// Width and height at which frames are read.
    pub(super) fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Number of frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.capture.frames.len()
    }

    /// Frame `index`, below [`Self::frames`].
    ///
    /// # Errors
    ///
    /// [`TrackError::Frame`] for images too small to follow anything, and cameras that are not
    /// finite.
    pub fn read(&self, index: usize) -> Result<PosedFrame, TrackError> {
        let frame = &self.capture.frames[index];
        let refused = |reason| {
            Err(TrackError::Frame {
                frame: index,
                reason,
            })
        };
        let (w, h) = self.size;
        if frame.rgb.width() < w || frame.rgb.height() < h || w.min(h) < 2 {
            return refused("it is smaller than the first frame, or than 2 pixels");
        }
        let camera = frame.camera.resized(w, h);
        let (k, pose) = (&camera.intrinsics, &camera.c2w);
        let numbers = pose
            .rotation
            .iter()
            .chain(&pose.translation)
            .chain([&k.cx, &k.cy, &k.fx, &k.fy]);
        if !numbers.into_iter().all(|v| v.is_finite()) || k.fx <= 0.0 || k.fy <= 0.0 {
            return refused("its camera is not finite, or has a focal length of 0 or less");
        }
        let depth = Plane::from_fn(w, h, |x, y| {
            frame
                .depth
                .as_ref()
                .map_or(0.0, |d| d.covering((x, y), (w, h)))
        });
        let inside = |x, y| {
            frame
                .mask
                .as_ref()
                .is_some_and(|m| m.covers((x, y), (w, h)))
        };
        let moving = Plane::from_fn(w, h, |x, y| if inside(x, y) { 255 } else { 0 });
        Ok(PosedFrame {
            rgb: resize_area(&frame.rgb, w, h),
            depth,
            moving,
            camera,
        })
    }
}

/// Values of some pixels of an image.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sparse<T> {
    /// Where each row starts among `columns`, and where the last ends.
    rows: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<T>,
}

impl<T: Copy> Sparse<T> {
    /// The pixels that `value(pixel index)` knows.
    pub fn new(width: usize, height: usize, value: impl Fn(usize) -> Option<T>) -> Self {
        let mut out = Self {
            rows: vec![0],
            columns: Vec::new(),
            values: Vec::new(),
        };
        for y in 0..height {
            for x in 0..width {
                if let Some(v) = value(y * width + x) {
                    out.columns.push(x as u32);
                    out.values.push(v);
                }
            }
            out.rows.push(out.columns.len() as u32);
        }
        out.columns.shrink_to_fit();
        out.values.shrink_to_fit();
        out
    }

    /// The value at a pixel; `None` where there is none, and beyond the image.
    pub fn get(&self, x: usize, y: usize) -> Option<T> {
        let (from, to) = (*self.rows.get(y)?, *self.rows.get(y + 1)?);
        let row = &self.columns[from as usize..to as usize];
        let at = row.binary_search(&u32::try_from(x).ok()?).ok()?;
        Some(self.values[from as usize + at])
    }
}

/// Everything that chains are made of.
pub(crate) struct Strip {
    pub width: usize,
    pub height: usize,
    /// One per frame.
    pub cameras: Vec<Camera>,
    /// One over the z-depth of dynamic regions, one per frame.
    pub dynamic: Vec<Sparse<f32>>,
    /// Consistent flow of dynamic pixels, from each frame to the next.
    pub forward: Vec<Sparse<[f32; 2]>>,
    /// And from there back.
    pub backward: Vec<Sparse<[f32; 2]>>,
}

/// The disparity of the dynamic regions of a frame.
pub(super) fn dynamic_disparity(frame: &PosedFrame) -> Sparse<f32> {
    let (w, h) = frame.rgb.size();
    let (depth, mask) = (frame.depth.data(), frame.moving.data());
    Sparse::new(w, h, |i| {
        (mask[i] > 0 && depth[i].is_finite() && depth[i] > 0.0).then(|| 1.0 / depth[i])
    })
}

/// Flow whose round trip misses by more than this is not followed, pixels.
const ROUND_TRIP_PX: f32 = 1.0;

/// Flow of pixels that `moves` and whose round trip is at most [`ROUND_TRIP_PX`].
pub(crate) fn sparse_flow(way: Way<'_>, moves: impl Fn(usize) -> bool) -> Sparse<[f32; 2]> {
    let flow = way.flow;
    Sparse::new(flow.width, flow.height, |i| {
        (moves(i) && way.round_trip_px(i) <= ROUND_TRIP_PX).then(|| [flow.u[i], flow.v[i]])
    })
}

/// Forward and backward flow between two frames, of the dynamic pixels of each.
pub(super) fn sparse_flow_pair([a, b]: [&PosedFrame; 2]) -> [Sparse<[f32; 2]>; 2] {
    let [from, to] = [a, b].map(|frame| ScaledFrame::new(&frame.rgb, frame.rgb.size()));
    let pair = FlowPair::between(&from, &to);
    let moves = |f: &PosedFrame, i: usize| f.moving.data()[i] > 0;
    [
        sparse_flow(pair.there(), |i| moves(a, i)),
        sparse_flow(pair.back(), |i| moves(b, i)),
    ]
}

#[cfg(test)]
mod tests {
    use super::Sparse;

    #[test]
    fn sparse_planes_return_the_stored_values() {
        let value_at = |i: usize| (i % 3 == 1 && i != 7).then_some(i * 10);
        let sparse = Sparse::new(4, 3, value_at);
        for y in 0..4 {
            for x in 0..6 {
                let want = if x < 4 && y < 3 {
                    value_at(y * 4 + x)
                } else {
                    None
                };
                assert_eq!(sparse.get(x, y), want, "{x} {y}");
            }
        }
        assert_eq!(Sparse::<f32>::default().get(0, 0), None);
    }
}
