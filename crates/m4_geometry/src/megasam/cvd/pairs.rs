//! Flow fields between frames: which pairs, which of their pixels count, and where they are kept.
//!
//! ```text
//! pair_list -> flow both ways (caller) -> halved -> consistency_mask -> PairStore
//! ```
//!
//! docs/spec/front-end.md 1.7. A million pixels of flow a second pass through here for every second
//! of video, so a stored pixel has four bytes, and what exceeds a byte budget goes to a temporary
//! file.

use super::PairError;
use m4_core::Flow;
use std::collections::HashSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::sync::Mutex;

/// Distances of the frames of a pair. MegaSaM: 1, 2, 4, 8, 15.
pub const STEPS: [usize; 5] = [1, 2, 4, 8, 15];

/// A flow field from one frame to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FramePair {
    /// The frame that the flow starts in.
    pub source: usize,
    /// The frame that it leads to.
    pub target: usize,
}

/// Every pair of frames [`STEPS`] apart, forwards in time, by step and then by source: `5 n - 30`
/// pairs from 15 frames on. Steps as long as the clip or longer have no pairs.
#[must_use]
pub fn pair_list(frames: usize) -> Vec<FramePair> {
    let of_step = |step: usize| {
        (step..frames).map(move |target| FramePair {
            source: target - step,
            target,
        })
    };
    STEPS.into_iter().flat_map(of_step).collect()
}

/// Greatest forward-backward error of a pixel that counts, pixels at the working size. MegaSaM: 1.
pub const MAX_ROUND_TRIP_PX: f32 = 1.0;

/// The flow on an image of half the size (rounded down): bilinear at pixel centres, clamped at the
/// edges, values scaled along.
#[must_use]
pub fn halved(flow: &Flow) -> Flow {
    let (width, height) = ((flow.width / 2).max(1), (flow.height / 2).max(1));
    let (sx, sy) = (
        flow.width as f32 / width as f32,
        flow.height as f32 / height as f32,
    );
    let mut out = Flow {
        width,
        height,
        u: Vec::with_capacity(width * height),
        v: Vec::with_capacity(width * height),
    };
    for row in 0..height {
        let y = ((row as f32 + 0.5) * sy - 0.5).clamp(0.0, (flow.height - 1) as f32);
        for column in 0..width {
            let x = ((column as f32 + 0.5) * sx - 0.5).clamp(0.0, (flow.width - 1) as f32);
            out.u
                .push(sample(flow.width, flow.height, &flow.u, x, y) / sx);
            out.v
                .push(sample(flow.width, flow.height, &flow.v, x, y) / sy);
        }
    }
    out
}

/// Bilinear value at `(x, y)` in pixel-centre coordinates; pixels outside are 0.
fn sample(width: usize, height: usize, plane: &[f32], x: f32, y: f32) -> f32 {
    // also where x or y is NaN
    if !(x > -1.0 && y > -1.0 && x < width as f32 && y < height as f32) {
        return 0.0;
    }
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let (x0, y0) = (x0 as isize, y0 as isize);
    let tap = |x: isize, y: isize| {
        let inside = x >= 0 && y >= 0 && x < width as isize && y < height as isize;
        if inside {
            plane[y as usize * width + x as usize]
        } else {
            0.0
        }
    };
    let top = tap(x0, y0) * (1.0 - fx) + tap(x0 + 1, y0) * fx;
    let bottom = tap(x0, y0 + 1) * (1.0 - fx) + tap(x0 + 1, y0 + 1) * fx;
    top * (1.0 - fy) + bottom * fy
}

/// `[height][width]`: how far a pixel lands from where it started after going there and back,
/// pixels; the way back is 0 outside the frame. A flow that is not finite gives infinity.
#[must_use]
pub fn round_trip_px(forward: &Flow, backward: &Flow) -> Vec<f32> {
    let (w, h) = (forward.width, forward.height);
    let mut out = Vec::with_capacity(w * h);
    for i in 0..w * h {
        let (u, v) = (forward.u[i], forward.v[i]);
        let (x, y) = ((i % w) as f32 + u, (i / w) as f32 + v);
        let error = (u + sample(backward.width, backward.height, &backward.u, x, y))
            .hypot(v + sample(backward.width, backward.height, &backward.v, x, y));
        out.push(if error.is_finite() {
            error
        } else {
            f32::INFINITY
        });
    }
    out
}

