//! The whole way of MegaSaM on a rendered scene with true flow in the network's place. Sizes and
//! resampling against OpenCV and PyTorch.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_core::{Camera, Flow, Intrinsics, Plane, RgbImage, Silent, Sim3, nalgebra::Vector3};
use m4_geometry::classical::dense::SourceError;
use m4_geometry::megasam::cvd::pairs::FramePair;
use m4_geometry::megasam::graph::EdgeChanges;
use m4_geometry::megasam::tracker::{Correspondence, CorrespondenceError, Revision};
use m4_geometry::megasam::{
    DepthPrior, MegasamGeometry, MegasamInput, MegasamSettings, PairFlow, TrackingSize,
    reconstruct, track,
};
use m4_geometry::resample::{resize_area, resize_bilinear, resize_nearest};
use m4_io::capture::{self, CaptureOptions, Split};
use m4_testkit::shared;
use safetensors::{Dtype, SafeTensors};
use std::path::Path;

fn fixture(name: &str) -> Vec<u8> {
    std::fs::read(
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../fixtures/ops")
            .join(name),
    )
    .unwrap()
}

fn plane(file: &[u8], name: &str) -> Plane<f32> {
    let all = SafeTensors::deserialize(file).unwrap();
    let tensor = all.tensor(name).unwrap();
    assert_eq!(tensor.dtype(), Dtype::F32, "{name}");
    let values = tensor
        .data()
        .as_chunks::<4>()
        .0
        .iter()
        .map(|b| f32::from_le_bytes(*b));
    Plane::from_vec(tensor.shape()[1], tensor.shape()[0], values.collect()).unwrap()
}

fn read_image(file: &[u8], name: &str) -> RgbImage {
    let all = SafeTensors::deserialize(file).unwrap();
    let tensor = all.tensor(name).unwrap();
    let pixels = tensor.data().as_chunks::<3>().0.to_vec();
    Plane::from_vec(tensor.shape()[1], tensor.shape()[0], pixels).unwrap()
}

#[test]
fn resampling_is_that_of_opencv_and_pytorch() {
    let file = fixture("resize.safetensors");
    let image = read_image(&file, "image_u8");
    for name in ["cv2_area_u8_down", "cv2_area_u8_half", "cv2_area_u8_up"] {
        let want = read_image(&file, name);
        let got = resize_area(&image, want.width(), want.height());
        let pairs = got
            .data()
            .iter()
            .flatten()
            .zip(want.data().iter().flatten());
        let off = pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(off <= 1, "{name}: {off} counts");
    }
    let map = plane(&file, "map");
    let close = |got: Plane<f32>, want: Plane<f32>, name: &str| {
        let off = got
            .data()
            .iter()
            .zip(want.data())
            .map(|(a, b)| (a - b).abs());
        let off = off.fold(0.0, f32::max);
        assert!(off < 1e-5, "{name}: {off}");
    };
    for side in ["down", "up"] {
        let name = format!("torch_nearest_exact_{side}");
        let want = plane(&file, &name);
        close(
            resize_nearest(&map, want.width(), want.height()),
            want,
            &name,
        );
        let name = format!("torch_bilinear_{side}");
        let want = plane(&file, &name);
        close(
            resize_bilinear(&map, want.width(), want.height()),
            want,
            &name,
        );
    }
}

#[test]
fn sizes_are_those_of_the_published_program() {
    let file = fixture("size_rules.safetensors");
    let all = SafeTensors::deserialize(&file).unwrap();
    let tensor = all.tensor("table").unwrap();
    assert_eq!(tensor.dtype(), Dtype::I64);
    let table: Vec<usize> = tensor
        .data()
        .as_chunks::<8>()
        .0
        .iter()
        .map(|b| i64::from_le_bytes(*b) as usize)
        .collect();
    assert!(table.len() >= 8 * 5);
    for row in table.chunks(8) {
        let size = TrackingSize::new((row[0], row[1]), 384.0 * 512.0).unwrap();
        assert_eq!(
            (size.scaled, size.cropped),
            ((row[4], row[5]), (row[6], row[7])),
            "{row:?}"
        );
    }
}

/// A rendered scene: images, cameras in metres, z-depth and dynamic masks.
struct Scene {
    images: Vec<RgbImage>,
    cameras: Vec<Camera>,
    /// Metres; 0 where there is no surface.
    depth: Vec<Plane<f32>>,
    moving: Vec<Plane<bool>>,
}

/// The first `frames` frames of a scene; `None` where it is not there.
fn load(name: &str, frames: usize) -> Option<Scene> {
    let capture = capture::read(
        &shared(name)?,
        Split::Train,
        &CaptureOptions::default(),
        &Silent,
    )
    .unwrap();
    let mut scene = Scene {
        images: Vec::new(),
        cameras: Vec::new(),
        depth: Vec::new(),
        moving: Vec::new(),
    };
    for frame in capture.frames.into_iter().take(frames) {
        scene.images.push(frame.rgb);
        scene.cameras.push(frame.camera);
        scene.depth.push(frame.depth.unwrap().to_map());
        scene
            .moving
            .push(frame.mask.unwrap().to_mask().map(|&m| m > 0));
    }
    Some(scene)
}

