//! The renderer on the CPU: splats to an image, and gradients back.

use crate::{
    CameraGradient, Frame, Gradients, SimdLevel, View,
    blend::{
        cpu::{self as blend, Sums, Used},
        planes::{BandGradient, BandPlace, BandPlanes},
    },
    pose::cpu::Posed,
    project::cpu::Eye,
    simd::dispatch,
    slice::cpu::Columns,
    stage::{CameraSums, Chunk, ChunkGradient},
    tile_binning::{
        cpu::{BAND_ROWS, Band},
        handover::Row,
    },
};
use m4_core::Splats;
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// How much work a frame was and where its time went.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FrameStats {
    /// Splats that reach the image.
    pub visible: usize,
    /// Entries of all tile lists.
    pub pairs: usize,
    /// Entries of the tile lists before every pixel of the tile was finished.
    pub used: usize,
    /// Slice, project and shade, wall clock.
    pub project: Duration,
    /// Depth order and tile lists: a share of the wall clock of the bands, by time of the threads.
    pub bin: Duration,
    /// Blending, the other share.
    pub blend: Duration,
    /// Blending backward, wall clock.
    pub blend_backward: Duration,
    /// Shade, project and slice backward, wall clock.
    pub project_backward: Duration,
}

/// A band's splats, lists and gradient.
#[derive(Debug, Default)]
struct BandWork {
    band: Band,
    used: Used,
    sums: Vec<Sums>,
    scores: Vec<f32>,
    background: [f64; 3],
    bin: Duration,
    blend: Duration,
}

/// Draws splats and takes the gradient of what it drew; keeps its memory from frame to frame.
///
/// Work is cut into fixed chunks of rows and fixed bands of the image, whose results are joined in
/// order: same splats, view and level, same bits, on any number of threads. It runs on rayon's
/// current pool.
#[derive(Debug)]
pub struct Renderer {
    level: SimdLevel,
    frame: Frame,
    stats: FrameStats,
    eye: Eye,
    background: [f32; 3],
    posed: Posed,
    chunks: Vec<Chunk>,
    /// Projected splats, chunk after chunk.
    rows: Vec<Row>,
    bands: Vec<BandWork>,
}

impl Renderer {
    /// A renderer without memory yet.
    pub fn new(level: SimdLevel) -> Self {
        Self {
            level,
            frame: Frame::default(),
            stats: FrameStats::default(),
            eye: Eye::default(),
            background: [0.0; 3],
            posed: Posed::default(),
            chunks: Vec::new(),
            rows: Vec::new(),
            bands: Vec::new(),
        }
    }

    /// The instructions it runs on.
    pub fn level(&self) -> SimdLevel {
        self.level
    }

    /// Draws `splats` as `view` sees them.
    pub fn render(&mut self, splats: &Splats, view: &View) -> &Frame {
        let start = Instant::now();
        self.eye = Eye::new(view);
        self.background = view.background;
        let (width, height) = (self.eye.width, self.eye.height);
        let pixels = width * height;
        let frame = &mut self.frame;
        (frame.width, frame.height) = (width, height);
        for plane in frame.rgb.iter_mut().chain([&mut frame.transmittance]) {
            plane.resize(pixels, 0.0);
        }
        frame
            .depth
            .resize(if view.with_depth { pixels } else { 0 }, 0.0);
        let bands = if width == 0 {
            0
        } else {
            height.div_ceil(BAND_ROWS)
        };
        self.bands.resize_with(bands, BandWork::default);
        Chunk::plan(&mut self.chunks, splats, bands);
        self.posed.pose(splats, view.t as f32);

        let (level, eye, columns) = (self.level.level(), &self.eye, Columns::new(splats));
        let (posed, bound) = (Columns::posed(splats, &self.posed), splats.bound());
        self.rows
            .resize(self.chunks.iter().map(Chunk::room).sum(), Row::default());
        let mut rest = self.rows.as_mut_slice();
        let mut tasks: Vec<(&mut Chunk, &mut [Row])> = Vec::with_capacity(self.chunks.len());
        for chunk in &mut self.chunks {
            let rows = rest.split_off_mut(..chunk.room()).unwrap_or_default();
            tasks.push((chunk, rows));
        }
        tasks
            .par_iter_mut()
            .with_max_len(1)
            .for_each(|(chunk, rows)| {
                let columns = if bound.contains(&chunk.rows.start) {
                    &posed
                } else {
                    &columns
                };
                dispatch!(level, s => chunk.forward(s, columns, eye, rows));
            });
        let projected = Instant::now();
        self.draw();

        let stats = &mut self.stats;
        stats.project = projected - start;
        let wall = projected.elapsed();
        let bin: Duration = self.bands.iter().map(|b| b.bin).sum();
        let blend: Duration = self.bands.iter().map(|b| b.blend).sum();
        let share = bin.as_secs_f64() / (bin + blend).as_secs_f64().max(1e-12);
        stats.bin = wall.mul_f64(share);
        stats.blend = wall.saturating_sub(stats.bin);
        &self.frame
    }