/// `[height][width]`: whether a pixel of `forward` counts. It does if it returns to within
/// [`MAX_ROUND_TRIP_PX`] and lands inside the frame: a pixel that leaves meets a way back of 0,
/// which a short way out would pass, and what is sampled out there is no disparity.
#[must_use]
pub fn consistency_mask(forward: &Flow, backward: &Flow) -> Vec<bool> {
    let (w, h) = (forward.width, forward.height);
    let inside = |i: usize| {
        let (x, y) = ((i % w) as f32 + forward.u[i], (i / w) as f32 + forward.v[i]);
        x >= 0.0 && y >= 0.0 && x <= (w - 1) as f32 && y <= (h - 1) as f32
    };
    let errors = round_trip_px(forward, backward).into_iter().enumerate();
    errors
        .map(|(i, error)| error < MAX_ROUND_TRIP_PX && inside(i))
        .collect()
}

/// Keeps fields in memory up to a number of bytes and the others in an unnamed temporary file,
/// which goes away with it.
#[derive(Debug)]
pub struct PairStore {
    width: usize,
    height: usize,
    budget_bytes: usize,
    pairs: Vec<FramePair>,
    known_pairs: HashSet<FramePair>,
    /// The first pairs.
    memory: Vec<CompactFlow>,
    /// `unit_px` of the others, whose codes are in the file, one after the other.
    spilled: Vec<f32>,
    file: Option<Mutex<File>>,
}

impl PairStore {
    /// An empty store for fields of a size; `budget_bytes` of them stay in memory (`usize::MAX`:
    /// all).
    #[must_use]
    pub fn new(width: usize, height: usize, budget_bytes: usize) -> Self {
        Self {
            width,
            height,
            budget_bytes,
            pairs: Vec::new(),
            known_pairs: HashSet::new(),
            memory: Vec::new(),
            spilled: Vec::new(),
            file: None,
        }
    }

    /// Bytes of one field.
    fn pair_bytes(&self) -> usize {
        4 * stride(self.width) * self.height
    }

    /// Bytes that are held in memory.
    fn memory_bytes(&self) -> usize {
        self.memory.len() * self.pair_bytes()
    }

    /// Adds a pair: its flow and which pixels count (`[height][width]`).
    ///
    /// # Errors
    ///
    /// [`PairError`] if the planes have another size, the pair is there or of one frame, or the
    /// file cannot be written.
    pub fn push(&mut self, pair: FramePair, flow: &Flow, mask: &[bool]) -> Result<(), PairError> {
        let expected = self.width * self.height;
        for (what, count) in [
            ("flow x", flow.u.len()),
            ("flow y", flow.v.len()),
            ("mask", mask.len()),
        ] {
            if count != expected {
                return Err(PairError::Input(format!(
                    "{what} has {count} values where {expected} were expected; all frames must have one size"
                )));
            }
        }
        let reject = |what: &str| {
            Err(PairError::Input(format!(
                "the pair ({}, {}) is {what}; give each pair of different frames once",
                pair.source, pair.target
            )))
        };
        if pair.source == pair.target {
            return reject("of one frame");
        }
        if self.known_pairs.contains(&pair) {
            return reject("there already");
        }
        let field = CompactFlow::encode(self.width, self.height, &flow.u, &flow.v, mask);
        let fits = self.memory_bytes() + self.pair_bytes() <= self.budget_bytes;
        if fits && self.spilled.is_empty() {
            self.memory.push(field);
        } else {
            self.spill(&field)?;
        }
        self.known_pairs.insert(pair);
        self.pairs.push(pair);
        Ok(())
    }

