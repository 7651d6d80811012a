//! Points of boxes followed behind a pillar and out of the image, against the truth.
#![expect(clippy::print_stdout, reason = "figures that the documentation names")]

use m4_core::{Flow, Plane, RgbImage, Silent, nalgebra::Vector3};
use m4_geometry::classical::dense::{FlowError, FlowImage, FlowSource, InverseSearch};
use m4_geometry::tracks::{FlowTracker, PosedFrame, QueryGrid, TrackConfig, TrackError, TrackedPoints, Tracker3d};
use m4_testkit::{BoxScene, StopAtPoll};

/// True flow: images are known by their pixels.
struct TrueFlow<'a> {
    scene: &'a BoxScene,
    images: Vec<RgbImage>,
}

impl<'a> TrueFlow<'a> {
    fn new(scene: &'a BoxScene) -> Self {
        let images = (0..scene.frames()).map(|t| scene.rgb(t)).collect();
        Self { scene, images }
    }
}

impl FlowSource for TrueFlow<'_> {
    fn name(&self) -> &str {
        "true"
    }

    fn both(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> Result<(Flow, Flow), FlowError> {
        let index = |p: &FlowImage<'_>| {
            let at = self.images.iter().position(|q| q.data() == p.rgb);
            at.ok_or_else(|| FlowError::Source { source_name: "true".to_owned(), reason: "an unknown image".into() })
        };
        let (from, to) = (index(a)?, index(b)?);
        let flow = |from, to| {
            let (u, v) = self.scene.flow(from, to);
            Flow { width: a.width, height: a.height, u, v }
        };
        Ok((flow(from, to), flow(to, from)))
    }
}

/// The frames of a scene, with true geometry.
fn clip(scene: &BoxScene) -> Vec<PosedFrame> {
    (0..scene.frames())
        .map(|t| PosedFrame {
            rgb: scene.rgb(t),
            depth: scene.depth(t),
            moving: scene.mask(t),
            camera: scene.cameras[t],
        })
        .collect()
}

/// How far tracks are from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Score {
    tracks: usize,
    /// Median distance to the truth where a point is reported visible, and where not, in per cent of its depth.
    seen_percent: f64,
    hidden_percent: f64,
    /// Share of all frames of all tracks in which the place is known and right: within 5 % of the depth and 10 px.
    survival: f64,
    /// The same among the frames in which the point cannot be seen.
    recovered: f64,
    /// Frames in which the point cannot be seen, of all.
    hidden: f64,
    /// Share of the frames said to see a point that do not.
    false_seen: f64,
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Compares with the truth; the point of a track is the one that its query shows.
fn score(scene: &BoxScene, followed: &TrackedPoints) -> Score {
    let tracks = &followed.tracks;
    let (mut seen_errors, mut hidden_errors) = (Vec::new(), Vec::new());
    let (mut all, mut right, mut hidden, mut recovered, mut said, mut wrong) = (0u32, 0u32, 0u32, 0u32, 0u32, 0u32);
    for (k, query) in followed.queries.iter().enumerate() {
        let ([u, v], _) = scene.cameras[query.frame].project(&query.xyz.map(f64::from).into());
        let hit = scene.cast(query.frame, u, v);
        for t in 0..scene.frames() {
            let truth = scene.place(hit.body, &hit.local, t);
            let (there, z) = scene.cameras[t].project(&truth);
            let sees = scene.sees(hit.body, &hit.local, t);
            all += 1;
            hidden += u32::from(!sees);
            let visible = tracks.visible()[t * tracks.count() + k];
            said += u32::from(visible);
            wrong += u32::from(visible && !sees);
            let Some(place) = tracks.place(t, k) else { continue };
            let place = Vector3::from(place.map(f64::from));
            let error = 100.0 * (truth - place).norm() / z;
            if visible { &mut seen_errors } else { &mut hidden_errors }.push(error);
            let (here, depth) = scene.cameras[t].project(&place);
            let off_px = (here[0] - there[0]).hypot(here[1] - there[1]);
            if (depth / z - 1.0).abs() <= 0.05 && off_px <= 10.0 {
                right += 1;
                recovered += u32::from(!sees);
            }
        }
    }
    let share = |a: u32, b: u32| f64::from(a) / f64::from(b.max(1));
    Score {
        tracks: tracks.count(),
        seen_percent: median(seen_errors),
        hidden_percent: median(hidden_errors),
        survival: share(right, all),
        recovered: share(recovered, hidden),
        hidden: share(hidden, all),
        false_seen: share(wrong, said),
    }
}

