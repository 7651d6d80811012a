//! Made clips: one take of every kind stays whole, and what is no take is named.

use super::{Exposure, LeftOut, Overlays, Reason, Shot, Timeline};
use m4_core::{CounterRng, Plane, RgbImage};

const SIZE: (usize, usize) = (192, 108);
const FPS: f64 = 24.0;

/// What a camera sees that points at `at`, image widths, in the place of number `place`: waves of
/// many lengths.
fn scene(place: usize, at: [f64; 2]) -> RgbImage {
    let waves: Vec<[f64; 3]> = (0..10)
        .map(|k| {
            let turn = 2.4 * f64::from(k) + 1.9 * place as f64;
            let length = 9.0 * 1.31_f64.powi(k);
            let phase = (1.7 + f64::from(k)) * (1.0 + place as f64);
            [length * turn.cos(), length * turn.sin(), phase]
        })
        .collect();
    let width = SIZE.0 as f64;
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
        let (u, v) = (x as f64 / width + at[0], y as f64 / width + at[1]);
        let value: f64 = waves
            .iter()
            .map(|[a, b, c]| (a * u + b * v + c).sin())
            .sum();
        let grey = 125.0 + 26.0 * value;
        [grey, grey + 6.0, grey - 9.0].map(|v| v.clamp(0.0, 255.0) as u8)
    })
}

/// `n` frames of a camera that turns by `speed`, image widths per second.
fn pan(place: usize, n: usize, speed: f64) -> Vec<RgbImage> {
    let at = |i: usize| speed * i as f64 / FPS;
    (0..n).map(|i| scene(place, [at(i), 0.3 * at(i)])).collect()
}

/// What a sensor adds.
fn noisy(images: Vec<RgbImage>) -> Vec<RgbImage> {
    let add = |(i, image): (usize, RgbImage)| {
        let mut rng = CounterRng::new(5, 0, i as u64);
        image.map(|rgb| rgb.map(|v| (f64::from(v) + 2.0 * rng.normal()).clamp(0.0, 255.0) as u8))
    };
    images.into_iter().enumerate().map(add).collect()
}

/// Brightness times `factor`.
fn lit(image: &RgbImage, factor: f64) -> RgbImage {
    image.map(|rgb| rgb.map(|v| (f64::from(v) * factor).clamp(0.0, 255.0) as u8))
}

/// `share` of `a`, the rest of `b`.
fn mixed(a: &RgbImage, b: &RgbImage, share: f64) -> RgbImage {
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
        std::array::from_fn(|k| {
            let (a, b) = (f64::from(a[(x, y)][k]), f64::from(b[(x, y)][k]));
            (share * a + (1.0 - share) * b) as u8
        })
    })
}

fn times(n: usize, fps: f64) -> Vec<f64> {
    (0..n).map(|i| i as f64 / fps).collect()
}

fn timeline_at(images: &[RgbImage], fps: f64) -> Timeline {
    let images: Vec<&RgbImage> = images.iter().collect();
    Timeline::new(&images, &times(images.len(), fps))
}

fn timeline(images: &[RgbImage]) -> Timeline {
    timeline_at(images, FPS)
}

fn indices(shot: &Shot) -> Vec<usize> {
    shot.frames.iter().map(|f| f.index).collect()
}

fn left_out(timeline: &Timeline, reason: Reason) -> Vec<usize> {
    let all = timeline.left_out.iter();
    all.filter(|left| left.reason == reason)
        .map(|left| left.index)
        .collect()
}

