//! The memory against the published loop; the store against a map.

use super::store::Store;
use super::*;
use crate::droid::tests::{images, network};
use crate::fixture::{Fixture, assert_close as agree};
use m4_testkit::formula;

fn options(budget_bytes: usize, storage: Storage) -> MemoryOptions {
    MemoryOptions {
        budget_bytes,
        storage,
        scratch: std::env::temp_dir(),
    }
}

/// A memory of the images of the fixture, which are added when they are needed.
fn memory(options: MemoryOptions) -> DroidMemory<'static> {
    let images = images();
    let images = move |frame: usize| {
        images
            .get(frame)
            .cloned()
            .ok_or_else(|| "no such frame".into())
    };
    DroidMemory::new(Arc::new(network()), options, Box::new(images))
}

#[derive(Clone, Debug, PartialEq)]
struct Planes {
    projected: [Vec<f32>; 2],
    target: [Vec<f32>; 2],
    weight: [Vec<f32>; 2],
    still: Vec<f32>,
}

const N: usize = 16 * 24;

/// Half a pixel from where pixels are.
fn start() -> Planes {
    let projected = [
        (0..N).map(|i| (i % 24) as f32 + 0.5).collect::<Vec<_>>(),
        (0..N).map(|i| (i / 24) as f32 + 0.5).collect(),
    ];
    Planes {
        target: projected.clone(),
        projected,
        weight: [vec![], vec![]],
        still: vec![],
    }
}

fn revise(
    memory: &mut DroidMemory<'_>,
    source: usize,
    ids: &[usize],
    planes: &mut [Planes],
) -> Vec<f32> {
    let mut edges: Vec<EdgeUpdate<'_>> = (0..)
        .zip(planes)
        .filter(|(id, _)| ids.contains(id))
        .map(|(id, p)| EdgeUpdate {
            id: id as u64,
            projected_px: p.projected.each_ref().map(Vec::as_slice),
            target_px: &mut p.target,
            weight: &mut p.weight,
            static_confidence: &mut p.still,
        })
        .collect();
    memory.revise_source(source, &mut edges).unwrap()
}

/// Three steps of the published loop: all that it gives, checked against `limit` where there is
/// one.
fn run(memory: &mut DroidMemory<'_>, limit: Option<f64>) -> (Vec<Planes>, Vec<f32>) {
    let file = Fixture::open("droid/update_loop.safetensors");
    let (ii, jj) = (file.indices("ii"), file.indices("jj"));
    let mut planes = vec![start(); ii.len()];
    for (id, (&i, &j)) in ii.iter().zip(&jj).enumerate() {
        memory.enter(id as u64, i, j);
    }
    let mut all_eta = Vec::new();
    for step in 0..3 {
        let mut eta = Vec::new();
        for source in 0..3 {
            let ids: Vec<usize> = (0..ii.len()).filter(|&e| ii[e] == source).collect();
            eta.extend(revise(memory, source, &ids, &mut planes));
        }
        let last = |of: &dyn Fn(&Planes, usize, usize) -> f32| -> Vec<f32> {
            let edges = planes.iter();
            edges
                .flat_map(|p| (0..2 * N).map(move |i| of(p, i % 2, i / 2)))
                .collect()
        };
        let delta = last(&|p, c, i| p.target[c][i] - p.projected[c][i]);
        let weight = last(&|p, c, i| p.weight[c][i]);
        let still: Vec<f32> = planes.iter().flat_map(|p| p.still.clone()).collect();
        if let Some(limit) = limit {
            agree(
                "delta",
                &delta,
                &file.floats(&format!("it{step}_delta")).0,
                limit,
            );
            agree(
                "weight",
                &weight,
                &file.floats(&format!("it{step}_weight")).0,
                limit,
            );
            agree("m", &still, &file.floats(&format!("it{step}_m")).0, limit);
            agree("eta", &eta, &file.floats(&format!("it{step}_eta")).0, limit);
        }
        all_eta.extend(eta);
        for p in &mut planes {
            for (projected, target) in p.projected.iter_mut().zip(&p.target) {
                for (p, t) in projected.iter_mut().zip(target) {
                    *p += 0.5 * (t - *p);
                }
            }
        }
    }
    (planes, all_eta)
}

#[test]
fn a_loop_agrees_with_the_module() {
    let mut memory = memory(options(1 << 30, Storage::F32));
    run(&mut memory, Some(1e-4));
    let want = Fixture::open("droid/update_loop.safetensors")
        .floats("hidden_final_strided")
        .0;
    let mut hidden = Vec::new();
    for edge in 0..6 {
        let values = memory.load(Key::Hidden(edge)).unwrap();
        hidden.extend(values.chunks(N).step_by(8).flatten().copied());
    }
    agree("hidden", &hidden, &want, 1e-4);
    assert_eq!(memory.store.spilled(), 0, "all was within the budget");
}

#[test]
fn the_budget_and_the_threads_change_no_bit() {
    let with = |budget: usize, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut memory = memory(options(budget, Storage::F16));
            let motion = memory.motion_px(0, 1).unwrap();
            assert!(motion > 0.0 && motion.is_finite(), "{motion}");
            let answer = (run(&mut memory, None), motion.to_bits());
            assert_eq!(memory.store.spilled() == 0, budget == 1 << 30);
            answer
        })
    };
    let large = with(1 << 30, 1);
    // room for nothing, and for three maps of 98,304 bytes
    assert_eq!(large, with(0, 2));
    assert_eq!(large, with(300_000, 5));
}

