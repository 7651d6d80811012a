//! Times a step of consistent video depth, beside the time that its memory traffic alone would take.
//!
//! ```text
//! cargo run --release -p m4_slam --example cvd_speed -- [FRAMES WIDTH HEIGHT STEPS]
//! ```
//!
//! A drawn scene (a wavy wall, a camera that drifts) with its exact flow; 96 frames of 240x180 and 20 steps of each stage
//! unless it says otherwise. The bound: flow, and every plane of a frame as often as it must be fetched if nothing but the rows
//! at hand stays in a cache, at the rate of a copy of 256 MiB on as many threads.
#![expect(clippy::print_stdout, reason = "a report is its output")]

use cpu_time::ProcessTime;
use m4_math::Se3;
use m4_math::nalgebra::{Vector3, Vector6};
use m4_scene::{Intrinsics, NoShelf, Plane, Progress};
use m4_slam::cvd::pairs::{FlowView, PairSource, PairStore, pair_list};
use m4_slam::cvd::{CvdInput, CvdSettings, optimise};
use std::sync::Mutex;
use std::time::Instant;

type Anything = Box<dyn std::error::Error>;

/// When each step ended.
struct Clock(Mutex<Vec<Instant>>);

impl Progress for Clock {
    fn update(&self, _phase: &str, _done: usize, _total: usize, _note: &str) {
        if let Ok(mut times) = self.0.lock() {
            times.push(Instant::now());
        }
    }

    fn warn(&self, message: &str) {
        println!("warning: {message}");
    }

    fn cancelled(&self) -> bool {
        false
    }
}

struct Clip {
    c2w: Vec<Se3<f64>>,
    intrinsics: Intrinsics,
    disparity: Vec<Plane<f32>>,
    pairs: PairStore,
}

fn draw(frames: usize, width: usize, height: usize) -> Result<Clip, Anything> {
    let intrinsics = Intrinsics::centred(width, height, 0.9 * width as f64);
    let pose = |i: usize| {
        let t = i as f64;
        let twist = Vector6::new(0.01 * t, 0.02 * (0.2 * t).sin(), 0.0, 0.0, 0.002 * t, 0.0);
        Se3::<f64>::identity().retract(&twist)
    };
    let c2w: Vec<Se3<f64>> = (0..frames).map(pose).collect();
    let k = &intrinsics;
    let ray = |p: usize| {
        let (x, y) = ((p % width) as f64 + 0.5, (p / width) as f64 + 0.5);
        Vector3::new((x - k.cx) / k.fx, (y - k.cy) / k.fy, 1.0)
    };
    // the wall is at z = 2 + 0.3 sin(3 x) cos(2 y), found along the ray by fixed-point steps
    let depth = |pose: &Se3<f64>, p: usize| {
        let ray = ray(p);
        let mut z = 2.0;
        for _ in 0..12 {
            let x = pose.transform(&(ray * z));
            z += 2.0 + 0.3 * (3.0 * x.x).sin() * (2.0 * x.y).cos() - x.z;
        }
        z
    };
    let depths: Vec<Vec<f64>> = c2w
        .iter()
        .map(|pose| (0..width * height).map(|p| depth(pose, p)).collect())
        .collect();
    let mut pairs = PairStore::new(width, height, usize::MAX);
    for pair in pair_list(frames) {
        let there = c2w[pair.target].inverse().compose(&c2w[pair.source]);
        let (mut x, mut y, mut mask) = (Vec::new(), Vec::new(), Vec::new());
        for p in 0..width * height {
            let point = there.transform(&(ray(p) * depths[pair.source][p]));
            let u = k.fx * point.x / point.z + k.cx - 0.5;
            let v = k.fy * point.y / point.z + k.cy - 0.5;
            x.push((u - (p % width) as f64) as f32);
            y.push((v - (p / width) as f64) as f32);
            mask.push(u >= 0.0 && v >= 0.0 && u <= (width - 1) as f64 && v <= (height - 1) as f64);
        }
        let flow = FlowView {
            width,
            height,
            x: &x,
            y: &y,
        };
        pairs.push(pair, flow, &mask)?;
    }
    let disparity = depths.iter().enumerate().map(|(i, z)| {
        let wrong = 1.0 + 0.2 * (i as f64).sin();
        let at = |x: usize, y: usize| (wrong / z[y * width + x] * (1.0 + 0.05 * (0.3 * x as f64).sin())) as f32;
        Plane::from_fn(width, height, at)
    });
    Ok(Clip {
        disparity: disparity.collect(),
        c2w,
        intrinsics,
        pairs,
    })
}