    fn spill(&mut self, field: &CompactFlow) -> Result<(), PairError> {
        let at = self.offset(self.spilled.len());
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(Mutex::new(tempfile::tempfile()?)),
        };
        let file = match file.get_mut() {
            Ok(file) => file,
            Err(poisoned) => poisoned.into_inner(),
        };
        file.seek(SeekFrom::Start(at))?;
        file.write_all(bytemuck::cast_slice(&field.codes))?;
        self.spilled.push(field.unit_px);
        Ok(())
    }

    fn offset(&self, spilled: usize) -> u64 {
        spilled as u64 * self.pair_bytes() as u64
    }

    /// Width and height of the fields, pixels.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The pairs, no two alike.
    #[must_use]
    pub fn pairs(&self) -> &[FramePair] {
        &self.pairs
    }

    /// The field of pair `index`, in place or read into `buffer`; from several threads, in any
    /// order.
    ///
    /// # Errors
    ///
    /// [`PairError::Spill`] if it cannot be read.
    pub fn flow<'a>(
        &'a self,
        index: usize,
        buffer: &'a mut CompactFlow,
    ) -> Result<&'a CompactFlow, PairError> {
        if let Some(field) = self.memory.get(index) {
            return Ok(field);
        }
        let spilled = index - self.memory.len();
        let Some(file) = &self.file else {
            return Err(std::io::Error::from(std::io::ErrorKind::NotFound).into());
        };
        buffer.unit_px = self.spilled[spilled];
        buffer.codes.resize(self.pair_bytes() / 2, 0);
        // a thread that died while it read left nothing half done: every read seeks first
        let mut file = file
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        file.seek(SeekFrom::Start(self.offset(spilled)))?;
        file.read_exact(bytemuck::cast_slice_mut(&mut buffer.codes))?;
        Ok(buffer)
    }
}

/// The code of a pixel that does not count.
pub const MASKED: i16 = i16::MIN;

/// Rows are filled up to a multiple of this with [`MASKED`].
pub(in crate::megasam::cvd) const LANES: usize = 16;

/// Columns of a stored row.
pub(in crate::megasam::cvd) fn stride(width: usize) -> usize {
    width.next_multiple_of(LANES)
}

/// A flow field as whole numbers of `unit_px`, row by row, each row `[stride]` of x and then
/// `[stride]` of y, with `stride` the width rounded up to 16. Pixels that do not count (and the
/// filling) have [`MASKED`] for x and 0 for y.
///
/// `unit_px` is the greatest component of a pixel that counts over 32,767: a flow of 40 pixels is
/// within 0.0006 pixels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CompactFlow {
    /// Pixels.
    pub unit_px: f32,
    /// `[height][2][stride]`.
    pub codes: Vec<i16>,
}

impl CompactFlow {
    /// Encodes planes of `[height][width]`, which the caller has checked. A flow that is not finite
    /// does not count.
    pub(super) fn encode(width: usize, height: usize, x: &[f32], y: &[f32], mask: &[bool]) -> Self {
        let counts = |i: usize| mask[i] && x[i].is_finite() && y[i].is_finite();
        let largest = (0..width * height)
            .filter(|&i| counts(i))
            .fold(0.0f32, |m, i| m.max(x[i].abs()).max(y[i].abs()));
        let unit_px = if largest > 0.0 {
            largest / 32_767.0
        } else {
            1.0
        };
        let stride = stride(width);
        let mut codes = vec![0; 2 * stride * height];
        for (row, out) in codes.chunks_exact_mut(2 * stride).enumerate() {
            let (xs, ys) = out.split_at_mut(stride);
            xs.fill(MASKED);
            for column in 0..width {
                let i = row * width + column;
                if counts(i) {
                    xs[column] = code(x[i], unit_px);
                    ys[column] = code(y[i], unit_px);
                }
            }
        }
        Self { unit_px, codes }
    }
}

fn code(value: f32, unit: f32) -> i16 {
    (value / unit).round().clamp(-32_767.0, 32_767.0) as i16
}

#[cfg(test)]
mod tests {
    use super::{CompactFlow, FramePair, MASKED, PairStore, pair_list};
    use m4_core::{CounterRng, Flow};

