//! The state of the tracking network for a clip, and its queries.
//!
//! ```text
//! enter, leave: edges, whose hidden states start as their source's
//! motion_px: one update from a frame's state      revise_source: one update of all edges of a frame
//! ```
//!
//! Features, first states and hidden states lie in a store within a budget of memory; what it has
//! no room for lies in a nameless file. Numbers are rounded whenever they enter the store, so that
//! no answer depends on the budget.

mod revise;
mod store;
#[cfg(test)]
mod tests;

pub use revise::EdgeUpdate;
pub use store::Storage;

use super::update::{LEVELS, RADIUS};
use super::{DroidNet, WIDTH};
use crate::correlation::{FeatureMap, Pyramid, scores};
use crate::error::{numbers as read, refuse};
use crate::ops::tensor;
use crate::{ImageReader, NetError};
use burn_core::tensor::{DType, Tensor};
use m4_core::RgbImage;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::{fmt, io};
use store::Store;

/// How a memory keeps what it keeps.
#[derive(Debug, Clone)]
pub struct MemoryOptions {
    /// Bytes of features and states that may lie in memory; more goes to a file.
    pub budget_bytes: usize,
    /// How they are kept.
    pub storage: Storage,
    /// The folder of that file, which has no name and goes away with the memory.
    pub scratch: PathBuf,
}

/// What is in the store; each is `128 * h * w` numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Key {
    /// Of a frame, `[h][w][128]`.
    Features(usize),
    /// The hidden state that edges of a frame start with, `[128][h][w]`.
    First(usize),
    /// Of a frame, `[128][h][w]`.
    Context(usize),
    /// Of an edge, `[128][h][w]`.
    Hidden(u64),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Edge {
    source: usize,
    target: usize,
}

/// The network's memory of one clip. Frames are numbers in the clip, edges have identities of the
/// caller's choice.
pub struct DroidMemory<'a> {
    net: Arc<DroidNet>,
    store: Store<Key>,
    images: ImageReader<'a>,
    edges: HashMap<u64, Edge>,
    /// Columns and rows of the images, once one was seen.
    size: Option<(usize, usize)>,
}

impl fmt::Debug for DroidMemory<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DroidMemory")
            .field("size", &self.size)
            .field("edges", &self.edges.len())
            .finish_non_exhaustive()
    }
}

impl<'a> DroidMemory<'a> {
    /// An empty memory. `images` is asked for a frame whose features or first state are needed; all
    /// have one size, whose sides are multiples of 8 and at least 128 pixels.
    #[must_use]
    pub fn new(net: Arc<DroidNet>, options: MemoryOptions, images: ImageReader<'a>) -> Self {
        Self {
            net,
            store: Store::new(options.budget_bytes, options.storage, options.scratch),
            images,
            edges: HashMap::new(),
            size: None,
        }
    }

    /// Columns and rows of the grid, an eighth of the images'; none before an image was seen.
    fn grid(&self) -> (usize, usize) {
        self.size.map_or((0, 0), |(w, h)| (w / 8, h / 8))
    }

    /// Starts an edge: where the pixels of `source` are in `target`. One that is there already
    /// starts again.
    pub fn enter(&mut self, edge_id: u64, source: usize, target: usize) {
        self.store.remove(Key::Hidden(edge_id));
        self.edges.insert(edge_id, Edge { source, target });
    }

    /// Forgets an edge; nothing happens if it is missing.
    pub fn leave(&mut self, edge_id: u64) {
        self.store.remove(Key::Hidden(edge_id));
        self.edges.remove(&edge_id);
    }

