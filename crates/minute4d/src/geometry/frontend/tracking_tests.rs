//! The tracker with the tracking network in it, synthetic weights: what it asks, how often, and the
//! published loop.

use super::{NetworkCorrespondence, memory};
use m4_core::{Plane, RgbImage, Se3, Silent};
use m4_geometry::dba::{DbaOptions, Factor, Geometry, Grid, Pinhole, Problem, adjust, project};
use m4_geometry::flow::InverseSearch;
use m4_geometry::megasam::graph::{EdgeChanges, FactorGraph};
use m4_geometry::megasam::tracker::{
    Correspondence, CorrespondenceError, EdgeRevision, FrameInput, Frontend, Revision,
    SourceRevision, Submitted, TrackerSettings,
};
use m4_geometry::megasam::{MegasamInput, MegasamSettings, TrackingSize, reconstruct, track};
use m4_nets::droid::{MemoryOptions, Storage};
use m4_nets::{DroidNet, cpu};
use m4_testkit::{Fixture, assert_close, write_formula_weights};

const KEYS: &str = include_str!("../../../../../fixtures/droid/keys.txt");
/// The least that the network takes.
const SIDE: usize = 128;
const FRAMES: usize = 16;
/// Keyframes before the first adjustment (docs/spec/front-end.md 1.5).
const WARMUP: usize = 8;
/// Updates after which an edge retires (docs/spec/front-end.md 1.5).
const MAX_AGE: u32 = 25;

fn network() -> DroidNet {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("megasam_final.pth");
    write_formula_weights(KEYS, &path);
    DroidNet::load(&path, cpu()).unwrap()
}

/// A pattern that drifts.
fn clip() -> Vec<RgbImage> {
    let frame = |k: usize| {
        Plane::from_fn(SIDE, SIDE, |x, y| {
            let (x, y) = (x as f32 + 3.0 * k as f32, y as f32 + k as f32);
            let wave = |a: f32, b: f32| {
                (127.0 + 60.0 * (a * x).sin() + 60.0 * (b * y + 0.03 * x).cos()) as u8
            };
            [wave(0.21, 0.13), wave(0.09, 0.31), wave(0.37, 0.05)]
        })
    };
    (0..FRAMES).map(frame).collect()
}

/// Few updates, for the time that they take. Untrained weights see hardly any motion, so less of it
/// has to do.
fn few() -> TrackerSettings {
    TrackerSettings {
        motion_filter_px: 0.01,
        keyframe_px: 1.1,
        initial_updates: 2,
        first_updates: 2,
        second_updates: 1,
        max_factors: 16,
        probe_updates: 1,
        backend_updates: 2,
        backend_factors: 3,
        final_updates: 1,
        filler_updates: 1,
        ..TrackerSettings::default()
    }
}

/// Counts what the tracker asks.
struct Counted<'a> {
    network: NetworkCorrespondence<'a>,
    revisions: usize,
    /// Edges of the last revision.
    edges: usize,
    entered: usize,
    left: usize,
}

impl Correspondence for Counted<'_> {
    fn change(&mut self, changes: &EdgeChanges) -> Result<(), CorrespondenceError> {
        self.entered += changes.entered.len();
        self.left += changes.left.len();
        self.network.change(changes)
    }

    fn revise(&mut self, revision: &mut Revision<'_>) -> Result<(), CorrespondenceError> {
        self.revisions += 1;
        self.edges = revision.edges.len();
        self.network.revise(revision)
    }

    fn motion_px(
        &mut self,
        from_frame: usize,
        to_frame: usize,
    ) -> Result<f64, CorrespondenceError> {
        self.network.motion_px(from_frame, to_frame)
    }
}

#[test]
fn the_tracker_runs_the_specified_number_of_updates() {
    let (frames, settings) = (clip(), few());
    let images: Vec<&RgbImage> = frames.iter().collect();
    let size = TrackingSize::new((SIDE, SIDE), (SIDE * SIDE) as f64).unwrap();
    let mut source = Counted {
        network: NetworkCorrespondence::new(network(), &images, None, size, memory(100)),
        revisions: 0,
        edges: 0,
        entered: 0,
        left: 0,
    };
    let lens = Pinhole {
        fx: 14.0,
        fy: 14.0,
        cx: 7.5,
        cy: 7.5,
    };
    let mut frontend = Frontend::new(size.grid(), lens, settings);
    let mut expected = 0;
    let mut keyframes = 0;
    for frame in 0..FRAMES {
        let input = FrameInput {
            frame,
            time_s: frame as f64 / 30.0,
            sensor: vec![0.5; size.grid().len()],
        };
        let outcome = frontend
            .submit(&input, frame + 1 == FRAMES, &mut source)
            .unwrap();
        match outcome {
            Submitted::Skipped => {}
            Submitted::Waiting => keyframes += 1,
            Submitted::Initialised => {
                keyframes += 1;
                assert_eq!(keyframes, WARMUP);
                // Two phases of poses alone, one of everything.
                expected += 3 * settings.initial_updates;
                // Sources before the last four of the warm-up retire.
                assert!(
                    frontend
                        .graph
                        .active
                        .iter()
                        .all(|e| e.factor.source >= WARMUP - 4)
                );
            }
            Submitted::Tracked { dropped, .. } => {
                keyframes += usize::from(dropped.is_none());
                let more = if dropped.is_some() {
                    0
                } else {
                    settings.second_updates
                };
                expected += settings.first_updates + more;
                assert!(
                    source.edges <= settings.max_factors,
                    "{} edges",
                    source.edges
                );
            }
        }
        assert_eq!(source.revisions, expected, "frame {frame}: {outcome:?}");
        assert_eq!(frontend.keyframes.len(), keyframes);
        assert!(frontend.graph.active.iter().all(|e| e.age <= MAX_AGE + 3));
    }
    assert!(
        frontend.is_initialised() && expected > 3 * settings.initial_updates,
        "nothing was tracked"
    );
    frontend.finish(&mut source).unwrap();
    assert!(
        source.entered > 0 && source.entered == source.left,
        "{} {}",
        source.entered,
        source.left
    );
}

