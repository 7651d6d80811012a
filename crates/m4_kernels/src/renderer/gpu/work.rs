//! The memory and the kernel launches of one frame.

use super::size::{BUCKET, Size};
use crate::blend::gpu::{self as blend, backward as blend_backward, backward::SUMS};
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::{Gpu, GpuError, Stopwatch};
use crate::launch;
use crate::pose::gpu::{self as pose, Moment};
use crate::project::gpu::eye;
use crate::splats::DeviceSplats;
use crate::stage::gpu::{Spec, project, project_backward, sum_large};
use crate::tile_binning::gpu::{
    ALLOCATED, LARGE_CUBES, REACH, RECORD, TILE, TOTALS, WANTED, entries, sort, starts,
};
use crate::{Kernel, View};
use cubecl::prelude::{CubeCount, CubeDim};

/// Numbers of a checkpoint: transmittance, colours.
pub(crate) const CHECKPOINT: usize = 4;

/// Buffers for frames of one size.
#[derive(Debug)]
pub struct Work {
    /// What there is room for.
    pub size: Size,
    pub(crate) eye: Buffer,
    pub(crate) records: Buffer,
    reaches: Buffer,
    /// Bits of the depths, which lie in the order of the depths.
    depths: Buffer,
    /// Entries of each splat, and its first slot.
    pub(crate) counts: Buffer,
    pub(crate) offsets: Buffer,
    /// Where the tiles' counts change, and slots of all splats: 0 between frames.
    changes: Buffer,
    allocated: Buffer,
    /// Splats in many tiles.
    large: Buffer,
    cursors: Buffer,
    /// Depth and slot of each entry, tile after tile in any order, and sorted.
    lists: [Buffer; 2],
    sorted: [Buffer; 2],
    splat_of_slot: Buffer,
    pub(crate) splat_of_entry: Buffer,
    /// Where each tile's entries start and end.
    pub(crate) ranges: Buffer,
    /// The entry after the last that a pixel of the tile shows.
    tile_ends: Buffer,
    pub(crate) bucket_offsets: Buffer,
    pub(crate) tile_of_bucket: Buffer,
    /// Numbers of entries and buckets.
    pub(crate) totals: Buffer,
    checkpoints: Buffer,
    pub(crate) ends: Buffer,
    pub(crate) sums: Buffer,
    /// The largest number of entries that a frame wanted, first of what may be more numbers.
    pub peak: Buffer,
    /// Off outside of benches.
    pub stopwatch: Stopwatch,
    /// Red, green, blue, transmittance, depth: planes.
    pub image: Buffer,
    /// The loss's gradient with respect to the colours: planes.
    pub gradient: Buffer,
    /// 1 for splats that reached a pixel.
    pub touched: Buffer,
    /// The windows at the instant drawn last.
    moment: Option<Moment>,
    /// Window and key of the nodes whose gradients there are: sums over the frames since it was
    /// emptied.
    pub node_keys: Vec<(usize, usize)>,
}

impl Work {
    /// Buffers for frames of `size`. Fails with [`GpuError`] if a buffer is larger than the device
    /// allows.
    pub fn new(gpu: &Gpu, size: Size) -> Result<Self, GpuError> {
        let client = &gpu.client;
        let (n, tiles, pixels, entries) = (size.n, size.tiles(), size.pixels(), size.entries);
        let only_training = |len: usize| if size.training { len } else { 1 };
        let (buckets, sums) = (only_training(size.buckets()), only_training(SUMS * entries));
        let checkpoints = CHECKPOINT * TILE * TILE * buckets;
        for (what, len) in [
            ("the splats of a frame", RECORD * n),
            ("the tile entries of a frame", entries),
            ("the gradients of the tile entries", sums),
            ("what the gradient starts from in each tile", checkpoints),
            ("the image", 5 * pixels),
        ] {
            gpu.fits(what, 4 * len)?;
        }
        // the loss has a cube per tile of 16x16 pixels along one dimension
        if size.training && pixels > 65_535 * 256 {
            return Err(GpuError::TooLarge {
                what: "the image",
                needed: 20 * pixels / 1_000_000,
                limit: 20 * 65_535 * 256 / 1_000_000,
                name: gpu.adapter().name.clone(),
            });
        }
        let empty = |len: usize| Buffer::empty(client, len);
        Ok(Self {
            size,
            eye: empty(1),
            records: empty(RECORD * n),
            reaches: empty(REACH * n),
            depths: empty(n),
            counts: empty(n),
            offsets: empty(n),
            changes: Buffer::zeros(client, tiles + 1),
            allocated: Buffer::words(client, &[0; ALLOCATED]),
            large: empty(n),
            cursors: empty(tiles),
            lists: [empty(entries), empty(entries)],
            sorted: [empty(entries), empty(entries)],
            splat_of_slot: empty(entries),
            splat_of_entry: empty(entries),
            ranges: empty(2 * tiles),
            tile_ends: empty(tiles),
            bucket_offsets: empty(tiles),
            tile_of_bucket: empty(buckets),
            totals: empty(TOTALS),
            checkpoints: empty(checkpoints),
            ends: empty(pixels),
            sums: empty(sums),
            peak: Buffer::words(client, &[0]),
            stopwatch: Stopwatch::default(),
            image: empty(5 * pixels),
            gradient: empty(only_training(3 * pixels)),
            touched: empty(n),
            moment: None,
            node_keys: Vec::new(),
        })
    }

