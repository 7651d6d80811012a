//! What is kept of a clip while points are followed: flow and depth of the pixels that move, and nothing of the others.

use super::PosedFrame;
use crate::classical::dense::{FlowError, FlowImage, FlowSource, round_trip_px};
use m4_core::{Camera, Flow};

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
    pub moving: Vec<Sparse<f32>>,
    /// Consistent flow of dynamic pixels, from each frame to the next.
    pub forward: Vec<Sparse<[f32; 2]>>,
    /// And from there back.
    pub backward: Vec<Sparse<[f32; 2]>>,
}

/// One over the depth of dynamic regions.
pub(super) fn moving(frame: &PosedFrame) -> Sparse<f32> {
    let (w, h) = frame.rgb.size();
    let (depth, mask) = (frame.depth.data(), frame.moving.data());
    Sparse::new(w, h, |i| {
        (mask[i] > 0 && depth[i].is_finite() && depth[i] > 0.0).then(|| 1.0 / depth[i])
    })
}

/// Flow whose round trip misses by more than this is not followed, pixels.
const ROUND_TRIP_PX: f32 = 1.0;

/// Flow of pixels that `moves` and whose round trip is at most [`ROUND_TRIP_PX`].
pub(crate) fn sparse_flow(flow: &Flow, trip: &[f32], moves: impl Fn(usize) -> bool) -> Sparse<[f32; 2]> {
    Sparse::new(flow.width, flow.height, |i| {
        (moves(i) && trip[i] <= ROUND_TRIP_PX).then(|| [flow.u[i], flow.v[i]])
    })
}

/// Forward and backward flow between two frames, of the dynamic pixels of each.
pub(super) fn sparse_flow_pair(
    [a, b]: [&PosedFrame; 2],
    source: &dyn FlowSource,
) -> Result<[Sparse<[f32; 2]>; 2], FlowError> {
    let size = a.rgb.size();
    let grey = |f: &PosedFrame| -> Vec<f32> {
        let luma = |c: &[u8; 3]| 0.299 * f32::from(c[0]) + 0.587 * f32::from(c[1]) + 0.114 * f32::from(c[2]);
        f.rgb.data().iter().map(luma).collect()
    };
    let (grey_a, grey_b) = (grey(a), grey(b));
    let found = b.rgb.size();
    if found != size {
        let expected = size;
        return Err(FlowError::Size { found, expected });
    }
    let [a_image, b_image] = [(a, &grey_a), (b, &grey_b)].map(|(f, grey)| FlowImage {
        width: size.0,
        height: size.1,
        rgb: f.rgb.data(),
        grey,
    });
    let (there, back) = source.both(&a_image, &b_image)?;
    for flow in [&there, &back] {
        let (found, n) = ((flow.width, flow.height), size.0 * size.1);
        if found != size || flow.u.len() != n || flow.v.len() != n {
            let expected = size;
            return Err(FlowError::Size { found, expected });
        }
    }
    let moves = |f: &PosedFrame, i: usize| f.moving.data()[i] > 0;
    Ok([
        sparse_flow(&there, &round_trip_px(&there, &back), |i| moves(a, i)),
        sparse_flow(&back, &round_trip_px(&back, &there), |i| moves(b, i)),
    ])
}

#[cfg(test)]
mod tests {
    use super::Sparse;

    #[test]
    fn sparse_planes_return_the_stored_values() {
        let known = |i: usize| (i % 3 == 1 && i != 7).then_some(i * 10);
        let sparse = Sparse::new(4, 3, known);
        for y in 0..4 {
            for x in 0..6 {
                let want = if x < 4 && y < 3 { known(y * 4 + x) } else { None };
                assert_eq!(sparse.get(x, y), want, "{x} {y}");
            }
        }
        assert_eq!(Sparse::<f32>::default().get(0, 0), None);
    }
}