const SIZE: (usize, usize) = (192, 144);
const FRAMES: usize = 32;

fn scene() -> BoxScene {
    BoxScene::new(SIZE.0, SIZE.1, FRAMES)
}

fn config(fill: bool) -> TrackConfig {
    TrackConfig { fill, ..TrackConfig::default() }
}

fn measured(scene: &BoxScene, fill: bool) -> Result<(TrackedPoints, Score), TrackError> {
    let flow = TrueFlow::new(scene);
    let tracker = FlowTracker { flow: &flow, config: config(fill) };
    let followed = tracker.follow_grid(&clip(scene), &QueryGrid::default(), &Silent)?;
    let score = score(scene, &followed);
    println!("true flow, hidden points carried on: {fill}: {score:?}");
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
    let tracker = FlowTracker { flow: &search, config: config(true) };
    let followed = tracker.follow_grid(&clip(&scene), &QueryGrid::default(), &Silent).unwrap();
    let score = score(&scene, &followed);
    println!("own flow: {score:?}");
    assert!(score.seen_percent < 0.8 && score.hidden_percent < 2.5);
    assert!(score.recovered > 0.5 && score.survival > 0.65);
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
        places.chain(trust.map(|(t, k)| f.tracks.confidence(t, k).to_bits())).collect()
    };
    let (one, three) = (with(1), with(3));
    assert!(one.tracks.count() > 20);
    assert_eq!(bits(&one), bits(&three));
    assert_eq!(one.tracks.visible(), three.tracks.visible());
}

#[test]
fn queries_lie_in_the_masks() {
    let scene = BoxScene::new(96, 72, 11);
    let clip = clip(&scene);
    let ask = |grid: QueryGrid| grid.queries("still", &clip, &Silent);
    let all = QueryGrid { every: 2, ..QueryGrid::default() };
    let queries = ask(all).unwrap();
    assert!(queries.len() > 20);
    for q in &queries {
        assert_eq!(q.frame % 2, 0);
        let ([u, v], z) = scene.cameras[q.frame].project(&q.xyz.map(f64::from).into());
        let hit = scene.hit(q.frame, u.round() as usize, v.round() as usize);
        assert!(BoxScene::moves(hit.body) && (hit.depth - z).abs() < 1e-3);
    }
    assert_eq!(ask(QueryGrid { most: 9, ..all }).unwrap().len(), 9);
    let zero = ask(QueryGrid { spacing_px: 0, ..all });
    assert!(matches!(zero, Err(TrackError::Setting { name: "spacing_px", .. })));
}

#[test]
fn untrackable_input_is_reported_and_static_scene_is_not_an_error() {
    let scene = BoxScene::new(64, 48, 4);
    let flow = TrueFlow::new(&scene);
    let tracker = FlowTracker { flow: &flow, config: config(true) };
    let grid = QueryGrid::default();
    let mut clip = clip(&scene);
    let stopped = tracker.follow_grid(&clip, &grid, &StopAtPoll::after(0));
    assert!(matches!(stopped, Err(TrackError::Cancelled { .. })));
    for frame in &mut clip {
        frame.moving.data_mut().fill(0);
    }
    assert_eq!(tracker.follow_grid(&clip, &grid, &Silent).unwrap().tracks.count(), 0);
    let empty = tracker.follow_grid(&Vec::<PosedFrame>::new(), &grid, &Silent);
    assert_eq!(empty.unwrap().tracks.frames(), 0);
    clip[2].depth = Plane::filled(32, 24, 1.0);
    let wrong = tracker.follow_grid(&clip, &grid, &Silent);
    assert!(matches!(wrong, Err(TrackError::Frame { frame: 2, .. })));
}
