//! Plans the device memory of training or rendering before it starts.

use crate::NODE_PARAMETERS;
use crate::blend::gpu::backward::SUMS;
use crate::gpu::scan::Scan;
use crate::gpu::sort::Sort;
use crate::gpu::{Gpu, GpuError, tally::LOSSES, vector::EYE};
use crate::loss::gpu as loss;
use crate::pose::gpu::Moment;
use crate::renderer::gpu::{CHECKPOINT, Size};
use crate::splats::{Bound, parts};
use crate::tile_binning::gpu::{ALLOCATED, REACH, RECORD, TILE, TOTALS};
use m4_core::{SplatLayout, Window};

const TRAINING: &str = "training";

/// One part of a [`Plan`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryItem {
    /// Its contents.
    pub what: &'static str,
    /// All of its buffers, bytes.
    pub bytes: u64,
    /// The largest of them, bytes.
    pub largest: u64,
}

/// The memory that something takes on the device, part by part. The runtime rounds buffers up and
/// keeps some for itself; measured, that is a few per cent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    doing: &'static str,
    parts: Vec<MemoryItem>,
    frame_bytes: u64,
    frames: usize,
    /// Memory of a second set of gradients.
    batch: MemoryItem,
    /// Memory for gradients in the image.
    centres: MemoryItem,
}

/// The buffers of a part, counted in numbers of four bytes.
fn part(what: &'static str, buffers: &[usize]) -> MemoryItem {
    // a buffer has at least one number
    let bytes = buffers.iter().map(|&len| 4 * len.max(1) as u64);
    MemoryItem {
        what,
        bytes: bytes.clone().sum(),
        largest: bytes.max().unwrap_or(0),
    }
}

impl Plan {
    /// Training of `n_static` and `n_dynamic` splats on `frames` images of `size` (columns, rows)
    /// that stay on the device, eight bits per channel, with room for `entries` entries of tile
    /// lists ([`Size::first_entries`] at first; a trainer makes more where a frame has more).
    pub fn training(
        n_static: usize,
        n_dynamic: usize,
        layout: SplatLayout,
        size: (usize, usize),
        frames: usize,
        entries: usize,
    ) -> Self {
        let n = n_static + n_dynamic;
        let (width, height) = size;
        let size = Size {
            n,
            width,
            height,
            entries,
            training: true,
        };
        let columns = columns(n_static, n_dynamic, layout);
        let pixels = size.pixels();
        let mut parts = vec![
            part("splats", &columns),
            part("moments", &[&columns[..], &columns[..], &[n]].concat()),
            part("gradients", &columns),
        ];
        parts.extend(work(&size));
        parts.push(part(
            "loss",
            &[9 * pixels, 9 * loss::tiles(width, height), LOSSES + 1],
        ));
        parts.push(density_control(&columns, n, pixels));
        // planes of bytes, each in words of its own
        let frame = part("frames", &[3 * pixels.div_ceil(4)]);
        parts.push(MemoryItem {
            what: "frames",
            bytes: frame.bytes * frames as u64,
            largest: if frames > 0 { frame.largest } else { 0 },
        });
        Self {
            doing: TRAINING,
            parts,
            frame_bytes: frame.bytes,
            frames,
            batch: part("gradients of a batch", &[&columns[..], &[n]].concat()),
            centres: part("gradients in the image", &[2 * n, n, n]),
        }
    }

    /// Drawing of this many splats into images of `size`, as [`training`](Self::training).
    pub fn drawing(
        n_static: usize,
        n_dynamic: usize,
        layout: SplatLayout,
        size: (usize, usize),
        entries: usize,
    ) -> Self {
        let (width, height) = size;
        let size = Size {
            n: n_static + n_dynamic,
            width,
            height,
            entries,
            training: false,
        };
        let mut parts = vec![part("splats", &columns(n_static, n_dynamic, layout))];
        parts.extend(work(&size));
        let [batch, centres] =
            ["gradients of a batch", "gradients in the image"].map(|what| part(what, &[]));
        Self {
            doing: "drawing",
            parts,
            frame_bytes: 0,
            frames: 0,
            batch,
            centres,
        }
    }