#[test]
fn a_clip_goes_all_the_way_and_gives_the_same_bits_again() {
    let frames = clip();
    let images: Vec<&RgbImage> = frames.iter().collect();
    let times: Vec<f64> = (0..FRAMES).map(|k| k as f64 / 30.0).collect();
    let mut settings = MegasamSettings {
        tracking_pixels: (SIDE * SIDE) as f64,
        tracker: few(),
        ..MegasamSettings::default()
    };
    settings.cvd_steps = [3, 4];
    let size = TrackingSize::new((SIDE, SIDE), settings.tracking_pixels).unwrap();
    let run = |budget_mb: usize, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut network =
                NetworkCorrespondence::new(network(), &images, None, size, memory(budget_mb));
            let input = MegasamInput {
                images: &images,
                times_s: &times,
                lens: m4_core::Intrinsics::centred(SIDE, SIDE, 110.0),
                focal_is_free: true,
                prior: None,
            };
            let tracked = track(&input, &mut network, &settings, &Silent).unwrap();
            reconstruct(&input, tracked, &mut InverseSearch, &settings, &Silent).unwrap()
        })
    };
    let (a, b) = (run(100, 1), run(1, 3));
    assert_eq!((a.c2w.len(), a.depth.len()), (FRAMES, FRAMES));
    assert_eq!(a.keyframes, b.keyframes);
    assert!(
        a.keyframes.len() > 2 && a.keyframes.is_sorted(),
        "{:?}",
        a.keyframes
    );
    assert_eq!(a.lens, b.lens);
    for k in 0..FRAMES {
        assert_eq!(a.c2w[k], b.c2w[k], "frame {k}");
        assert_eq!(
            (&a.depth[k], &a.static_confidence[k]),
            (&b.depth[k], &b.static_confidence[k]),
            "frame {k}"
        );
        assert!(a.depth[k].data().iter().all(|z| z.is_finite() && *z > 0.0));
        assert!(
            a.static_confidence[k]
                .data()
                .iter()
                .all(|m| (0.0..=1.0).contains(m))
        );
    }
}