    /// Mean length of what one update from the first state of `from`, at rest, says of the motion
    /// to `to`: pixels of the grid.
    ///
    /// # Errors
    ///
    /// [`NetError`] if an image cannot be had or does not fit, or if file or device fail.
    pub fn motion_px(&mut self, from: usize, to: usize) -> Result<f64, NetError> {
        let [hidden, context] = self.first_state(from)?;
        let source = FeatureMap::new(self.features(from)?);
        let (w, h) = self.grid();
        let grid = (0..w * h)
            .flat_map(|i| [(i % w) as f32, (i / w) as f32])
            .collect();
        let corr = self.correlation(&source, to, grid)?;
        let update = &self.net.net.update;
        let context = self.net.gru.context(context);
        let hidden = update.advance(&self.net.gru, hidden, context, corr, None);
        let delta = read(update.delta(hidden))?;
        let (u, v) = delta.split_at(w * h);
        let lengths = u
            .iter()
            .zip(v)
            .map(|(u, v)| f64::from(*u).hypot(f64::from(*v)));
        Ok(lengths.sum::<f64>() / (w * h).max(1) as f64)
    }

    /// Features of `frame`, `[h, w, 128]`.
    fn features(&mut self, frame: usize) -> Result<Tensor<3>, NetError> {
        if !self.store.contains(Key::Features(frame)) {
            let image = self.image(frame)?;
            let features = self.net.features(&image)?;
            self.keep(Key::Features(frame), features.permute([0, 2, 3, 1]))?;
        }
        let values = self.load(Key::Features(frame))?;
        let (w, h) = self.grid();
        Ok(tensor(values, [h, w, WIDTH], &self.net.device).cast(self.net.dtype()))
    }

    /// Hidden state and context that edges of `frame` start with, `[1, 128, h, w]` each.
    fn first_state(&mut self, frame: usize) -> Result<[Tensor<4>; 2], NetError> {
        let keys = [Key::First(frame), Key::Context(frame)];
        if !keys.iter().all(|&key| self.store.contains(key)) {
            let image = self.image(frame)?;
            let parts = self.net.state(&image)?;
            for (key, part) in keys.into_iter().zip(parts) {
                self.keep(key, part)?;
            }
        }
        Ok([self.map(keys[0])?, self.map(keys[1])?])
    }

    /// Scores `[1, 196, h, w]` of `source` in `target` around `centres` `[h][w][2]`.
    fn correlation(
        &mut self,
        source: &FeatureMap,
        target: usize,
        centres: Vec<f32>,
    ) -> Result<Tensor<4>, NetError> {
        let target = Pyramid::new(self.features(target)?, LEVELS);
        let (w, h) = self.grid();
        let centres = tensor(centres, [h, w, 2], &self.net.device).cast(DType::F32);
        let scores = scores(source, &target, centres, RADIUS);
        Ok(scores.permute([2, 0, 1]).unsqueeze())
    }

    fn image(&mut self, frame: usize) -> Result<RgbImage, NetError> {
        let image = (self.images)(frame).map_err(|reason| NetError::Frame { frame, reason })?;
        self.check_size(frame, &image)?;
        Ok(image)
    }

    fn check_size(&mut self, frame: usize, image: &RgbImage) -> Result<(), NetError> {
        let got = image.size();
        super::check(got)?;
        let expected = *self.size.get_or_insert(got);
        if got == expected {
            return Ok(());
        }
        refuse(format!(
            "frame {frame} has {} x {} px where the frames before have {} x {}; a clip has one size",
            got.0, got.1, expected.0, expected.1
        ))
    }

    fn keep<const D: usize>(&mut self, key: Key, values: Tensor<D>) -> Result<(), NetError> {
        let values = read(values)?;
        self.store
            .put(key, &values)
            .map_err(|e| self.scratch_failed(e))
    }

    fn load(&mut self, key: Key) -> Result<Vec<f32>, NetError> {
        let values = self.store.get(key).map_err(|e| self.scratch_failed(e))?;
        values.ok_or_else(|| self.scratch_failed(io::ErrorKind::NotFound.into()))
    }

    /// What is under `key` as a map, `[1, 128, h, w]`.
    fn map(&mut self, key: Key) -> Result<Tensor<4>, NetError> {
        let (w, h) = self.grid();
        Ok(tensor(self.load(key)?, [1, WIDTH, h, w], &self.net.device).cast(self.net.dtype()))
    }

    fn scratch_failed(&self, reason: io::Error) -> NetError {
        let folder = self.store.folder().display();
        NetError::Input(format!(
            "the network's state cannot be stored in a file in {folder}: {reason}; is the disk full?"
        ))
    }
}