    /// With `n_bound` splats bound to `windows`.
    #[must_use]
    pub fn with_bound(mut self, n_bound: usize, windows: &[Window]) -> Self {
        let mut buffers = Bound::lengths(n_bound, windows);
        if buffers.is_empty() {
            return self;
        }
        buffers.push(Moment::length(windows));
        if self.doing == TRAINING {
            let numbers = NODE_PARAMETERS
                * windows
                    .iter()
                    .map(|w| w.anchors().len() * w.keys().len())
                    .sum::<usize>();
            buffers.extend([
                numbers,
                numbers,
                windows.iter().map(|w| w.keys().len()).sum(),
            ]);
            // the lists are made anew where rows change
            buffers.extend([4 * n_bound, 4 * n_bound]);
            buffers.extend(Sort::lengths(4 * n_bound));
        }
        self.parts.push(part("bound splats", &buffers));
        self
    }

    /// With the second set of gradients that steps of several frames add theirs up in.
    #[must_use]
    pub fn with_batches(mut self) -> Self {
        self.parts.push(self.batch);
        self
    }

    /// With the gradients of the centres of splats in the image, and their sums over frames.
    #[must_use]
    pub fn with_image_gradients(mut self) -> Self {
        self.parts.push(self.centres);
        self
    }

    /// The parts: splats, moments, gradients, and so on.
    pub fn parts(&self) -> &[MemoryItem] {
        &self.parts
    }

    /// All parts together, bytes.
    pub fn total(&self) -> u64 {
        self.parts.iter().map(|part| part.bytes).sum()
    }

    /// What one frame takes, bytes; 0 for drawing.
    pub fn frame_bytes(&self) -> u64 {
        self.frame_bytes
    }

    /// All but the frames, bytes.
    pub fn without_frames(&self) -> u64 {
        self.total() - self.frame_bytes * self.frames as u64
    }

    /// The bytes that `limit_bytes` leaves for frames, 0 if it leaves none: with less than all of
    /// them need, frames are to be sent to the device as they are used.
    pub fn frames_budget(&self, limit_bytes: u64) -> u64 {
        limit_bytes.saturating_sub(self.without_frames())
    }

    /// Whether everything fits into `limit_bytes`. Fails with [`GpuError::OverLimit`] with the size
    /// of every part.
    pub fn check(&self, limit_bytes: u64) -> Result<(), GpuError> {
        if self.total() <= limit_bytes {
            return Ok(());
        }
        Err(GpuError::OverLimit {
            doing: self.doing,
            needed: megabytes(self.total()),
            limit: limit_bytes / 1_000_000,
            parts: self.to_string(),
        })
    }

    /// Whether the device allows buffers as large as the largest of each part.
    /// Fails with [`GpuError::TooLarge`] with the part whose buffer is not allowed.
    pub fn check_buffers(&self, gpu: &Gpu) -> Result<(), GpuError> {
        self.parts
            .iter()
            .try_for_each(|part| gpu.fits(part.what, part.largest as usize))
    }
}

impl std::fmt::Display for Plan {
    /// `splats 6 MB, moments 11 MB, ...`
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (i, part) in self.parts.iter().enumerate() {
            let comma = if i == 0 { "" } else { ", " };
            write!(f, "{comma}{} {} MB", part.what, megabytes(part.bytes))?;
        }
        Ok(())
    }
}

fn megabytes(bytes: u64) -> u64 {
    bytes.div_ceil(1_000_000)
}

/// Temporary memory: scores of splats and the order of a frame's errors, or the order of the scores
/// and the outcome of each splat, or splats and a moment twice while their rows change, or the sums
/// of colours.
fn density_control(columns: &[usize], n: usize, pixels: usize) -> MemoryItem {
    let mut scores = vec![
        2 * n,
        2 * n,
        pixels,
        pixels,
        pixels,
        2 * pixels.div_ceil(256),
    ];
    scores.extend(Sort::lengths(pixels));
    let mut decision = vec![2 * n, 2 * n, n, n, n, 2 * n, 2 * n, n.div_ceil(256)];
    decision.extend(Sort::lengths(n));
    decision.extend(Scan::lengths(2 * n));
    let rows = [columns, columns, &[n, 2 * n, 2 * n, n, n, n]].concat();
    let what = "density control";
    let all = [
        part(what, &scores),
        part(what, &decision),
        part(what, &rows),
        part(what, &[6 * n]),
    ];
    MemoryItem {
        what,
        bytes: all.iter().map(|part| part.bytes).max().unwrap_or(0),
        largest: all.iter().map(|part| part.largest).max().unwrap_or(0),
    }
}

/// The three buffers of numbers per splat.
fn columns(n_static: usize, n_dynamic: usize, layout: SplatLayout) -> [usize; 3] {
    let [geometry, colour, time] = parts(layout).map(|columns| columns.len());
    let n = n_static + n_dynamic;
    [geometry * n, colour * n, time * n_dynamic]
}

