//! Frames of a clip as the network takes them.

use super::clip::PosedClip;
use super::depth::{Histogram, cleaned, resized};
use super::frame::{
    Frame, Geometry, PosedPinhole, Sides, image_tensor, map_sizes, maps, rows_of, sampled,
};
use super::neighbours::{Cloud, Search};
use super::{Net, Tapip3d, Tapip3dOptions};
use crate::NetError;
use crate::error::refuse;
use burn_core::tensor::Tensor;
use m4_core::Progress;
use m4_core::nalgebra::Vector3;
use rayon::prelude::*;

/// A clip, and how its frames are brought to what the network takes.
pub struct Source<'a> {
    pub net: &'a Tapip3d,
    clip: &'a dyn PosedClip,
    pub options: &'a Tapip3dOptions,
    /// The place of the world that is the origin here.
    pub origin: Vector3<f64>,
}

fn bad_frame(frame: usize, reason: &str) -> NetError {
    NetError::Input(format!(
        "frame {frame} cannot be used to track points: {reason}"
    ))
}

/// No depth is known in these frames.
pub fn no_depth(first: usize, last: usize) -> NetError {
    NetError::Input(format!(
        "no depth is known in frames {first} to {last}: points cannot be tracked there"
    ))
}

/// A frame before its features are prepared.
pub struct Loaded {
    pub maps: Vec<Tensor<2>>,
    pub geometry: Geometry,
    /// Depth, `[h][w]`.
    pub z: Vec<f32>,
}

impl Loaded {
    /// As windows take it.
    pub fn frame(self, net: &Tapip3d) -> Frame {
        let prepared = |map: Tensor<2>| net.net.corr_processor.prepared(map);
        Frame {
            features: self.maps.into_iter().map(prepared).collect(),
            points: self.geometry.points,
            moments: self.geometry.moments,
        }
    }
}

impl<'a> Source<'a> {
    /// Of `clip`, in a world whose origin is the first camera.
    pub fn new(
        net: &'a Tapip3d,
        clip: &'a dyn PosedClip,
        options: &'a Tapip3dOptions,
    ) -> Result<Self, NetError> {
        if clip.frames() == 0 {
            return refuse("points cannot be tracked in a clip without frames");
        }
        let camera = clip
            .camera(0)
            .map_err(|reason| NetError::Frame { frame: 0, reason })?;
        let source = Self {
            net,
            clip,
            options,
            origin: camera.centre(),
        };
        source.lens(0)?;
        Ok(source)
    }

    fn lens(&self, frame: usize) -> Result<PosedPinhole, NetError> {
        let camera = self
            .clip
            .camera(frame)
            .map_err(|reason| NetError::Frame { frame, reason })?;
        PosedPinhole::new(&camera, self.options.size, &self.origin).ok_or_else(|| {
            bad_frame(
                frame,
                "its camera has no positive focal lengths, or numbers that are not finite",
            )
        })
    }

    /// Depth of `frame` in the network's size, and its camera.
    fn depth(&self, frame: usize) -> Result<(PosedPinhole, Vec<f32>), NetError> {
        let lens = self.lens(frame)?;
        let depth = self
            .clip
            .depth(frame)
            .map_err(|reason| NetError::Frame { frame, reason })?;
        if depth.data().is_empty() {
            return Err(bad_frame(frame, "its depth has no pixels"));
        }
        let size = self.options.size;
        let z = resized(&depth, size);
        let z = if self.options.clean_edges {
            cleaned(&z, size, &lens)
        } else {
            z
        };
        Ok((lens, z))
    }

    /// The depths that count, over all frames.
    pub fn range(&self, progress: &dyn Progress) -> Result<[f32; 2], NetError> {
        let mut histogram = Histogram::new();
        let frames = self.clip.frames();
        for frame in 0..frames {
            if progress.cancelled() {
                return Err(NetError::Cancelled);
            }
            histogram.add(&self.depth(frame)?.1);
            progress.update("depth to follow points in", frame + 1, frames, "");
        }
        let last = frames - 1;
        histogram.range().ok_or_else(|| no_depth(0, last))
    }

    /// `frame` with its features; depths within `range` count.
    pub fn load(&self, frame: usize, range: [f32; 2]) -> Result<Loaded, NetError> {
        let (lens, z) = self.depth(frame)?;
        let image = self
            .clip
            .image(frame)
            .map_err(|reason| NetError::Frame { frame, reason })?;
        if image.data().is_empty() {
            return Err(bad_frame(frame, "its image has no pixels"));
        }
        let (net, config) = (&self.net.net, &self.net.config);
        let image = image_tensor(
            &image,
            self.options.size,
            &self.net.device,
            net.encoder.dtype(),
        );
        Ok(Loaded {
            maps: maps(net, image, config.levels),
            geometry: Geometry::new(lens, &z, self.options.size, range, config.levels),
            z,
        })
    }