/// Where pixels of the images that are tracked are seen in other frames, by the truth.
struct Truth<'a> {
    scene: &'a Scene,
    size: TrackingSize,
}

/// Where a pixel is seen, and whether it is: at rest, and not hidden.
struct Seen {
    at: [f32; 2],
    visible: bool,
    moving: bool,
}

impl Truth<'_> {
    /// The full image's pixel at pixel coordinates of the tracked ones.
    fn full(&self, at: f64, axis: usize) -> f64 {
        let (full, scaled) = match axis {
            0 => (self.size.full.0, self.size.scaled.0),
            _ => (self.size.full.1, self.size.scaled.1),
        };
        (at + 0.5) * full as f64 / scaled as f64 - 0.5
    }

    fn nearest(&self, x: f64, y: f64) -> Option<(usize, usize)> {
        let (w, h) = self.size.full;
        let inside = x > -0.5 && y > -0.5 && x < w as f64 - 0.5 && y < h as f64 - 0.5;
        inside.then_some(((x + 0.5) as usize, (y + 0.5) as usize))
    }

    /// Pixel `(x, y)` of the tracked image of frame `i`, in frame `j`.
    fn seen(&self, i: usize, j: usize, x: f64, y: f64) -> Seen {
        let (u, v) = (self.full(x, 0), self.full(y, 1));
        let nowhere = Seen {
            at: [x as f32, y as f32],
            visible: false,
            moving: false,
        };
        let Some(p) = self.nearest(u, v) else {
            return nowhere;
        };
        let z = f64::from(self.scene.depth[i][p]);
        let moving = self.scene.moving[i][p];
        if z == 0.0 {
            return nowhere;
        }
        // The depth is that of the nearest pixel, so its own ray is taken and moved by what lies
        // between.
        let (a, b) = (&self.scene.cameras[i], &self.scene.cameras[j]);
        let ([u2, v2], target_depth) = b.project(&a.unproject(u, v, z));
        if target_depth <= 0.1 {
            return nowhere;
        }
        let back =
            |at: f64, full: usize, scaled: usize| (at + 0.5) * scaled as f64 / full as f64 - 0.5;
        let at = [
            back(u2, self.size.full.0, self.size.scaled.0) as f32,
            back(v2, self.size.full.1, self.size.scaled.1) as f32,
        ];
        let hit = self
            .nearest(u2, v2)
            .map(|q| f64::from(self.scene.depth[j][q]) / target_depth);
        let visible = !moving && hit.is_some_and(|ratio| (ratio - 1.0).abs() < 0.02);
        Seen {
            at,
            visible,
            moving,
        }
    }
}

impl Correspondence for Truth<'_> {
    fn change(&mut self, _: &EdgeChanges) -> Result<(), CorrespondenceError> {
        Ok(())
    }

    fn revise(&mut self, revision: &mut Revision<'_>) -> Result<(), CorrespondenceError> {
        let grid = revision.grid;
        for edge in &mut revision.edges {
            for n in 0..grid.len() {
                let (x, y) = ((8 * (n % grid.width)) as f64, (8 * (n / grid.width)) as f64);
                let observation = self.seen(edge.key.source_frame, edge.key.target_frame, x, y);
                let weight = if observation.visible { 1.0 } else { 0.0 };
                for axis in 0..2 {
                    edge.target_px[axis][n] = observation.at[axis] / 8.0;
                    edge.weight[axis][n] = weight;
                }
                edge.static_confidence[n] = if observation.moving { 0.0 } else { 1.0 };
            }
        }
        for source in &mut revision.sources {
            source.damping.fill(0.005);
        }
        Ok(())
    }

    fn motion_px(&mut self, from: usize, to: usize) -> Result<f64, CorrespondenceError> {
        let grid = self.size.grid();
        let (mut sum, mut count) = (0.0, 0.0);
        for n in 0..grid.len() {
            let (x, y) = ((8 * (n % grid.width)) as f64, (8 * (n / grid.width)) as f64);
            let observation = self.seen(from, to, x, y);
            if observation.visible {
                sum += (f64::from(observation.at[0]) - x).hypot(f64::from(observation.at[1]) - y)
                    / 8.0;
                count += 1.0;
            }
        }
        Ok(sum / f64::max(count, 1.0))
    }
}

impl PairFlow for Truth<'_> {
    fn name(&self) -> &str {
        "truth"
    }

    fn both(
        &mut self,
        pair: FramePair,
        a: &RgbImage,
        b: &RgbImage,
    ) -> Result<[Flow; 2], SourceError> {
        assert_eq!((a.size(), b.size()), (self.size.cropped, self.size.cropped));
        let (width, height) = self.size.cropped;
        let way = |i: usize, j: usize| {
            let mut field = Flow {
                width,
                height,
                ..Flow::default()
            };
            for n in 0..width * height {
                let (x, y) = ((n % width) as f64, (n / width) as f64);
                let observation = self.seen(i, j, x, y);
                // What is hidden is far from where it came when it goes back.
                let miss = if observation.visible { 0.0 } else { 50.0 };
                field.u.push(observation.at[0] - x as f32 + miss);
                field.v.push(observation.at[1] - y as f32);
            }
            field
        };
        Ok([way(pair.source, pair.target), way(pair.target, pair.source)])
    }
}

