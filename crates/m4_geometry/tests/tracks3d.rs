//! Points of boxes followed behind a pillar and out of the image, against the truth.
#![expect(clippy::print_stdout, reason = "figures that the documentation names")]

use crate::track_support::score::Score;
use crate::track_support::{TrueFlow, clip, score};
use m4_core::{Progress, Silent};
use m4_geometry::classical::dense::InverseSearch;
use m4_geometry::tracks::{
    FlowTracker, PosedClip, PosedFrame, Query, QueryGrid, TrackConfig, TrackError, TrackedPoints, Tracker3d,
};
use m4_testkit::BoxScene;

const SIZE: (usize, usize) = (192, 144);
const FRAMES: usize = 32;

fn scene() -> BoxScene {
    BoxScene::new(SIZE.0, SIZE.1, FRAMES)
}

fn config(fill: bool) -> TrackConfig {
    TrackConfig {
        fill,
        ..TrackConfig::default()
    }
}

fn measured(scene: &BoxScene, fill: bool) -> Result<(TrackedPoints, Score), TrackError> {
    let flow = TrueFlow::new(scene);
    let tracker = FlowTracker {
        flow: &flow,
        config: config(fill),
    };
    let followed = tracker.follow_grid(&clip(scene), &QueryGrid::default(), &Silent)?;
    let score = score(scene, &followed);
    println!("true flow, hidden points carried on: {fill}: {score}");
    Ok((followed, score))
}

#[test]
fn occluded_points_move_with_their_object() {
    let scene = scene();
    let (_, chains) = measured(&scene, false).unwrap();
    let (_, filled) = measured(&scene, true).unwrap();
    // chains alone know nothing of what is hidden
    assert!(chains.tracks > 200 && chains.recovered < 0.05);
    assert!(chains.seen_percent < 0.1, "{}", chains.seen_percent);
    assert!(filled.seen_percent < 0.1 && filled.hidden_percent < 1.0);
    assert!(filled.recovered > 0.75 && filled.survival > 0.9);
    assert!(filled.survival > chains.survival + 0.2);
    assert!(filled.false_seen < 0.05);
}

#[test]
fn our_own_flow_is_nearly_as_good() {
    let scene = scene();
    let search = InverseSearch;
    let tracker = FlowTracker {
        flow: &search,
        config: config(true),
    };
    let followed = tracker
        .follow_grid(&clip(&scene), &QueryGrid::default(), &Silent)
        .unwrap();
    let score = score(&scene, &followed);
    println!("own flow: {score}");
    assert!(score.seen_percent < 0.8 && score.hidden_percent < 2.5);
    assert!(score.recovered > 0.5 && score.survival > 0.65);
}

#[test]
fn a_query_is_answered_in_its_place_of_the_list() {
    let scene = scene();
    let (flow, clip) = (TrueFlow::new(&scene), clip(&scene));
    let tracker = FlowTracker {
        flow: &flow,
        config: config(true),
    };
    // three points of the box that passes, one of the wall, in two frames
    let at = |t: usize, x: usize, y: usize| {
        let depth = scene.hit(t, x, y).depth as f32;
        Query::at_pixel(t, &scene.cameras[t], [x as f32, y as f32], depth)
    };
    let pixels = || {
        (0..SIZE.0 * SIZE.1)
            .filter(move |i| i % 7 == 0)
            .map(|i| (i % SIZE.0, i / SIZE.0))
    };
    let mut queries: Vec<Query> = pixels()
        .filter(|&(x, y)| scene.hit(20, x, y).body == 2)
        .take(80)
        .map(|(x, y)| at(20, x, y))
        .collect();
    queries.push(at(5, 3, 3));
    queries.extend(
        pixels()
            .filter(|&(x, y)| scene.hit(2, x, y).body == 2)
            .take(80)
            .map(|(x, y)| at(2, x, y)),
    );
    let followed = tracker.follow(&clip, &queries, &Silent).unwrap();
    assert_eq!(followed.queries, queries);
    assert_eq!(
        (followed.tracks.count(), followed.tracks.frames()),
        (queries.len(), FRAMES)
    );
    for (k, q) in queries.iter().enumerate() {
        assert_eq!(followed.tracks.place(q.frame, k), Some(q.xyz));
        assert_eq!(followed.tracks.confidence(q.frame, k), 1.0);
    }
    let moving = TrackedPoints::new(
        FRAMES,
        queries[..80].to_vec(),
        (0..FRAMES * 80)
            .map(|i| followed.tracks.place(i / 80, i % 80).unwrap_or([f32::NAN; 3]))
            .collect(),
        (0..FRAMES * 80)
            .map(|i| followed.tracks.visible()[i / 80 * queries.len() + i % 80])
            .collect(),
        vec![1.0; FRAMES * 80],
    )
    .unwrap();
    let score = score(&scene, &moving);
    println!("queries in one frame: {score}");
    assert!(score.survival > 0.7);
    let bad = [
        queries[0],
        Query {
            frame: FRAMES,
            ..queries[0]
        },
    ];
    assert!(matches!(
        tracker.follow(&clip, &bad, &Silent),
        Err(TrackError::Query { query: 1, .. })
    ));
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let scene = BoxScene::new(96, 72, 16);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| measured(&scene, true).unwrap().0)
    };
    let bits = |f: &TrackedPoints| -> Vec<u32> {
        let places = f.tracks.xyz().as_flattened().iter().map(|v| v.to_bits());
        let trust = (0..f.tracks.frames()).flat_map(|t| (0..f.tracks.count()).map(move |k| (t, k)));
        places
            .chain(trust.map(|(t, k)| f.tracks.confidence(t, k).to_bits()))
            .collect()
    };
    let (one, three) = (with(1), with(3));
    assert!(one.tracks.count() > 20);
    assert_eq!(bits(&one), bits(&three));
    assert_eq!(one.tracks.visible(), three.tracks.visible());
}

