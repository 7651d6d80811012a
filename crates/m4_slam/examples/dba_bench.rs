//! Times one Gauss-Newton iteration of dense bundle adjustment.
//!
//! ```text
//! cargo run --release -p m4_slam --example dba_bench -- [frames] [edges a frame] [width] [height]
//! ```
//!
//! Prints milliseconds an iteration (the best of several: the machine may have other work) and billions of operations a second, on one thread and on all. Operations are
//! those that the method cannot do without: about 60 a pixel and edge to project and differentiate (twice where depth
//! moves: the back-substitution forms them again), 2 x 28 x 2 for the sums of poses, `(6 n)^2` a pixel for the
//! products of the `n` edges of a source where depth moves, and `(6 frames)^3 / 3` to factorise.

use m4_math::Se3;
use m4_math::nalgebra::Vector6;
use m4_slam::dba::{DbaOptions, Factor, Free, Geometry, Grid, Pinhole, Problem, adjust, project};
use std::time::Instant;

fn scene(frames: usize, grid: Grid) -> Geometry<f32> {
    let plane = |k: usize| -> Vec<f32> {
        let pixels = (0..grid.len()).map(|n| ((n % grid.width) as f32, (n / grid.width) as f32));
        pixels
            .map(|(u, v)| 0.5 + 0.2 * (0.2 * u + 0.1 * k as f32).sin() * (0.15 * v).cos())
            .collect()
    };
    Geometry {
        grid,
        lens: Pinhole {
            fx: 0.9 * grid.width as f64,
            fy: 0.9 * grid.width as f64,
            cx: (grid.width - 1) as f64 / 2.0,
            cy: (grid.height - 1) as f64 / 2.0,
        },
        poses: (0..frames)
            .map(|k| Se3::exp(&(Vector6::new(0.03, 0.004, 0.01, 0.002, 0.004, 0.001) * k as f64)))
            .collect(),
        disparity: (0..frames).map(plane).collect(),
        sensor: vec![vec![0.0; grid.len()]; frames],
    }
}

fn factors(geometry: &Geometry<f32>, edges_a_frame: usize) -> Vec<Factor<f32>> {
    let frames = geometry.frames();
    let near = |i: usize| {
        let mut others: Vec<usize> = (0..frames).filter(|&j| j != i).collect();
        others.sort_by_key(|j| j.abs_diff(i));
        others.truncate(edges_a_frame);
        others
    };
    (0..frames)
        .flat_map(|i| near(i).into_iter().map(move |j| (i, j)))
        .map(|(source, target)| {
            let g = geometry.relative(source, target);
            let width = geometry.grid.width;
            let mut target_px = [Vec::new(), Vec::new()];
            for (n, &d) in geometry.disparity[source].iter().enumerate() {
                let (u, v) = ((n % width) as f64, (n / width) as f64);
                let p = project(&g, &geometry.lens, 1.0, u, v, f64::from(d)).pixel;
                target_px[0].push(p.x as f32 + 0.1 * (n as f32).sin());
                target_px[1].push(p.y as f32 + 0.1 * (n as f32).cos());
            }
            Factor {
                source,
                target,
                target_px,
                weight: [vec![1.0; geometry.grid.len()], vec![1.0; geometry.grid.len()]],
            }
        })
        .collect()
}

#[expect(clippy::print_stdout, reason = "a program that prints its measurements")]
fn main() {
    let arguments: Vec<usize> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let at = |k: usize, default: usize| arguments.get(k).copied().unwrap_or(default);
    let (frames, edges_a_frame) = (at(0, 96), at(1, 6));
    let grid = Grid {
        width: at(2, 60),
        height: at(3, 45),
    };
    let start = scene(frames, grid);
    let factors = factors(&start, edges_a_frame);
    let edges: Vec<&Factor<f32>> = factors.iter().collect();
    let eta = vec![vec![0.005; grid.len()]; frames];
    let problem = Problem {
        edges: &edges,
        eta: &eta,
    };
    let pixels = (edges.len() * grid.len()) as f64;
    let products = (frames * grid.len() * 36 * edges_a_frame * edges_a_frame) as f64;
    let solve = (6.0 * frames as f64).powi(3) / 3.0;
    let operations = |free: Free| {
        let (passes, products) = if free.depth() { (2.0, products) } else { (1.0, 0.0) };
        pixels * (passes * 60.0 + 2.0 * 28.0 * 2.0) + products + solve
    };
    println!(
        "{frames} frames, {} edges, {} x {} pixels",
        edges.len(),
        grid.width,
        grid.height
    );
    let all = std::thread::available_parallelism().map_or(1, usize::from);
    for threads in [1, all] {
        let Ok(pool) = rayon::ThreadPoolBuilder::new().num_threads(threads).build() else {
            continue;
        };
        for free in [Free::Poses, Free::PosesAndDepth, Free::PosesDepthAndFocal] {
            let options = DbaOptions {
                free,
                iterations: 1,
                ..DbaOptions::default()
            };
            let mut times: Vec<f64> = (0..15)
                .filter_map(|_| {
                    let mut geometry = start.clone();
                    let begin = Instant::now();
                    let report = pool.install(|| adjust(&mut geometry, &problem, 1..frames, &options));
                    let time = begin.elapsed().as_secs_f64();
                    report.is_ok_and(|r| r.failed == 0).then_some(time)
                })
                .collect();
            times.sort_by(f64::total_cmp);
            let Some(&time) = times.first() else {
                println!("{threads} thread(s), {free:?}: failed");
                continue;
            };
            let rate = operations(free) / time / 1e9;
            println!(
                "{threads} thread(s), {free:?}: {:.1} ms, {rate:.1} billion operations/s",
                time * 1e3
            );
        }
    }
}