/// What [`Work`](crate::renderer::gpu::Work) makes.
fn work(size: &Size) -> Vec<MemoryItem> {
    let (n, entries, tiles, pixels) = (size.n, size.entries, size.tiles(), size.pixels());
    let splats = [RECORD * n, REACH * n, n, n, n, n, n, EYE];
    let mut lists = vec![entries; 6];
    lists.extend([2 * tiles, tiles, tiles, tiles, tiles + 1, ALLOCATED, TOTALS]);
    let mut parts = vec![
        part("splats of a frame", &splats),
        part("tile lists", &lists),
        part("image", &[5 * pixels, pixels]),
    ];
    if size.training {
        let buckets = size.buckets();
        parts.push(part("gradients of tile entries", &[SUMS * entries]));
        parts.push(part(
            "what gradients start from",
            &[buckets, CHECKPOINT * TILE * TILE * buckets],
        ));
        parts.push(part("gradient of the image", &[3 * pixels]));
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::Plan;
    use crate::gpu::GpuError;
    use crate::renderer::gpu::Size;
    use m4_core::{Pose, SplatLayout, Window};

    const LAYOUT: SplatLayout = SplatLayout {
        isotropic: false,
        sh_degree: 0,
        time_degree: 0,
    };

    fn plan(frames: usize) -> Plan {
        Plan::training(
            20_000,
            80_000,
            LAYOUT,
            (480, 360),
            frames,
            Size::first_entries(100_000),
        )
    }

    #[test]
    fn splat_memory_is_the_size_of_the_columns() {
        let plan = plan(10);
        let of = |what| plan.parts().iter().find(|p| p.what == what).unwrap().bytes;
        let splats = 4 * (14 * 100_000 + 8 * 80_000);
        assert_eq!(of("splats"), splats);
        assert_eq!(of("moments"), 2 * splats + 4 * 100_000);
        assert_eq!(of("frames"), 10 * 3 * 480 * 360);
        assert_eq!(
            plan.total(),
            plan.without_frames() + 10 * plan.frame_bytes()
        );
        assert_eq!(
            plan.clone().with_batches().total(),
            plan.total() + splats + 4 * 100_000
        );
        assert_eq!(
            plan.clone().with_image_gradients().total(),
            plan.total() + 4 * 4 * 100_000
        );
    }

    #[test]
    fn bound_splats_are_counted_where_there_are_windows() {
        let pose = Pose {
            position: [0.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        let window =
            Window::new(vec![0.0, 1.0, 2.0], vec![[0.0; 3]; 200], vec![pose; 600]).unwrap();
        assert_eq!(plan(1).with_bound(0, &[]), plan(1));
        let bound = |plan: Plan| {
            plan.parts()
                .iter()
                .find(|p| p.what == "bound splats")
                .unwrap()
                .bytes
        };
        let few = bound(plan(1).with_bound(1000, std::slice::from_ref(&window)));
        let more = bound(plan(1).with_bound(11_000, std::slice::from_ref(&window)));
        // bindings, what is drawn, and lists; twice keys, values and digits to sort lists
        assert!(
            (10_000 * 4 * 34..10_000 * 4 * 50).contains(&(more - few)),
            "{few} to {more} bytes"
        );
        let drawing =
            Plan::drawing(20_000, 80_000, LAYOUT, (480, 360), 1000).with_bound(1000, &[window]);
        // poses are trained: two moments and the counts of their steps
        let moments = 4 * (2 * 6 * 600 + 3);
        assert!(few >= bound(drawing) + moments, "moments");
    }

    #[test]
    fn exceeding_the_memory_limit_lists_every_part() {
        let plan = plan(500);
        assert!(plan.check(plan.total()).is_ok());
        let error = plan.check(100_000_000).unwrap_err();
        assert!(
            matches!(error, GpuError::OverLimit { limit: 100, .. }),
            "{error}"
        );
        let text = error.to_string();
        for part in plan.parts() {
            assert!(text.contains(part.what), "{text} lacks {}", part.what);
        }
    }

    #[test]
    fn remaining_memory_is_given_to_frames() {
        let plan = plan(500);
        let ten = plan.without_frames() + 10 * plan.frame_bytes();
        assert_eq!(plan.frames_budget(ten), 10 * plan.frame_bytes());
        assert_eq!(plan.frames_budget(1000), 0);
        assert!(plan.frames_budget(u64::MAX) > 500 * plan.frame_bytes());
    }
}