/// Answers every query with its own place, always in view.
struct Still;

impl Tracker3d for Still {
    fn name(&self) -> &str {
        "still"
    }

    fn follow(&self, clip: &dyn PosedClip, queries: &[Query], _: &dyn Progress) -> Result<TrackedPoints, TrackError> {
        let frames = clip.frames();
        let xyz = (0..frames).flat_map(|_| queries.iter().map(|q| q.xyz)).collect();
        TrackedPoints::from_probabilities(frames, queries.to_vec(), xyz, vec![0.95; frames * queries.len()], 0.9)
    }
}

#[test]
fn queries_lie_in_the_masks_and_avoid_tracked_points() {
    let scene = BoxScene::new(96, 72, 11);
    let clip = clip(&scene);
    let ask = |grid: QueryGrid| Still.follow_grid(&clip, &grid, &Silent).unwrap();
    let once = ask(QueryGrid {
        every: 2,
        ..QueryGrid::default()
    });
    for q in &once.queries {
        assert_eq!(q.frame % 2, 0);
        let ([u, v], z) = scene.cameras[q.frame].project(&q.xyz.map(f64::from).into());
        let hit = scene.hit(q.frame, u.round() as usize, v.round() as usize);
        assert!(BoxScene::moves(hit.body) && (hit.depth - z).abs() < 1e-3);
    }
    assert!(once.tracks.visible().iter().all(|v| *v));
    let rounds = ask(QueryGrid {
        every: 2,
        rounds: 3,
        ..QueryGrid::default()
    });
    assert!(rounds.queries.len() * 3 > once.queries.len() && rounds.queries.len() < once.queries.len());
    let few = ask(QueryGrid {
        most: 9,
        rounds: 2,
        every: 5,
        ..QueryGrid::default()
    });
    assert_eq!(few.queries.len(), 9);
    let zero = QueryGrid {
        spacing_px: 0,
        ..QueryGrid::default()
    };
    assert!(matches!(
        Still.follow_grid(&clip, &zero, &Silent),
        Err(TrackError::Setting { name: "spacing_px", .. })
    ));
}

struct Stop;

impl Progress for Stop {
    fn update(&self, _: &str, _: usize, _: usize, _: &str) {}
    fn warn(&self, _: &str) {}
    fn cancelled(&self) -> bool {
        true
    }
}

#[test]
fn untrackable_input_is_reported_and_static_scene_is_not_an_error() {
    let scene = BoxScene::new(64, 48, 4);
    let flow = TrueFlow::new(&scene);
    let tracker = FlowTracker {
        flow: &flow,
        config: config(true),
    };
    let grid = QueryGrid::default();
    let mut clip = clip(&scene);
    let stopped = tracker.follow_grid(&clip, &grid, &Stop);
    assert!(matches!(stopped, Err(TrackError::Cancelled { .. })));
    for frame in &mut clip {
        frame.moving.data_mut().fill(0);
    }
    assert_eq!(tracker.follow_grid(&clip, &grid, &Silent).unwrap().tracks.count(), 0);
    assert_eq!(tracker.follow(&clip, &[], &Silent).unwrap().tracks.count(), 0);
    assert_eq!(
        tracker
            .follow(&Vec::<PosedFrame>::new(), &[], &Silent)
            .unwrap()
            .tracks
            .frames(),
        0
    );
    clip[2].depth = scene_depth(&scene);
    let wrong = tracker.follow_grid(&clip, &grid, &Silent);
    assert!(matches!(wrong, Err(TrackError::Frame { frame: 2, .. })));
}

/// Depth of a scene of another size.
fn scene_depth(scene: &BoxScene) -> m4_core::DepthMap {
    let (w, h) = scene.depth(0).size();
    m4_core::Plane::filled(w / 2, h / 2, 1.0)
}