#[test]
fn half_precision_changes_little() {
    let run = |storage| run(&mut memory(options(1 << 30, storage)), None).0;
    let (half, full) = (run(Storage::F16), run(Storage::F32));
    for (half, full) in half.iter().zip(&full) {
        agree("m", &half.still, &full.still, 2e-2);
        agree("weight", &half.weight[0], &full.weight[0], 2e-2);
    }
    assert_ne!(half, full);
}

#[test]
fn motion_equals_one_update_from_rest() {
    let mut memory = memory(options(1 << 30, Storage::F32));
    let got = memory.motion_px(1, 2).unwrap();
    // by its parts
    let net = memory.net.clone();
    let [hidden, context] = memory.first_state(1).unwrap();
    let source = FeatureMap::new(memory.features(1).unwrap());
    let centres = (0..N)
        .flat_map(|i| [(i % 24) as f32, (i / 24) as f32])
        .collect();
    let corr = memory.correlation(&source, 2, centres).unwrap();
    let zeros = Tensor::zeros([1, 4, 16, 24], &crate::cpu());
    let update = &net.net.update;
    let hidden = update.advance(
        &net.gru,
        hidden,
        net.gru.context(context),
        corr,
        Some(zeros),
    );
    let delta = read(update.delta(hidden)).unwrap();
    let want = (0..N)
        .map(|i| f64::from(delta[i]).hypot(f64::from(delta[N + i])))
        .sum::<f64>()
        / N as f64;
    assert!(
        (got - want).abs() < 1e-9 * want && want > 0.0,
        "{got}, not {want}"
    );
}

#[test]
fn requests_that_make_no_sense_are_refused() {
    let mut memory = memory(options(1 << 20, Storage::F16));
    memory.enter(0, 0, 1);
    memory.enter(1, 1, 0);
    memory.enter(2, 0, 7);
    let mut attempt = |source: usize, ids: &[u64], pixels: usize| {
        let mut planes = vec![start(); ids.len()];
        let mut edges = Vec::new();
        for (&id, p) in ids.iter().zip(&mut planes) {
            edges.push(EdgeUpdate {
                id,
                projected_px: p.projected.each_ref().map(|p| &p[..pixels]),
                target_px: &mut p.target,
                weight: &mut p.weight,
                static_confidence: &mut p.still,
            });
        }
        memory.revise_source(source, &mut edges).unwrap_err()
    };
    for (source, ids, pixels, said) in [
        (0, &[5][..], N, "edge 5 is not known"),
        (
            0,
            &[1][..],
            N,
            "edge 1 does not belong here: it starts at frame 1",
        ),
        (0, &[0, 0][..], N, "edge 0 does not belong here"),
        (0, &[][..], N, "frame 0 is to be revised without an edge"),
        (
            0,
            &[0][..],
            N - 1,
            "a plane of 383 numbers where the grid has 384 pixels",
        ),
        (0, &[2][..], N, "frame 7 is not available: no such frame"),
    ] {
        let error = attempt(source, ids, pixels).to_string();
        assert!(error.contains(said), "{error}");
    }
    memory.leave(0);
    assert!(memory.revise_source(0, &mut []).is_err());
}

/// Positions that are no numbers, or far away, spoil their own pixels alone.
#[test]
fn non_finite_positions_do_not_panic() {
    let mut memory = memory(options(1 << 30, Storage::F32));
    memory.enter(0, 0, 1);
    let mut planes = [start()];
    planes[0].projected[0][5] = f32::NAN;
    planes[0].projected[1][6] = f32::INFINITY;
    planes[0].target[0][7] = f32::NAN;
    planes[0].projected[0][8] = -1e30;
    let eta = revise(&mut memory, 0, &[0], &mut planes);
    assert!(eta.iter().all(|x| x.is_finite() && *x > 0.0));
    assert!(
        planes[0]
            .still
            .iter()
            .chain(&planes[0].weight[0])
            .all(|x| x.is_finite())
    );
    assert!(planes[0].target[0][5].is_nan() && planes[0].target[0][7].is_finite());
}

#[test]
fn store_round_trips() {
    let mut store = Store::new(1000, Storage::F32, std::env::temp_dir());
    let mut map = HashMap::new();
    let mut dice = formula("store", 6000).map(|u| ((u + 1.0) * 5e5) as u64);
    let mut next = |n: u64| dice.next().unwrap() % n;
    for round in 0..1500 {
        let key = next(20);
        match next(4) {
            0 => {
                store.remove(key);
                map.remove(&key);
            }
            1 => assert_eq!(store.get(key).unwrap().as_ref(), map.get(&key)),
            _ => {
                let values = vec![round as f32; 30];
                store.put(key, &values).unwrap();
                map.insert(key, values);
            }
        }
    }
    for key in 0..20 {
        assert_eq!(store.get(key).unwrap().as_ref(), map.get(&key));
    }
    // 8 of 120 bytes are in memory
    assert!((1..=12).contains(&store.spilled()));
}

#[test]
fn missing_folder_is_reported() {
    let mut options = options(10, Storage::F16);
    options.scratch = std::env::temp_dir().join("no such folder/at all");
    let error = memory(options).motion_px(0, 1).unwrap_err();
    assert!(error.to_string().contains("no such folder"), "{error}");
}

#[test]
fn a_memory_can_go_to_another_thread() {
    let memory = memory(options(10, Storage::F16));
    let debug = std::thread::spawn(move || format!("{memory:?}"))
        .join()
        .unwrap();
    assert!(debug.contains("edges: 0"), "{debug}");
}