    /// Tile lists and blending, band by band.
    fn draw(&mut self) {
        if self.bands.is_empty() {
            return;
        }
        let (level, background, eye) = (self.level.level(), self.background, &self.eye);
        let size = BAND_ROWS * eye.width;
        let Frame {
            rgb: [red, green, blue],
            transmittance,
            depth,
            ..
        } = &mut self.frame;
        // without depth the bands get empty slices
        let depth_bands: Vec<&mut [f32]> = depth.chunks_mut(size).collect();
        let mut depth_bands = depth_bands.into_iter();
        let planes: Vec<BandPlanes<'_>> = red
            .chunks_mut(size)
            .zip(green.chunks_mut(size))
            .zip(blue.chunks_mut(size))
            .zip(transmittance.chunks_mut(size))
            .map(|(((r, g), b), transmittance)| BandPlanes {
                rgb: [r, g, b],
                transmittance,
                depth: depth_bands.next().unwrap_or_default(),
            })
            .collect();
        let (chunks, rows) = (&self.chunks, self.rows.as_slice());
        let splats = |index: usize| chunks.iter().map(|c| c.bands[index].splats()).sum();
        let tasks = self.bands.iter_mut().zip(planes).enumerate();
        let tasks = tasks.map(|(index, task)| (splats(index), (index, task)));
        heaviest_first(tasks.collect(), |(index, (work, mut planes))| {
            let start = Instant::now();
            let place = place(eye, index);
            let handed = chunks.iter().map(|c| &c.bands[index]);
            work.band.collect(rows, handed, place.blocks());
            work.band.build();
            work.bin = start.elapsed();
            let (band, used) = (&work.band, &mut work.used);
            dispatch!(level, s => blend::forward(s, band, rows, place, background, &mut planes, used));
            work.blend = start.elapsed() - work.bin;
        });
    }

    /// What the last call of [`render`](Self::render) drew.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The gradient of a loss with respect to splats and camera, given that with respect to the
    /// colours of the frame drawn last (same layout as [`Frame::rgb`]). Panics if `splats` are not
    /// as many as those drawn, or a plane of `gradient` has another size than the frame.
    pub fn backward(
        &mut self,
        splats: &Splats,
        gradient: &[Vec<f32>; 3],
        with_camera: bool,
        out: &mut Gradients,
    ) {
        let start = Instant::now();
        self.check(splats.n());
        out.resize(splats);
        self.blend_backward(gradient);
        let blended = Instant::now();
        for work in &self.bands {
            for (sum, v) in out.background.iter_mut().zip(work.background) {
                *sum += v as f32;
            }
        }
        self.project_backward(splats, with_camera, out);
        self.stats.blend_backward = blended - start;
        self.stats.project_backward = blended.elapsed();
    }

    /// Sums of every band.
    fn blend_backward(&mut self, gradient: &[Vec<f32>; 3]) {
        let (level, eye, frame, rows) = (
            self.level.level(),
            &self.eye,
            &self.frame,
            self.rows.as_slice(),
        );
        let pixels = frame.transmittance.len();
        for plane in gradient {
            assert_eq!(
                plane.len(),
                pixels,
                "backward: the gradient has the frame's size"
            );
        }
        let tasks = self.bands.iter_mut().enumerate();
        let tasks = tasks.map(|(index, work)| (work.band.lists.len(), (index, work)));
        heaviest_first(tasks.collect(), |(index, work)| {
            let place = place(eye, index);
            let first = place.top * place.width;
            let part = first..first + place.rows * place.width;
            let g = BandGradient {
                rgb: frame.rgb.each_ref().map(|plane| &plane[part.clone()]),
                transmittance: &frame.transmittance[part.clone()],
                d_rgb: gradient.each_ref().map(|plane| &plane[part.clone()]),
            };
            let (band, used, sums) = (&work.band, &work.used, &mut work.sums);
            work.background =
                dispatch!(level, s => blend::backward(s, band, rows, place, used, &g, sums));
        });
    }

