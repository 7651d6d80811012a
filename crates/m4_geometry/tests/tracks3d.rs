//! Points of boxes followed behind a pillar and out of the image, against the truth.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_core::{Capture, CaptureFrame, CompactMask, Plane, Silent, Tracks, nalgebra::Vector3};
use m4_geometry::tracks::{CaptureClip, QueryGrid, TrackError, follow};
use m4_testkit::{BoxScene, StopAtPoll};

/// The frames of a scene, with true geometry.
fn capture(scene: &BoxScene) -> Capture {
    let frame = |t: usize| CaptureFrame {
        name: format!("{t:05}"),
        camera: scene.cameras[t],
        t: t as f64,
        rgb: scene.rgb(t),
        depth: Some(scene.depth(t).into()),
        mask: Some(scene.mask(t).into()),
        motion: None,
        instances: None,
        camera_index: None,
        distance_sigma: None,
    };
    let frames: Vec<CaptureFrame> = (0..scene.frames()).map(frame).collect();
    Capture {
        time_frames: frames.len(),
        frames,
        duration_s: None,
        metric: true,
        tracks: None,
    }
}

fn clip(capture: &Capture) -> CaptureClip<'_> {
    CaptureClip::new(capture, 1000)
}

/// How far tracks are from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Score {
    tracks: usize,
    /// Median distance to the truth where a point is reported visible, and where not, in per cent
    /// of its depth.
    seen_percent: f64,
    hidden_percent: f64,
    /// Share of all frames of all tracks in which the place is known and right: within 5 % of the
    /// depth and 10 px.
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

/// Compares with the truth; the point of a track is the one that is seen first.
fn score(scene: &BoxScene, tracks: &Tracks) -> Score {
    let (mut seen_errors, mut hidden_errors) = (Vec::new(), Vec::new());
    let (mut all, mut right, mut hidden, mut recovered, mut said, mut wrong) =
        (0u32, 0u32, 0u32, 0u32, 0u32, 0u32);
    let visible = |t: usize, k: usize| tracks.visible()[t * tracks.count() + k];
    for k in 0..tracks.count() {
        let first = (0..scene.frames()).find(|&t| visible(t, k)).unwrap();
        let place = tracks.place(first, k).unwrap();
        let ([u, v], _) = scene.cameras[first].project(&place.map(f64::from).into());
        let hit = scene.cast(first, u, v);
        for t in 0..scene.frames() {
            let truth = scene.place(hit.body, &hit.local, t);
            let (true_px, z) = scene.cameras[t].project(&truth);
            let sees = scene.sees(hit.body, &hit.local, t);
            all += 1;
            hidden += u32::from(!sees);
            let visible = visible(t, k);
            said += u32::from(visible);
            wrong += u32::from(visible && !sees);
            let Some(place) = tracks.place(t, k) else {
                continue;
            };
            let place = Vector3::from(place.map(f64::from));
            let error = 100.0 * (truth - place).norm() / z;
            if visible {
                &mut seen_errors
            } else {
                &mut hidden_errors
            }
            .push(error);
            let (here, depth) = scene.cameras[t].project(&place);
            let off_px = (here[0] - true_px[0]).hypot(here[1] - true_px[1]);
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

#[test]
fn occluded_points_move_with_their_object() {
    let scene = BoxScene::new(SIZE.0, SIZE.1, FRAMES);
    let tracks = follow(&clip(&capture(&scene)), &QueryGrid::default(), &Silent).unwrap();
    let score = score(&scene, &tracks);
    println!("{score:?}");
    assert!(score.tracks > 200 && score.seen_percent < 0.8 && score.hidden_percent < 2.5);
    assert!(score.recovered > 0.5 && score.survival > 0.65 && score.false_seen < 0.1);
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let capture = capture(&BoxScene::new(96, 72, 16));
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| follow(&clip(&capture), &QueryGrid::default(), &Silent).unwrap())
    };
    let bits = |tracks: &Tracks| -> Vec<u32> {
        let places = tracks.xyz().as_flattened().iter().map(|v| v.to_bits());
        let trust = (0..tracks.frames()).flat_map(|t| (0..tracks.count()).map(move |k| (t, k)));
        places
            .chain(trust.map(|(t, k)| tracks.confidence(t, k).to_bits()))
            .collect()
    };
    let (one, three) = (with(1), with(3));
    assert!(one.count() > 20);
    assert_eq!(bits(&one), bits(&three));
    assert_eq!(one.visible(), three.visible());
}

#[test]
fn queries_lie_in_the_masks() {
    let scene = BoxScene::new(96, 72, 11);
    let capture = capture(&scene);
    let ask = |grid: QueryGrid| grid.queries("still", &clip(&capture), &Silent);
    let all = QueryGrid {
        every: 2,
        ..QueryGrid::default()
    };
    let queries = ask(all).unwrap();
    assert!(queries.len() > 20);
    for q in &queries {
        assert_eq!(q.frame % 2, 0);
        let ([u, v], z) = scene.cameras[q.frame].project(&q.xyz.map(f64::from).into());
        let hit = scene.hit(q.frame, u.round() as usize, v.round() as usize);
        assert!(BoxScene::moves(hit.body) && (hit.depth - z).abs() < 1e-3);
    }
    assert_eq!(ask(QueryGrid { most: 9, ..all }).unwrap().len(), 9);
    let zero = ask(QueryGrid {
        spacing_px: 0,
        ..all
    });
    assert!(matches!(
        zero,
        Err(TrackError::Setting {
            name: "spacing_px",
            ..
        })
    ));
}

#[test]
fn untrackable_input_is_reported_and_static_scene_is_not_an_error() {
    let mut capture = capture(&BoxScene::new(64, 48, 4));
    let grid = QueryGrid::default();
    let stopped = follow(&clip(&capture), &grid, &StopAtPoll::after(0));
    assert!(matches!(stopped, Err(TrackError::Cancelled { .. })));
    for frame in &mut capture.frames {
        frame.mask = Some(CompactMask::from_fn(64, 48, |_, _| false));
    }
    assert_eq!(follow(&clip(&capture), &grid, &Silent).unwrap().count(), 0);
    capture.frames[2].rgb = Plane::filled(32, 24, [0; 3]);
    assert!(matches!(
        follow(&clip(&capture), &grid, &Silent),
        Err(TrackError::Frame { frame: 2, .. })
    ));
    capture.frames.clear();
    assert_eq!(follow(&clip(&capture), &grid, &Silent).unwrap().frames(), 0);
}