#[test]
fn one_take_stays_whole() {
    let tripod = vec![scene(0, [0.0; 2]); 40];
    let mut pause = pan(2, 20, 0.3);
    pause.extend(vec![pause[19].clone(); 30]);
    pause.extend(pan(2, 20, 0.3).into_iter().rev());
    let close: Vec<RgbImage> = pan(3, 40, 0.2)
        .iter()
        .enumerate()
        // A dark object passes close in front of the camera.
        .map(|(i, image)| {
            Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
                let x = x as f64 / SIZE.0 as f64;
                let left = i as f64 / 20.0 - 0.7;
                if (left..left + 0.5).contains(&x) {
                    [40, 35, 30]
                } else {
                    image[(x_of(x), y)]
                }
            })
        })
        .collect();
    for (name, images) in [
        ("a slow turn", noisy(pan(0, 48, 0.15))),
        ("a fast turn", noisy(pan(1, 48, 1.5))),
        ("a tripod", noisy(tripod.clone())),
        ("one image", tripod),
        ("a pause", noisy(pause)),
        ("an object close by", noisy(close)),
        (
            "darkness",
            noisy(vec![Plane::filled(SIZE.0, SIZE.1, [6; 3]); 30]),
        ),
        (
            "little light",
            noisy(
                pan(4, 30, 0.2)
                    .iter()
                    .map(|image| lit(image, 0.1))
                    .collect(),
            ),
        ),
        ("one frame", pan(0, 1, 0.0)),
    ] {
        let n = images.len();
        let timeline = timeline(&images);
        assert_eq!(timeline.left_out, [], "{name}");
        assert_eq!(timeline.shots.len(), 1, "{name}");
        let shot = &timeline.shots[0];
        assert_eq!(indices(shot), (0..n).collect::<Vec<_>>(), "{name}");
        let same = |f: &super::Shown| f.time_s == f.index as f64 / FPS;
        assert!(shot.frames.iter().all(same), "{name}");
    }
}

fn x_of(x: f64) -> usize {
    (x * SIZE.0 as f64).round() as usize
}

#[test]
fn cuts_divide_a_clip_into_shots() {
    let mut images = pan(0, 20, 0.2);
    images.extend(pan(1, 8, 0.2));
    images.extend(pan(2, 30, 0.2));
    images.extend(pan(3, 16, 0.2));
    let timeline = timeline(&noisy(images));
    let shots: Vec<Vec<usize>> = timeline.shots.iter().map(indices).collect();
    // The second lasts a third of a second.
    assert_eq!(
        shots,
        [(0..20), (28..58), (58..74)].map(|r| r.collect::<Vec<_>>())
    );
    assert_eq!(
        left_out(&timeline, Reason::Short),
        (20..28).collect::<Vec<_>>()
    );
    assert_eq!(timeline.longest(), 1);
    let [from, to] = timeline.shots[1].span_s();
    assert!((from - 28.0 / FPS).abs() + (to - 57.0 / FPS).abs() < 1e-9);
}

#[test]
fn blank_frames_and_fades_are_left_out() {
    let black: RgbImage = Plane::filled(SIZE.0, SIZE.1, [0; 3]);
    let white: RgbImage = Plane::filled(SIZE.0, SIZE.1, [255; 3]);
    // A finger: red light, brighter in the middle.
    let finger: RgbImage = Plane::from_fn(SIZE.0, SIZE.1, |x, _| {
        [90 + (40 * x / SIZE.0) as u8, 20, 12]
    });
    for (name, blank) in [("black", black), ("white", white), ("a finger", finger)] {
        let mut images = pan(0, 48, 0.2);
        for image in &mut images[20..28] {
            *image = blank.clone();
        }
        let timeline = timeline(&noisy(images));
        assert_eq!(
            left_out(&timeline, Reason::Blank),
            (20..28).collect::<Vec<_>>(),
            "{name}"
        );
        // The camera went on meanwhile: one shot.
        assert_eq!(timeline.shots.len(), 1, "{name}");
        assert_eq!(timeline.shots[0].frames.len(), 40, "{name}");
    }
    let fade = |i: usize| (i as f64 / 12.0).min((71 - i) as f64 / 12.0).min(1.0);
    let images: Vec<RgbImage> = pan(1, 72, 0.2)
        .iter()
        .enumerate()
        .map(|(i, image)| lit(image, fade(i)))
        .collect();
    let timeline = timeline(&noisy(images));
    let blank = left_out(&timeline, Reason::Blank);
    assert_eq!(timeline.left_out.len(), blank.len());
    let kept = indices(&timeline.shots[0]);
    // What is kept has four fifths of its light.
    assert!(
        (8..=12).contains(&kept[0]) && (59..=63).contains(kept.last().unwrap_or(&0)),
        "{kept:?}"
    );
    assert_eq!(kept.len() + blank.len(), 72);
}

#[test]
fn dissolves_part_shots_of_a_calm_camera() {
    let (a, b) = (pan(0, 60, 0.02), pan(2, 60, 0.02));
    let share = |i: usize| (1.0 - (i as f64 - 24.0) / 12.0).clamp(0.0, 1.0);
    let images = (0..60).map(|i| mixed(&a[i], &b[i], share(i))).collect();
    let timeline = timeline(&noisy(images));
    assert_eq!(timeline.shots.len(), 2);
    let dissolve = left_out(&timeline, Reason::Dissolve);
    let (first, last) = (dissolve[0], dissolve[dissolve.len() - 1]);
    assert!(
        (24..=26).contains(&first) && (34..=36).contains(&last),
        "{dissolve:?}"
    );
}