    /// Gradients of the columns, chunk by chunk; that of the camera added in the order of the
    /// chunks.
    fn project_backward(&self, splats: &Splats, with_camera: bool, out: &mut Gradients) {
        let (level, eye, columns) = (self.level.level(), &self.eye, Columns::new(splats));
        let (posed, bound) = (Columns::posed(splats, &self.posed), splats.bound());
        let n_static = splats.n_static();
        let mut parts = split(&self.chunks, n_static, out);
        let camera: Vec<CameraSums> = self
            .chunks
            .par_iter()
            .zip(parts.par_iter_mut())
            .enumerate()
            .with_max_len(1)
            .map(|(index, (chunk, part))| {
                let mut sums: Vec<&[Sums]> = self
                    .bands
                    .iter()
                    .map(|work| &work.sums[work.band.chunk_start[index]..])
                    .collect();
                let columns = if bound.contains(&chunk.rows.start) {
                    &posed
                } else {
                    &columns
                };
                dispatch!(level, s => chunk.backward(s, columns, eye, &mut sums, with_camera, part))
            })
            .collect();
        drop(parts);
        self.posed.backward(splats, out);
        let mut total = CameraSums::default();
        for part in camera {
            for (sum, v) in total.iter_mut().zip(part) {
                *sum += v;
            }
        }
        out.camera = CameraGradient {
            tau: std::array::from_fn(|k| total[k]),
            omega: std::array::from_fn(|k| total[3 + k]),
            intrinsics: std::array::from_fn(|k| total[6 + k]),
        };
    }

    /// Adds to `out[i]` the sum of `weight` over the pixels that splat `i` was composited on, times
    /// its temporal marginal ([`crate::score`]); of the frame drawn last.
    ///
    /// `weight` is `[height][width]`, `out` is `[n]`. Panics if `weight` or `out` has another
    /// length than that.
    pub fn score(&mut self, weight: &[f32], out: &mut [f32]) {
        self.check(out.len());
        assert_eq!(
            weight.len(),
            self.frame.transmittance.len(),
            "score: one weight a pixel"
        );
        let (level, eye, rows) = (self.level.level(), &self.eye, self.rows.as_slice());
        self.bands
            .par_iter_mut()
            .enumerate()
            .with_max_len(1)
            .for_each(|(index, work)| {
                let place = place(eye, index);
                let weight = &weight[place.top * place.width..][..place.rows * place.width];
                let (band, used, scores) = (&work.band, &work.used, &mut work.scores);
                dispatch!(level, s => blend::score(s, band, rows, place, used, weight, scores));
            });
        let (bands, mut rest) = (&self.bands, out);
        for (index, chunk) in self.chunks.iter().enumerate() {
            let (rows, after) = rest.split_at_mut(chunk.rows.len());
            rest = after;
            let mut scores: Vec<&[f32]> = bands
                .iter()
                .map(|work| &work.scores[work.band.chunk_start[index]..])
                .collect();
            chunk.score(&mut scores, rows);
        }
    }

    /// How much work the frame drawn last was.
    pub fn stats(&self) -> FrameStats {
        // counted when asked for: training does not ask
        FrameStats {
            visible: self.chunks.iter().map(Chunk::visible).sum(),
            pairs: self.bands.iter().map(|b| b.band.pairs()).sum(),
            used: self.bands.iter().map(|b| b.used.total()).sum(),
            ..self.stats
        }
    }

    fn check(&self, n: usize) {
        let drawn = self.chunks.last().map_or(0, |c| c.rows.end);
        assert_eq!(
            n, drawn,
            "the renderer drew {drawn} splats last; draw these first"
        );
    }
}

/// Runs tasks on the threads of the pool, those of the greatest cost first: then no thread is left
/// with a long one at the end. The order has no effect on what they compute.
fn heaviest_first<T: Send>(mut tasks: Vec<(usize, T)>, run: impl Fn(T) + Send + Sync) {
    tasks.sort_by_key(|&(cost, _)| std::cmp::Reverse(cost));
    tasks
        .into_iter()
        .par_bridge()
        .for_each(|(_, task)| run(task));
}

/// Where band `index` lies.
fn place(eye: &Eye, index: usize) -> BandPlace {
    let top = index * BAND_ROWS;
    BandPlace {
        top,
        rows: (eye.height - top).min(BAND_ROWS),
        width: eye.width,
    }
}

/// Cuts the gradients into the rows of each chunk.
fn split<'a>(chunks: &[Chunk], n_static: usize, out: &'a mut Gradients) -> Vec<ChunkGradient<'a>> {
    let mut columns: Vec<&mut [f32]> = out.columns.iter_mut().map(Vec::as_mut_slice).collect();
    let n = out.touched.len();
    // columns of dynamic splats are shorter: they start at the first dynamic row
    let shared: Vec<bool> = columns.iter().map(|c| c.len() == n).collect();
    let mut touched = out.touched.as_mut_slice();
    let mut image = out.image.as_deref_mut().unwrap_or_default();
    let mut parts = Vec::with_capacity(chunks.len());
    for chunk in chunks {
        let len = chunk.rows.len();
        let part = columns
            .iter_mut()
            .zip(&shared)
            .map(|(column, &shared)| {
                let take = if shared || chunk.rows.start >= n_static {
                    len
                } else {
                    0
                };
                column.split_off_mut(..take).unwrap_or_default()
            })
            .collect();
        parts.push(ChunkGradient {
            columns: part,
            touched: touched.split_off_mut(..len).unwrap_or_default(),
            image: image.split_off_mut(..len).unwrap_or_default(),
        });
    }
    parts
}