    #[test]
    fn a_long_clip_has_five_pairs_a_frame_less_thirty() {
        for n in [15, 16, 96, 1500] {
            assert_eq!(pair_list(n).len(), 5 * n - 30);
        }
        let pairs = pair_list(20);
        assert_eq!(
            pairs[0],
            FramePair {
                source: 0,
                target: 1
            }
        );
        assert_eq!(
            pairs[pairs.len() - 1],
            FramePair {
                source: 4,
                target: 19
            }
        );
        assert!(pairs.iter().all(|p| p.source < p.target && p.target < 20));
    }

    #[test]
    fn short_clips_have_fewer_pairs() {
        assert!(pair_list(0).is_empty() && pair_list(1).is_empty());
        assert_eq!(
            pair_list(2),
            [FramePair {
                source: 0,
                target: 1
            }]
        );
        // 2 of step 1, 1 of step 2
        assert_eq!(pair_list(3).len(), 3);
        // 8 + 7 + 5 + 1
        assert_eq!(pair_list(9).len(), 21);
    }

    const SIZE: (usize, usize) = (21, 9);

    fn field(seed: u64) -> (Flow, Vec<bool>) {
        let mut rng = CounterRng::new(seed, 1, 2);
        let n = SIZE.0 * SIZE.1;
        let field = Flow {
            width: SIZE.0,
            height: SIZE.1,
            u: (0..n).map(|_| 30.0 * rng.normal() as f32).collect(),
            v: (0..n).map(|_| 10.0 * rng.normal() as f32).collect(),
        };
        (field, (0..n).map(|_| rng.uniform() < 0.7).collect())
    }

    fn fill(budget: usize) -> PairStore {
        let mut store = PairStore::new(SIZE.0, SIZE.1, budget);
        for k in 0..5 {
            let (flow, mask) = field(k as u64);
            let pair = FramePair {
                source: k,
                target: k + 1,
            };
            store.push(pair, &flow, &mask).unwrap();
        }
        store
    }

    #[test]
    fn a_field_comes_back_within_half_a_unit() {
        let store = fill(usize::MAX);
        let (flow, mask) = field(3);
        let mut buffer = CompactFlow::default();
        let got = store.flow(3, &mut buffer).unwrap();
        assert!(got.unit_px > 0.0 && got.unit_px < 120.0 / 32_767.0);
        for (y, row) in got.codes.chunks_exact(64).enumerate() {
            for x in 0..32 {
                if x < SIZE.0 && mask[y * SIZE.0 + x] {
                    let i = y * SIZE.0 + x;
                    assert!(
                        (f32::from(row[x]) * got.unit_px - flow.u[i]).abs() <= 0.51 * got.unit_px
                    );
                    assert!(
                        (f32::from(row[32 + x]) * got.unit_px - flow.v[i]).abs()
                            <= 0.51 * got.unit_px
                    );
                } else {
                    assert_eq!(row[x], MASKED);
                }
            }
        }
    }

    #[test]
    fn pairs_beyond_the_budget_are_read_from_the_file() {
        let (all, some) = (fill(usize::MAX), fill(2 * fill(0).pair_bytes() + 7));
        assert_eq!((all.spilled.len(), some.spilled.len()), (0, 3));
        assert_eq!(some.memory_bytes(), 2 * some.pair_bytes());
        assert_eq!(all.pairs(), some.pairs());
        for k in [4, 0, 2, 3, 1, 4] {
            let (mut a, mut b) = (CompactFlow::default(), CompactFlow::default());
            assert_eq!(all.flow(k, &mut a).unwrap(), some.flow(k, &mut b).unwrap());
        }
    }

    #[test]
    fn broken_pairs_are_refused_with_a_reason() {
        let mut store = fill(usize::MAX);
        let (flow, mask) = field(0);
        let pair = |source, target| FramePair { source, target };
        let twice = store.push(pair(0, 1), &flow, &mask).unwrap_err();
        assert!(twice.to_string().contains("there already"), "{twice}");
        let same = store.push(pair(7, 7), &flow, &mask).unwrap_err();
        assert!(same.to_string().contains("of one frame"), "{same}");
        let short = store.push(pair(7, 8), &flow, &mask[1..]).unwrap_err();
        assert!(short.to_string().starts_with("mask has"), "{short}");
    }
}