/// `fixtures/droid/update_ba_loop`: three times lookup, update and two iterations of adjustment.
#[test]
fn the_published_loop_of_network_and_adjustment_is_met() {
    let file = Fixture::open("droid/update_ba_loop.safetensors");
    let singles = |name: &str| file.floats(name).0;
    let images = images(&file);
    let references: Vec<&RgbImage> = images.iter().collect();
    let size = TrackingSize {
        full: (192, 128),
        scaled: (192, 128),
        cropped: (192, 128),
    };
    let exact = MemoryOptions {
        storage: Storage::F32,
        ..memory(100)
    };
    let mut source = NetworkCorrespondence::new(network(), &references, None, size, exact);
    let grid = Grid {
        width: 24,
        height: 16,
    };
    let poses = |name: &str| -> Vec<Se3<f64>> {
        let values = file.doubles(name);
        values
            .as_chunks::<7>()
            .0
            .iter()
            .map(Se3::from_translation_quaternion)
            .collect()
    };
    let planes = |name: &str| -> Vec<Vec<f32>> {
        let single = |plane: &[f64]| plane.iter().map(|&d| d as f32).collect();
        file.doubles(name).chunks(grid.len()).map(single).collect()
    };
    let k = file.doubles("intrinsics");
    let mut geometry = Geometry {
        grid,
        lens: Pinhole {
            fx: k[0],
            fy: k[1],
            cx: k[2],
            cy: k[3],
        },
        poses: poses("poses"),
        disparity: planes("disps"),
        sensor: planes("disps_sens"),
    };
    let pairs: Vec<(usize, usize)> = file
        .indices("ii")
        .into_iter()
        .zip(file.indices("jj"))
        .collect();
    let frames: Vec<usize> = (0..geometry.poses.len()).collect();
    let mut graph = FactorGraph::new(usize::MAX);
    graph.add(&pairs, &geometry, &frames, false);
    // Edges of one source have to be together.
    graph.active.sort_by_key(|e| e.factor.source);
    let at = |pair: &(usize, usize), graph: &FactorGraph| {
        graph.active.iter().position(|e| e.ends() == *pair).unwrap()
    };
    source.change(&graph.take_changes()).unwrap();
    let mut eta = vec![vec![1e-6_f32; grid.len()]; frames.len()];
    let options = DbaOptions {
        prior_alpha: Some(0.05),
        min_depth: 0.2,
        ..DbaOptions::default()
    };
    for step in 0..3 {
        revise(&geometry, &mut graph, &mut eta, &mut source);
        let in_order: Vec<usize> = pairs.iter().map(|pair| at(pair, &graph)).collect();
        let m: Vec<f32> = in_order
            .iter()
            .flat_map(|&e| graph.active[e].static_confidence.clone())
            .collect();
        assert_close(
            &format!("step {step}: static confidence"),
            &m,
            &singles(&format!("it{step}_m")),
            1e-4,
        );
        let edges: Vec<&Factor<f32>> = graph.active.iter().map(|e| &e.factor).collect();
        let damped: Vec<Vec<f32>> = eta
            .iter()
            .map(|plane| plane.iter().map(|e| e + 1e-7).collect())
            .collect();
        let problem = Problem {
            edges: &edges,
            eta: &damped,
        };
        adjust(&mut geometry, &problem, 1..frames.len(), &options).unwrap();
        for (frame, (got, want)) in geometry
            .poses
            .iter()
            .zip(poses(&format!("it{step}_poses")))
            .enumerate()
        {
            let off = (got.matrix() - want.matrix()).amax();
            assert!(off < 1e-5, "step {step}, frame {frame}: pose off by {off}");
        }
        let want = planes(&format!("it{step}_disps")).concat();
        assert_close(
            &format!("step {step}: disparity"),
            &geometry.disparity.concat(),
            &want,
            1e-4,
        );
    }
    let target: Vec<f32> = pairs
        .iter()
        .flat_map(|pair| {
            let [u, v] = &graph.active[at(pair, &graph)].factor.target_px;
            u.iter()
                .zip(v)
                .flat_map(|(&u, &v)| [u, v])
                .collect::<Vec<f32>>()
        })
        .collect();
    assert_close("targets", &target, &singles("target_final"), 1e-4);
}

/// The images of a fixture, `[n][3][h][w]` in the order blue, green, red.
fn images(file: &Fixture) -> Vec<RgbImage> {
    let bytes = file.bytes("images_bgr_u8");
    let (w, h) = (192, 128);
    let image =
        |bgr: &[u8]| Plane::from_fn(w, h, |x, y| [2, 1, 0].map(|c| bgr[(c * h + y) * w + x]));
    bytes.chunks(3 * w * h).map(image).collect()
}

/// Asks for all edges at once, from where `geometry` projects pixels.
fn revise(
    geometry: &Geometry<f32>,
    graph: &mut FactorGraph,
    eta: &mut [Vec<f32>],
    source: &mut dyn Correspondence,
) {
    let grid = geometry.grid;
    let projected = |i: usize, j: usize| {
        let g = geometry.relative(i, j);
        let mut planes = [Vec::new(), Vec::new()];
        for n in 0..grid.len() {
            let (u, v) = ((n % grid.width) as f64, (n / grid.width) as f64);
            let p = project(
                &g,
                &geometry.lens,
                1.0,
                u,
                v,
                f64::from(geometry.disparity[i][n]),
            );
            planes[0].push(p.pixel.x as f32);
            planes[1].push(p.pixel.y as f32);
        }
        planes
    };
    let mut revision = Revision {
        grid,
        edges: Vec::new(),
        sources: Vec::new(),
    };
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    for (k, edge) in graph.active.iter_mut().enumerate() {
        let (i, j) = edge.ends();
        match ranges.last_mut() {
            Some((source, _)) if *source == i => {}
            _ => ranges.push((i, k)),
        }
        revision.edges.push(EdgeRevision {
            key: edge.key,
            projected_px: projected(i, j),
            target_px: &mut edge.factor.target_px,
            weight: &mut edge.factor.weight,
            static_confidence: &mut edge.static_confidence,
        });
    }
    let ends: Vec<usize> = ranges
        .iter()
        .skip(1)
        .map(|r| r.1)
        .chain([revision.edges.len()])
        .collect();
    let mut eta: Vec<Option<&mut Vec<f32>>> = eta.iter_mut().map(Some).collect();
    for ((frame, begin), end) in ranges.into_iter().zip(ends) {
        revision.sources.push(SourceRevision {
            frame,
            edges: begin..end,
            damping: eta[frame].take().unwrap(),
        });
    }
    source.revise(&mut revision).unwrap();
    for edge in &mut revision.edges {
        for plane in edge.weight.iter_mut() {
            for (w, &m) in plane.iter_mut().zip(edge.static_confidence.iter()) {
                *w *= m;
            }
        }
    }
}
