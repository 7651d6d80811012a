//! Consistent video depth on rendered scenes: true poses, true flow of static regions, and a disparity that was spoiled.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_core::{
    Camera, CounterRng, Intrinsics, Plane, Se3, Silent,
    nalgebra::{Matrix4, Vector4},
};
use m4_geometry::megasam::cvd::pairs::{FlowView, PairStore, pair_list};
use m4_geometry::megasam::cvd::{CvdInput, CvdSettings, optimise, uncertainty_of_static};
use m4_testkit::shared;
use std::path::Path;

const FRAMES: usize = 20;
const WIDTH: usize = 160;
const HEIGHT: usize = 120;

struct Scene {
    cameras: Vec<Camera>,
    /// Metres, `[height][width]`; 0 where there is no surface.
    depth: Vec<Vec<f32>>,
    moving: Vec<Vec<bool>>,
}

/// The first frames, each pixel the middle one of its 3x3.
fn load(dir: &Path) -> Scene {
    let text = std::fs::read_to_string(dir.join("transforms_train.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let number = |key: &str| json[key].as_f64().unwrap();
    let full = Intrinsics {
        width: number("w") as usize,
        height: number("h") as usize,
        fx: number("fl_x"),
        fy: number("fl_y"),
        cx: number("cx"),
        cy: number("cy"),
    };
    assert_eq!((full.width, full.height), (3 * WIDTH, 3 * HEIGHT));
    let mut scene = Scene {
        cameras: Vec::new(),
        depth: Vec::new(),
        moving: Vec::new(),
    };
    for frame in json["frames"].as_array().unwrap().iter().take(FRAMES) {
        let open = |key: &str| image::open(dir.join(frame[key].as_str().unwrap())).unwrap();
        let (depth, mask) = (open("depth_file_path").into_luma16(), open("mask_path").into_luma8());
        let at = |p: usize| ((3 * (p % WIDTH) + 1) as u32, (3 * (p / WIDTH) + 1) as u32);
        let pixels = 0..WIDTH * HEIGHT;
        let metres = |p| f32::from(depth.get_pixel(at(p).0, at(p).1).0[0]) / 1000.0;
        scene.depth.push(pixels.clone().map(metres).collect());
        let moves = |p| mask.get_pixel(at(p).0, at(p).1).0[0] != 0;
        scene.moving.push(pixels.map(moves).collect());
        let m = Matrix4::from_fn(|r, c| frame["transform_matrix"][r][c].as_f64().unwrap());
        let flip = Matrix4::from_diagonal(&Vector4::new(1.0, -1.0, -1.0, 1.0));
        scene.cameras.push(Camera {
            intrinsics: full.resized(WIDTH, HEIGHT),
            c2w: Se3::from_matrix(&(m * flip)),
        });
    }
    scene
}

/// True flow where the surface is static and visible in both frames.
fn flows(scene: &Scene) -> PairStore {
    // some of it spills
    let mut store = PairStore::new(WIDTH, HEIGHT, 2 << 20);
    for pair in pair_list(FRAMES) {
        let (a, b) = (&scene.cameras[pair.source], &scene.cameras[pair.target]);
        let n = WIDTH * HEIGHT;
        let (mut x, mut y, mut mask) = (vec![0.0; n], vec![0.0; n], vec![false; n]);
        for p in 0..n {
            let z = f64::from(scene.depth[pair.source][p]);
            if z == 0.0 || scene.moving[pair.source][p] {
                continue;
            }
            let (px, py) = ((p % WIDTH) as f64, (p / WIDTH) as f64);
            let ([u, v], there) = b.project(&a.unproject(px, py, z));
            let inside = u >= 0.0 && v >= 0.0 && u <= (WIDTH - 1) as f64 && v <= (HEIGHT - 1) as f64;
            if there <= 0.0 || !inside {
                continue;
            }
            let q = v.round() as usize * WIDTH + u.round() as usize;
            let seen = (f64::from(scene.depth[pair.target][q]) / there - 1.0).abs() < 0.02;
            (x[p], y[p]) = ((u - px) as f32, (v - py) as f32);
            mask[p] = seen && !scene.moving[pair.target][q];
        }
        let flow = FlowView {
            width: WIDTH,
            height: HEIGHT,
            x: &x,
            y: &y,
        };
        store.push(pair, flow, &mask).unwrap();
    }
    assert!(store.spilled_pairs() > 0);
    store
}

/// Mean of |depth - truth| / truth over static regions, in metres, without alignment.
fn abs_rel(scene: &Scene, disparity: &[Plane<f32>]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for i in 0..FRAMES {
        for p in 0..WIDTH * HEIGHT {
            let truth = f64::from(scene.depth[i][p]);
            if truth > 0.0 && !scene.moving[i][p] {
                sum += (1.0 / f64::from(disparity[i].data()[p]) / truth - 1.0).abs();
                count += 1.0;
            }
        }
    }
    sum / count
}

#[test]
fn spoiled_depth_is_mended() {
    let mut scenes = 0;
    for name in ["quad-1", "mill-1"] {
        let Some(dir) = shared(&format!("bench/{name}")) else {
            continue;
        };
        let scene = load(&dir);
        let pairs = flows(&scene);
        let mut rng = CounterRng::new(8, 1, 7);
        let mut start = Vec::new();
        for depth in &scene.depth {
            // a wrong scale of 20 % up or down, noise of 5 % a pixel
            let factor = 1.0 + 0.2 * (2.0 * rng.uniform() - 1.0);
            let spoil = |&z: &f32| {
                let truth = if z > 0.0 { 1.0 / f64::from(z) } else { 0.02 };
                (factor * truth * (1.0 + 0.05 * rng.normal()).max(0.5)) as f32
            };
            start.push(Plane::from_vec(WIDTH, HEIGHT, depth.iter().map(spoil).collect()).unwrap());
        }
        let c2w: Vec<Se3<f64>> = scene.cameras.iter().map(|c| c.c2w).collect();
        let uncertainty: Vec<Plane<f32>> = scene
            .moving
            .iter()
            .map(|m| {
                Plane::from_fn(WIDTH, HEIGHT, |x, y| {
                    uncertainty_of_static(if m[y * WIDTH + x] { 0.0 } else { 1.0 })
                })
            })
            .collect();
        let input = CvdInput {
            c2w: &c2w,
            intrinsics: scene.cameras[0].intrinsics,
            disparity: &start,
            uncertainty: &uncertainty,
        };
        let found = optimise(&input, &pairs, &CvdSettings::default(), &Silent).unwrap();
        let (before, after) = (abs_rel(&scene, &start), abs_rel(&scene, &found.disparity));
        eprintln!("{name}: AbsRel of static regions {before:.4} to {after:.4}");
        assert!(before > 0.07 && after < 0.2 * before, "{name}: {before} to {after}");
        scenes += 1;
    }
    assert!(scenes > 0, "the folder `shared` holds no scene to test with");
}