#[test]
fn a_flash_is_left_out() {
    let mut images = pan(0, 40, 0.2);
    images[17] = scene(7, [0.0; 2]);
    images[18] = scene(8, [0.0; 2]);
    let timeline = timeline(&noisy(images));
    let odd = [17, 18].map(|index| LeftOut {
        index,
        reason: Reason::Odd,
    });
    assert_eq!(
        (timeline.left_out.as_slice(), timeline.shots.len()),
        (&odd[..], 1)
    );
}

#[test]
fn repeated_frames_are_left_out_and_times_are_evened() {
    for (taken, shown) in [
        (24.0, 60.0),
        (24.0, 30.0),
        (25.0, 30.0),
        (30.0, 60.0),
        (15.0, 60.0),
    ] {
        let all = pan(0, 80, 0.4);
        // Some noise of compression.
        let n = (2.0 * shown) as usize;
        let frame = |i: usize| all[(i as f64 * taken / shown + 1e-9) as usize].clone();
        let images: Vec<RgbImage> = (0..n)
            .map(|i| {
                let mut rng = CounterRng::new(9, 0, i as u64);
                frame(i).map(|rgb| rgb.map(|v| v.saturating_add(u8::from(rng.uniform() < 0.05))))
            })
            .collect();
        let timeline = timeline_at(&images, shown);
        assert_eq!(timeline.shots.len(), 1);
        let frames = &timeline.shots[0].frames;
        let count = (2.0 * taken) as usize;
        assert!(
            frames.len().abs_diff(count) <= 1,
            "{taken} at {shown}: {}",
            frames.len()
        );
        for pair in frames.windows(2) {
            let step = pair[1].time_s - pair[0].time_s;
            assert!(
                (step * taken - 1.0).abs() < 0.05,
                "{taken} at {shown}: {step}"
            );
        }
        assert!(frames[0].time_s >= 0.0 && frames[0].time_s < 1.0 / taken);
    }
    // One frame that a recorder showed twice.
    let mut images = pan(1, 40, 0.4);
    images[22] = images[21].clone();
    let timeline = timeline(&images);
    assert_eq!(left_out(&timeline, Reason::Repeated), [22]);
    assert!((timeline.shots[0].frames[22].time_s - 23.0 / FPS).abs() < 1e-9);
}

#[test]
fn a_frozen_image_is_named_and_kept() {
    let mut images = pan(0, 20, 0.4);
    images.extend(vec![images[19].clone(); 24]);
    images.extend((0..20).map(|i| {
        scene(
            0,
            [0.4 * (20 + i) as f64 / FPS, 0.12 * (20 + i) as f64 / FPS],
        )
    }));
    let timeline = timeline(&images);
    assert_eq!(timeline.left_out, []);
    let shot = &timeline.shots[0];
    assert_eq!(
        (timeline.shots.len(), shot.frames.len(), shot.frozen_s.len()),
        (1, 64, 1)
    );
    let [from, to] = shot.frozen_s[0];
    assert!(
        (from - 19.0 / FPS).abs() + (to - 43.0 / FPS).abs() < 1e-9,
        "{from} {to}"
    );
}

#[test]
fn flicker_and_exposure_are_measured() {
    let measured = |factor: &dyn Fn(usize) -> f64| {
        let images: Vec<RgbImage> = pan(0, 72, 0.2)
            .iter()
            .enumerate()
            .map(|(i, image)| lit(image, factor(i)))
            .collect();
        let timeline = timeline(&noisy(images));
        assert_eq!((timeline.shots.len(), timeline.left_out.len()), (1, 0));
        Exposure::of(&timeline.shots[0].frames)
    };
    let steady = measured(&|_| 0.8);
    assert_eq!((steady.flickers(), steady.drifts()), (None, None));
    // A lamp.
    let lamp = measured(&|i| 0.8 + 0.08 * (2.1 * i as f64).sin());
    let flicker = lamp.flickers().unwrap_or(0.0);
    assert!(
        (0.05..0.12).contains(&flicker) && lamp.drifts().is_none(),
        "{flicker}"
    );
    let mut sums = [0.0; 2];
    for (i, value) in lamp.flicker.iter().enumerate().skip(8).take(56) {
        let truth = (1.0 + 0.1 * (2.1 * i as f64).sin()).ln() as f32;
        sums = [sums[0] + (value - truth).powi(2), sums[1] + truth * truth];
    }
    assert!(sums[0] < 0.1 * sums[1], "{sums:?}");
    // The camera looks from a window into the room: the exposure falls by half within a second.
    let automatic = measured(&|i| 1.0 - 0.5 * ((i as f64 - 24.0) / 24.0).clamp(0.0, 1.0));
    let drift = automatic.drifts().unwrap_or(0.0);
    assert!((drift - 2.0_f32.ln()).abs() < 0.12, "{drift}");
    assert_eq!(automatic.flickers(), None);
}