    /// Becomes memory for frames of `size`. What was there is given up first: both at once would be
    /// twice as much. After an error there is room for nothing. Fails with [`GpuError`] if a buffer
    /// is larger than the device allows.
    pub fn remake(&mut self, gpu: &Gpu, size: Size) -> Result<(), GpuError> {
        let nothing = Size {
            n: 0,
            width: 1,
            height: 1,
            entries: 1,
            training: false,
        };
        *self = Self::new(gpu, nothing)?;
        *self = Self::new(gpu, size)?;
        Ok(())
    }

    /// Draws `splats`, of which there are as many as the memory is for, into
    /// [`image`](Self::image).
    pub fn draw(&mut self, gpu: &Gpu, splats: &DeviceSplats, view: &View) {
        let client = &gpu.client;
        let (size, n) = (self.size, self.size.n);
        let (tiles, width, height) = (size.tiles(), size.width as u32, size.height as u32);
        self.eye = gpu.input_floats(&eye(view));
        let bound = splats.bound.as_ref();
        self.moment = bound.map(|bound| {
            pose::pose(
                bound,
                gpu,
                splats,
                &self.eye,
                view.t as f32,
                &self.node_keys,
            )
        });
        launch!(
            client,
            project::launch,
            (cubes(n, 256), units()),
            [
                splats.geometry,
                splats.colour,
                splats.time,
                splats.posed(&self.eye),
                self.eye,
                self.records,
                self.reaches,
                self.depths,
                self.counts,
                self.offsets,
                self.changes,
                self.allocated,
                self.large
            ],
            [
                n as u32,
                splats.n_static as u32,
                splats.n_still() as u32,
                size.across() as u32,
                Spec::new(splats, view.mip)
            ]
        );
        self.stopwatch.lap(gpu, Kernel::Project);
        self.make_lists(gpu);
        self.stopwatch.lap(gpu, Kernel::Bin);
        launch!(
            client,
            blend::blend::launch,
            (cubes(tiles, 1), CubeDim::new_1d((TILE * TILE) as u32)),
            [
                self.records,
                self.splat_of_entry,
                self.ranges,
                self.eye,
                self.bucket_offsets,
                self.image,
                self.checkpoints,
                self.ends,
                self.tile_ends
            ],
            [width, height, view.with_depth, size.training]
        );
        self.stopwatch.lap(gpu, Kernel::Blend);
    }

    /// The lists of the tiles, near to far, and their buckets.
    fn make_lists(&self, gpu: &Gpu) {
        let (client, size) = (&gpu.client, self.size);
        let (n, tiles, capacity) = (size.n, size.tiles() as u32, size.entries as u32);
        // a power of two
        let most = if gpu.adapter().max_units >= 1024 {
            1024
        } else {
            256
        };
        launch!(
            client,
            starts::tile_starts::launch,
            (cubes(1, 1), CubeDim::new_1d(most)),
            [
                self.changes,
                self.allocated,
                self.ranges,
                self.cursors,
                self.bucket_offsets,
                self.totals,
                self.peak
            ],
            [tiles, capacity, most]
        );
        launch!(
            client,
            entries::emit::launch,
            (cubes(n, 256), units()),
            [
                self.counts,
                self.offsets,
                self.reaches,
                self.depths,
                self.eye,
                self.ranges,
                self.cursors,
                self.lists[0],
                self.lists[1],
                self.splat_of_slot,
                self.totals
            ],
            [n as u32, size.across() as u32, capacity]
        );
        // not beside the others: it lowers counts by which they leave large splats out
        launch!(
            client,
            entries::emit_large::launch,
            (cubes(LARGE_CUBES, 1), units()),
            [
                self.counts,
                self.offsets,
                self.reaches,
                self.depths,
                self.eye,
                self.ranges,
                self.cursors,
                self.lists[0],
                self.lists[1],
                self.splat_of_slot,
                self.large,
                self.totals
            ],
            [size.across() as u32, capacity]
        );
        launch!(
            client,
            sort::sort_lists::launch,
            (cubes(size.tiles(), 1), CubeDim::new_1d(sort::UNITS)),
            [
                self.ranges,
                self.cursors,
                self.bucket_offsets,
                self.lists[0],
                self.lists[1],
                self.sorted[0],
                self.sorted[1],
                self.splat_of_slot,
                self.splat_of_entry,
                self.tile_of_bucket
            ],
            [tiles]
        );
    }