/// Depth of a network: a factor that waves by 8 % over the image and the frames, metres.
fn monocular_depth(scene: &Scene) -> Vec<Plane<f32>> {
    let frame = |(k, depth): (usize, &Plane<f32>)| {
        Plane::from_fn(depth.width(), depth.height(), |x, y| {
            let wave = (0.013 * x as f32 + 0.4 * k as f32).sin()
                * (0.017 * y as f32 - 0.3 * k as f32).cos();
            depth.row(y)[x] * (1.0 + 0.08 * wave)
        })
    };
    scene.depth.iter().enumerate().map(frame).collect()
}

/// Root mean square distance of camera centres after a similarity, over the length of the path; and
/// the factor of the similarity.
fn path_error(geometry: &MegasamGeometry, scene: &Scene) -> (f64, f64) {
    let got: Vec<Vector3<f64>> = geometry.c2w.iter().map(|p| p.translation).collect();
    let want: Vec<Vector3<f64>> = scene.cameras.iter().map(|c| c.c2w.translation).collect();
    let fit = Sim3::umeyama(&got, &want).unwrap();
    let square: f64 = got
        .iter()
        .zip(&want)
        .map(|(a, b)| (fit.transform(a) - b).norm_squared())
        .sum();
    let length: f64 = want.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    ((square / got.len() as f64).sqrt() / length, fit.scale)
}

/// The greatest turn between found and true directions of view, first to frame, degrees.
fn turn_error_deg(geometry: &MegasamGeometry, scene: &Scene) -> f64 {
    let first = (geometry.c2w[0].rotation, scene.cameras[0].c2w.rotation);
    let turns = geometry.c2w.iter().zip(&scene.cameras).map(|(a, b)| {
        let (a, b) = (
            first.0.transpose() * a.rotation,
            first.1.transpose() * b.c2w.rotation,
        );
        let cos = ((a.transpose() * b).trace() - 1.0) / 2.0;
        cos.clamp(-1.0, 1.0).acos().to_degrees()
    });
    turns.fold(0.0, f64::max)
}

#[test]
fn true_flow_gives_true_cameras_and_depth() {
    // as many frames as are worth the time that this takes
    let Some(scene) = load("bench/quad-1", 48) else {
        return;
    };
    let settings = MegasamSettings::default();
    let size = TrackingSize::new(scene.images[0].size(), settings.tracking_pixels).unwrap();
    let prior = DepthPrior::metric(&monocular_depth(&scene), &size).unwrap();
    let mut truth = Truth {
        scene: &scene,
        size,
    };
    let mut flow = Truth {
        scene: &scene,
        size,
    };
    let lens = scene.cameras[0].intrinsics;
    let times: Vec<f64> = (0..scene.images.len()).map(|k| k as f64 / 30.0).collect();
    let images: Vec<&RgbImage> = scene.images.iter().collect();
    let input = MegasamInput {
        images: &images,
        times_s: &times,
        // A guess that is off by an eighth.
        lens: Intrinsics {
            fx: 1.125 * lens.fx,
            fy: 1.125 * lens.fy,
            ..lens
        },
        focal_is_free: true,
        prior: Some(&prior),
    };
    let tracked = track(&input, &mut truth, &settings, &Silent).unwrap();
    let geometry = reconstruct(&input, tracked, &mut flow, &settings, &Silent).unwrap();
    let (path, scale) = path_error(&geometry, &scene);
    let turn = turn_error_deg(&geometry, &scene);
    let focal = geometry.lens.fx / lens.fx - 1.0;
    let (mut off, mut count) = (0.0, 0.0);
    for (k, depth) in geometry.depth.iter().enumerate() {
        for y in (4..size.cropped.1).step_by(3) {
            for x in (4..size.cropped.0).step_by(3) {
                let at = truth
                    .nearest(truth.full(x as f64, 0), truth.full(y as f64, 1))
                    .unwrap();
                let want = scene.depth[k][at];
                if want > 0.0 && !scene.moving[k][at] {
                    off += f64::from((depth.row(y)[x] / want - 1.0).abs());
                    count += 1.0;
                }
            }
        }
    }
    let depth = off / count;
    println!(
        "path {path:.5}, scale {scale:.4}, turn {turn:.4} degrees, focal {focal:+.5}, depth {depth:.4}, {} keyframes, residual {:.3} px, {:?}",
        geometry.keyframes.len(),
        geometry.residual_px,
        geometry.observability
    );
    assert!(geometry.metric && geometry.focal_adjusted);
    assert!(path < 0.005, "path off by {path}");
    assert!(turn < 0.2, "turned by {turn} degrees");
    assert!(focal.abs() < 0.005, "focal length off by {focal}");
    assert!((scale - 1.0).abs() < 0.05, "metres off by {scale}");
    assert!(depth < 0.03, "depth off by {depth}");
}