/// Bytes a second that copying reads and writes.
fn copy_rate(threads: usize) -> f64 {
    let size = (256 << 20) / threads;
    let mut parts: Vec<(Vec<u8>, Vec<u8>)> = (0..threads).map(|_| (vec![1; size], vec![2; size])).collect();
    let mut best = f64::MAX;
    for _ in 0..5 {
        let begin = Instant::now();
        std::thread::scope(|scope| {
            for (from, to) in &mut parts {
                scope.spawn(|| std::hint::black_box(to).copy_from_slice(std::hint::black_box(from)));
            }
        });
        best = best.min(begin.elapsed().as_secs_f64());
    }
    2.0 * (size * threads) as f64 / best
}

fn main() -> Result<(), Anything> {
    let args: Vec<usize> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let [frames, width, height, steps] = match args.as_slice() {
        [] => [96, 240, 180, 20],
        &[frames, width, height, steps] => [frames, width, height, steps],
        _ => return Err("usage: cvd_speed [FRAMES WIDTH HEIGHT STEPS]".into()),
    };
    let clip = draw(frames, width, height)?;
    let pairs = clip.pairs.pairs().len();
    let plane = 4.0 * (width.next_multiple_of(16) * height) as f64;
    // a pair: its flow, the target's disparity, and its gradient in and out; a frame, as a source: disparity and u in, two
    // gradients out; at the end: 14 planes in (both variables with two moments each, disparity and three gradients, the
    // initial logarithm and three of normals) and 9 out
    let bytes = plane * (4 * pairs + 4 * frames + 23 * frames) as f64;
    println!(
        "{frames} frames of {width}x{height}, {pairs} pairs, {:.0} MB of flow",
        pairs as f64 * plane / 1e6
    );
    let uncertainty = vec![Plane::filled(width, height, 0.5f32); frames];
    let mut settings = CvdSettings::default();
    (settings.stage1.steps, settings.stage2.steps) = (steps, steps);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let clock = Clock(Mutex::new(Vec::new()));
        let input = CvdInput {
            c2w: &clip.c2w,
            intrinsics: clip.intrinsics,
            disparity: &clip.disparity,
            uncertainty: &uncertainty,
            prior_confidence: None,
        };
        let cpu = ProcessTime::now();
        let found = pool.install(|| optimise(&input, &clip.pairs, &settings, &clock, &NoShelf))?;
        let cpu = cpu.elapsed().as_secs_f64() * 1e3 / (2 * steps) as f64;
        let times = clock.0.into_inner().unwrap_or_default();
        let ms = |range: std::ops::Range<usize>| {
            let mut steps: Vec<f64> = times[range]
                .windows(2)
                .map(|w| (w[1] - w[0]).as_secs_f64() * 1e3)
                .collect();
            steps.sort_by(f64::total_cmp);
            (steps[0], steps[steps.len() / 2])
        };
        let (one, two) = (ms(0..steps), ms(steps..2 * steps));
        let bound = 1e3 * bytes / copy_rate(threads);
        println!(
            "{threads} threads: stage 1 {:.1} ms a step (median {:.1}), stage 2 {:.1} ms (median {:.1}); processor time {cpu:.1} ms a step; bound {bound:.1} ms for {:.0} MB; \
             100 + 400 steps: {:.1} s; loss {:.4} to {:.4}",
            one.0,
            one.1,
            two.0,
            two.1,
            bytes / 1e6,
            0.1 * one.1 + 0.4 * two.1,
            found.losses[0][0],
            found.losses[1][steps - 1],
        );
    }
    Ok(())
}