    /// The gradient with respect to `splats`, into `out` and [`touched`](Self::touched), from
    /// [`gradient`](Self::gradient); of the frame drawn last. That of nodes stays where they are,
    /// [`node_keys`](Self::node_keys) says of which. Into `camera` that with respect to the camera,
    /// ten sums for each cube of 256 splats; into `centres` those with respect to the projected
    /// centres, pixels to a side: `[2][n]`.
    pub fn backward(
        &mut self,
        gpu: &Gpu,
        splats: &DeviceSplats,
        out: &DeviceSplats,
        mip: bool,
        camera: Option<&Buffer>,
        centres: Option<&Buffer>,
    ) {
        let client = &gpu.client;
        let (size, n) = (self.size, self.size.n);
        let (width, height) = (size.width as u32, size.height as u32);
        // all since the image was drawn
        self.stopwatch.lap(gpu, Kernel::Photo);
        let (count, dim) = self.cubes_of_buckets();
        launch!(
            client,
            blend_backward::blend_backward::launch,
            (count, dim),
            [
                self.records,
                self.reaches,
                self.splat_of_entry,
                self.slot_of_entry(),
                self.ranges,
                self.tile_of_bucket,
                self.bucket_offsets,
                self.totals,
                self.checkpoints,
                self.image,
                self.gradient,
                self.ends,
                self.tile_ends,
                self.sums
            ],
            [width, height]
        );
        self.stopwatch.lap(gpu, Kernel::BlendBackward);
        launch!(
            client,
            sum_large::launch,
            (cubes(LARGE_CUBES, 1), units()),
            [
                self.counts,
                self.offsets,
                self.large,
                self.totals,
                self.sums
            ]
        );
        // any other memory where nothing is written
        let (camera_sums, centre_gradients) =
            (camera.unwrap_or(&self.peak), centres.unwrap_or(&self.image));
        launch!(
            client,
            project_backward::launch,
            (cubes(n, 256), units()),
            [
                splats.geometry,
                splats.colour,
                splats.time,
                splats.posed(&self.eye),
                self.eye,
                self.counts,
                self.offsets,
                self.sums,
                out.geometry,
                out.colour,
                out.time,
                self.touched,
                camera_sums,
                centre_gradients
            ],
            [
                n as u32,
                splats.n_static as u32,
                splats.n_still() as u32,
                Spec::new(splats, mip),
                camera.is_some(),
                centres.is_some()
            ]
        );
        if let (Some(bound), Some(moment)) = (&splats.bound, &self.moment) {
            pose::backward(bound, gpu, splats, out, &self.touched, &self.eye, moment);
            for &key in &moment.keys {
                if !self.node_keys.contains(&key) {
                    self.node_keys.push(key);
                }
            }
        }
        self.stopwatch.lap(gpu, Kernel::ProjectBackward);
    }

    /// How many entries the frame drawn last wanted. Fails with [`GpuError`] if the device failed.
    pub fn entries(&self, gpu: &Gpu, doing: &'static str) -> Result<usize, GpuError> {
        Ok(self.totals.read_words(&gpu.client, doing)?[WANTED] as usize)
    }

    /// The slot of each entry, tile after tile, of the frame drawn last.
    pub(crate) fn slot_of_entry(&self) -> &Buffer {
        &self.sorted[1]
    }

    /// Cubes of a bucket each, as many as there may be.
    pub(crate) fn cubes_of_buckets(&self) -> (CubeCount, CubeDim) {
        (
            cubes(self.size.buckets(), 1),
            CubeDim::new_1d(BUCKET as u32),
        )
    }

    /// The largest number of entries that a frame wanted since this memory was made.
    /// Fails with [`GpuError`] if the device failed.
    pub fn peak(&self, gpu: &Gpu, doing: &'static str) -> Result<usize, GpuError> {
        Ok(self.peak.read_words(&gpu.client, doing)?[0] as usize)
    }
}
