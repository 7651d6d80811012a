//! Intermediate results of a clip in a cache: swept depth frame by frame, masks round by round, depth of static regions, and in
//! the end the result of every frame.

use super::error::DenseError;
use super::estimate::WorkingResult;
use super::motion_segmentation::Masks;
use super::static_depth::Measured;
use m4_core::{Cache, load, store};

/// The result of a clip at the working size; lists are `[frames][height][width]`.
pub(super) struct CachedDepth {
    /// One over z-depth.
    pub disparity: Vec<Vec<f32>>,
    /// How far the depth was measured, 0..1.
    pub confidence: Vec<Vec<f32>>,
    /// Above 0 in dynamic regions.
    pub moving: Vec<Vec<u8>>,
}

fn name(i: usize) -> String {
    format!("placed-{i:05}")
}

impl CachedDepth {
    /// Reads `count` frames of `pixels` pixels from the cache; `None` unless all are there.
    pub fn load(cache: &dyn Cache, count: usize, pixels: usize) -> Option<Self> {
        let mut all = Self {
            disparity: Vec::with_capacity(count),
            confidence: Vec::with_capacity(count),
            moving: Vec::with_capacity(count),
        };
        for i in 0..count {
            let bytes = cache.get(&name(i)).filter(|bytes| bytes.len() == 9 * pixels)?;
            let (disparity, rest) = bytes.split_at(4 * pixels);
            let (confidence, moving) = rest.split_at(4 * pixels);
            all.disparity.push(floats(disparity));
            all.confidence.push(floats(confidence));
            all.moving.push(moving.to_vec());
        }
        Some(all)
    }

    /// Takes the result out of `stages` and writes it to the cache.
    pub fn store(stages: &mut WorkingResult, cache: &dyn Cache) -> Self {
        let measured = std::mem::take(&mut stages.measured);
        let all = Self {
            disparity: std::mem::take(&mut stages.disparity),
            confidence: measured.into_iter().map(|measured| measured.confidence).collect(),
            moving: std::mem::take(&mut stages.moving),
        };
        for (i, ((disparity, confidence), moving)) in
            all.disparity.iter().zip(&all.confidence).zip(&all.moving).enumerate()
        {
            let mut frame = bytes(disparity);
            frame.extend(bytes(confidence));
            frame.extend_from_slice(moving);
            cache.put(&name(i), &frame);
        }
        all
    }
}

/// Returns the `count` cached numbers of this name, else computes and caches them.
pub(super) fn numbers(cache: &dyn Cache, name: &str, count: usize, work: impl FnOnce() -> Vec<f32>) -> Vec<f32> {
    if let Some(kept) = cache.get(name).filter(|bytes| bytes.len() == 4 * count) {
        return floats(&kept);
    }
    let made = work();
    cache.put(name, &bytes(&made));
    made
}

/// Masks of all `count` frames under this name: kept ones, else what `work` gives, which are kept then.
pub(super) fn masks(
    cache: &dyn Cache,
    name: &str,
    count: usize,
    pixels: usize,
    work: impl FnOnce() -> Result<Masks, DenseError>,
) -> Result<Masks, DenseError> {
    let name = |i: usize| format!("{name}-{i:05}");
    let get = |i: usize| cache.get(&name(i)).filter(|mask| mask.len() == pixels);
    if let Some(kept) = (0..count).map(get).collect() {
        return Ok(kept);
    }
    let made = work()?;
    for (i, mask) in made.iter().enumerate() {
        cache.put(&name(i), mask);
    }
    Ok(made)
}

/// Depth of static regions, and the same filled in everywhere.
type Still = (Vec<Measured>, Vec<Vec<f32>>);

/// The same of depth of static regions.
pub(super) fn still(
    cache: &dyn Cache,
    count: usize,
    pixels: usize,
    work: impl FnOnce() -> Result<Still, DenseError>,
) -> Result<Still, DenseError> {
    let name = |i: usize| format!("still-{i:05}");
    let get = |i: usize| {
        let kept: (Measured, Vec<f32>) = load(cache, &name(i))?;
        let sizes = [kept.0.disparity.len(), kept.0.confidence.len(), kept.1.len()];
        (sizes == [pixels; 3]).then_some(kept)
    };
    if let Some(kept) = (0..count).map(get).collect::<Option<Vec<_>>>() {
        return Ok(kept.into_iter().unzip());
    }
    let made = work()?;
    for (i, frame) in made.0.iter().zip(&made.1).enumerate() {
        store(cache, &name(i), &frame);
    }
    Ok(made)
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    let (numbers, _) = bytes.as_chunks();
    numbers.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

fn bytes(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
}
