//! Seconds, arithmetic and memory of MegaSaM's tracking network on this machine, with weights by a formula.
//!
//! ```text
//! cargo run --release -p m4_nets --example droid_speed -- [WIDTHxHEIGHT...]
//! ```
//!
//! Seconds are those of all threads together, so that a machine with other work can be measured; the estimate for a clip
//! divides them by the threads.
#![expect(clippy::print_stdout, reason = "the table is what it is for")]

use cpu_time::ProcessTime;
use m4_nets::droid::{DroidMemory, EdgeUpdate, MemoryOptions, Storage};
use m4_nets::{DroidNet, cpu};
use m4_scene::{Plane, RgbImage};
use m4_testkit::write_formula_weights;
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::sync::Arc;
use std::time::Instant;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

const KEYS: &str = include_str!("../../../fixtures/droid/keys.txt");
/// Operations of one update of one edge as published, a pixel of the grid: 20.1 GF at 73 x 41.
const PUBLISHED: f64 = 20.1e9 / (73.0 * 41.0);
/// Updates of edges for 400 frames with 200 keyframes: at most 48 edges, 12 times a keyframe; 16 edges of each keyframe in
/// 30 steps, and of each frame in 15.
const FRONT: f64 = 200.0 * 48.0 * 12.0;
const BACK: f64 = 200.0 * 16.0 * 30.0 + 400.0 * 16.0 * 15.0;

/// The least seconds of all threads, and of the clock, of `n` times.
fn best<T>(n: usize, mut work: impl FnMut() -> Result<T, Box<dyn Error>>) -> Result<(f64, f64), Box<dyn Error>> {
    let mut best = (f64::INFINITY, f64::INFINITY);
    for _ in 0..n {
        let (cpu, wall) = (ProcessTime::now(), Instant::now());
        work()?;
        best = (
            best.0.min(cpu.elapsed().as_secs_f64()),
            best.1.min(wall.elapsed().as_secs_f64()),
        );
    }
    Ok(best)
}

/// Waves that move by some pixels a frame.
fn picture(width: usize, height: usize, frame: usize) -> RgbImage {
    Plane::from_fn(width, height, |x, y| {
        let (x, y) = (x as f32 + 3.0 * frame as f32, y as f32);
        [0.31, 0.17, 0.07].map(|f: f32| (127.0 + 90.0 * (x * f).sin() * (y * f * 0.7).cos()) as u8)
    })
}

/// One update of `edges` edges of frame 0.
fn revise(memory: &mut DroidMemory<'_>, edges: usize, [w, h]: [usize; 2]) -> Result<(), Box<dyn Error>> {
    let projected = [
        (0..w * h).map(|i| (i % w) as f32 + 1.3).collect::<Vec<_>>(),
        (0..w * h).map(|i| (i / w) as f32 - 0.4).collect(),
    ];
    let mut planes = vec![(projected.clone(), [vec![], vec![]], vec![]); edges];
    let mut updates = Vec::new();
    for (id, (target_px, weight, static_confidence)) in planes.iter_mut().enumerate() {
        updates.push(EdgeUpdate {
            id: id as u64,
            projected_px: projected.each_ref().map(Vec::as_slice),
            target_px,
            weight,
            static_confidence,
        });
    }
    memory.revise_source(0, &mut updates)?;
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::TempDir::new()?;
    let path = folder.path().join("weights.safetensors");
    write_formula_weights(KEYS, &path);
    let net = Arc::new(DroidNet::load(&path, cpu())?);
    let mut sizes: Vec<String> = std::env::args().skip(1).collect();
    if sizes.is_empty() {
        sizes.push("584x328".to_owned());
    }
    for size in sizes {
        let (w, h) = size.split_once('x').ok_or("sizes are WIDTHxHEIGHT")?;
        let (w, h): (usize, usize) = (w.parse()?, h.parse()?);
        let options = MemoryOptions {
            budget_bytes: 1 << 30,
            storage: Storage::F16,
            scratch: folder.path().to_owned(),
        };
        let mut memory = DroidMemory::new(net.clone(), options, Box::new(move |frame| Ok(picture(w, h, frame))));
        let image = picture(w, h, 0);
        println!("{size}, {} threads", rayon::current_num_threads());
        let mut frames = 1000..;
        let fnet = best(3, || Ok(memory.add_frame(frames.next().unwrap_or(0), &image)?))?;
        println!(
            "features of a frame   {:7.1} ms of threads, {:7.1} ms",
            fnet.0 * 1e3,
            fnet.1 * 1e3
        );
        memory.add_frame(0, &image)?;
        memory.add_frame(1, &picture(w, h, 1))?;
        let motion = best(3, || Ok(memory.motion_px(0, 1)?))?;
        println!(
            "motion of a pair      {:7.1} ms of threads, {:7.1} ms",
            motion.0 * 1e3,
            motion.1 * 1e3
        );
        let grid = [w / 8, h / 8];
        let work = PUBLISHED * (grid[0] * grid[1]) as f64;
        let mut each = f64::INFINITY;
        for edges in [1, 4, 16] {
            for id in 0..edges {
                memory.enter(id as u64, 0, 1 + id);
            }
            revise(&mut memory, edges, grid)?;
            let held = PEAK.current_usage_as_mb();
            PEAK.reset_peak_usage();
            let time = best(3, || revise(&mut memory, edges, grid))?;
            each = time.0 / edges as f64;
            println!(
                "update of {edges:2} edges    {:7.1} ms of threads, {:7.1} ms an edge: {:5.0} GFLOP/s of a thread; {:4.0} MB beyond {held:.0}",
                each * 1e3,
                time.1 / edges as f64 * 1e3,
                work / each / 1e9,
                PEAK.peak_usage_as_mb() - held
            );
        }
        let threads = rayon::current_num_threads() as f64;
        let hours = |edges: f64| edges * each / threads / 3600.0;
        println!(
            "400 frames, at most: {:.1} h in front, {:.1} h behind, {:.2} h for features and motion",
            hours(FRONT),
            hours(BACK),
            400.0 * (2.0 * fnet.0 + motion.0) / threads / 3600.0
        );
    }
    Ok(())
}