/// Letters: strokes with a dark rim, `n` of them from `(x, y)`.
fn letters(image: &mut RgbImage, (x, y): (usize, usize), n: usize) {
    for k in 0..n {
        let left = x + 7 * k;
        for row in 0..12 {
            for column in 0..6 {
                let stroke = match k % 3 {
                    0 => column % 4 < 2,
                    1 => row % 5 < 2 || column < 2,
                    _ => (row + 2 * column) % 6 < 3,
                };
                image[(left + column, y + row)] = if stroke { [245; 3] } else { [15; 3] };
            }
        }
    }
}

fn overlays(images: &[RgbImage]) -> Overlays {
    let timeline = timeline(images);
    let shot = &timeline.shots[0];
    assert_eq!(shot.frames.len(), images.len());
    let images: Vec<&RgbImage> = images.iter().collect();
    Overlays::of(&images, &shot.frames)
}

#[test]
fn logos_and_subtitles_are_found_where_the_scene_moves() {
    let mut images = pan(0, 72, 0.2);
    for image in &mut images {
        letters(image, (160, 8), 4);
    }
    for image in &mut images[20..60] {
        letters(image, (60, 90), 10);
    }
    let images = noisy(images);
    let overlays = overlays(&images);
    assert_eq!(overlays.frames(), 72);
    let mut errors = [0, 0];
    for (i, image) in images.iter().enumerate() {
        let mask = overlays.mask(i, SIZE).unwrap();
        let covered = |x, y| mask[(x, y)] == 255;
        let subtitled = (20..60).contains(&i);
        assert!(covered(172, 14), "{i}");
        assert_eq!(covered(95, 96), subtitled, "{i}");
        assert!(!covered(20, 20) && !covered(100, 50), "{i}");
        // What is filled in resembles what is there more than letters do.
        let mut clean = image.clone();
        overlays.remove(i, &mut clean);
        let error = |image: &RgbImage| -> i32 {
            let truth = scene(0, [0.2 * i as f64 / FPS, 0.06 * i as f64 / FPS]);
            let row = 160..188;
            row.map(|x| i32::from(image[(x, 13)][0].abs_diff(truth[(x, 13)][0])))
                .sum()
        };
        errors = [errors[0] + error(&clean), errors[1] + error(image)];
        assert_eq!(clean[(20, 20)], image[(20, 20)]);
    }
    assert!(2 * errors[0] < errors[1], "{errors:?}");
    let [left, top, right, bottom] = overlays.extent().unwrap();
    assert!(left > 0.2 && top < 0.1 && right > 0.9 && bottom > 0.9);
}

#[test]
fn scenes_show_no_overlay() {
    let mut still = vec![scene(0, [0.0; 2]); 40];
    for image in &mut still {
        letters(image, (60, 60), 8);
    }
    // The camera rolls: about one place, hardly anything moves.
    let around = scene(3, [0.0; 2]);
    let turn = |i: usize| {
        let (sin, cos) = (0.02 * i as f64).sin_cos();
        let at = |v: f64, n: usize| (v.round().max(0.0) as usize).min(n - 1);
        Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            let (u, v) = (x as f64 - 150.0, y as f64 - 80.0);
            let (x, y) = (150.0 + cos * u - sin * v, 80.0 + sin * u + cos * v);
            around[(at(x, SIZE.0), at(y, SIZE.1))]
        })
    };
    for (name, images) in [
        ("a turn", noisy(pan(0, 60, 0.2))),
        ("a sign before a tripod", noisy(still)),
        ("a roll", noisy((0..40).map(turn).collect())),
    ] {
        assert_eq!(overlays(&images).frames(), 0, "{name}");
    }
}