    /// Bytes of a frame of a window.
    pub fn frame_bytes(&self) -> usize {
        let pixels = (self.options.size.0 / 4) * (self.options.size.1 / 4);
        let channels = self.net.sizes.tokens * self.net.net.encoder.dtype().size();
        pixels * 4 / 3 * (channels + size_of::<[f32; 3]>())
    }
}

/// What the network knows of `queries`, which are points of the world in a frame with the features
/// `maps` (of the encoder) and the points `points`, a map per level, seen through `lens` in `size`.
pub fn sides(
    net: &Net,
    maps: &[Tensor<2>],
    points: &[Vec<[f32; 3]>],
    lens: &PosedPinhole,
    size: (usize, usize),
    queries: &[[f32; 3]],
    neighbours: usize,
) -> Sides {
    let sizes = map_sizes(size, maps.len());
    let pixels: Vec<[f64; 2]> = queries.iter().map(|&q| pixel_of(lens, size, q)).collect();
    let (mut features, mut around) = (Vec::new(), Vec::new());
    for ((map, points), (w, h)) in maps.iter().zip(points).zip(sizes) {
        let cloud = Cloud::new(points.clone());
        let near: Vec<Vec<u32>> = queries
            .par_iter()
            .map_init(Search::default, |search, &q| {
                cloud.nearest(q, neighbours, search).collect()
            })
            .collect();
        let scale = [w as f64 / size.0 as f64, h as f64 / size.1 as f64];
        let places: Vec<[f64; 2]> = pixels
            .iter()
            .map(|p| [p[0] * scale[0], p[1] * scale[1]])
            .collect();
        let own = sampled(map, (w, h), &places);
        let others = rows_of(map, near.iter().flatten().map(|&i| i as i32).collect());
        let (n, [_, c]) = (queries.len(), own.dims());
        let both = Tensor::cat(
            vec![own.reshape([n, 1, c]), others.reshape([n, neighbours, c])],
            1,
        );
        let tokens = net
            .corr_processor
            .prepared(both.reshape([n * (1 + neighbours), c]));
        let [_, c] = tokens.dims();
        features.push(tokens.reshape([n, 1 + neighbours, c]));
        let with_near = queries.iter().zip(&near);
        around.push(
            with_near
                .flat_map(|(&q, near)| {
                    std::iter::once(q).chain(near.iter().map(|&i| points[i as usize]))
                })
                .collect(),
        );
    }
    Sides {
        features,
        points: around,
    }
}

/// Where a point is seen; as far out as two images.
fn pixel_of(lens: &PosedPinhole, (w, h): (usize, usize), q: [f32; 3]) -> [f64; 2] {
    let q = Vector3::from(q.map(f64::from));
    let [x, y] = lens.project(&q);
    let bound = |x: f64, n: usize| x.clamp(-2.0 * n as f64, 2.0 * n as f64);
    [bound(x, w), bound(y, h)]
}

impl Sides {
    /// These, then those of `others`; there is at least one.
    pub fn together(all: &[&Self]) -> Result<Self, NetError> {
        let Some(first) = all.first() else {
            return refuse("points cannot be tracked in a clip without frames");
        };
        let level = |level: usize| {
            let features = all
                .iter()
                .map(|sides| sides.features[level].clone())
                .collect();
            let points = all
                .iter()
                .flat_map(|sides| sides.points[level].iter().copied());
            (Tensor::cat(features, 0), points.collect())
        };
        let (features, points) = (0..first.features.len()).map(level).unzip();
        Ok(Self { features, points })
    }
}

/// `side` rows and columns of points that are spread over an image whose depth is `z` `[h][w]`,
/// where that is known.
pub fn grid(side: usize, z: &[f32], (w, h): (usize, usize), lens: &PosedPinhole) -> Vec<[f32; 3]> {
    let margin = w as f64 / 64.0;
    let along = |n: usize, i: usize| {
        if side == 1 {
            return n as f64 / 2.0;
        }
        let (first, last) = (margin, n as f64 - margin);
        first + (last - first) * i as f64 / (side - 1) as f64
    };
    let pixel = |x: f64, n: usize| (x.round_ties_even().max(0.0) as usize).min(n - 1);
    let places = (0..side).flat_map(|i| (0..side).map(move |j| (i, j)));
    places
        .filter_map(|(i, j)| {
            let (x, y) = (along(w, j), along(h, i));
            let z = z[pixel(y, h) * w + pixel(x, w)];
            (z > 0.0).then(|| lens.unproject([x, y], f64::from(z)))
        })
        .map(|p| [p.x as f32, p.y as f32, p.z as f32])
        .collect()
}
