//! Bullet time.

use super::{NONE, difference, scene, stops};
use crate::render::path::bullet::Bullet;
use crate::render::path::{CameraPath, PathConfig, PathOptions};
use crate::render::{Moment, Stop};

#[test]
fn bullet_path_freezes_time_while_the_camera_orbits() {
    let scene = scene(0.0);
    let at = PathOptions { at: Some(Moment::Seconds(1.2)), hold_s: Some(2.0), ..NONE };
    let all = stops(&scene, CameraPath::Bullet, at, 30.0);
    // 3 s of the source, 2 s still, and half of twice 0.4 s for slowing down.
    assert_eq!(all.len(), 1 + (5.4f64 * 30.0).round() as usize);
    let frozen: Vec<&Stop> = all.iter().filter(|s| s.t == all[60].t).collect();
    assert!((all[60].t - 12.0).abs() < 1e-9);
    assert!((59..=61).contains(&frozen.len()), "{}", frozen.len());
    for pair in frozen.windows(2).skip(6).take(46) {
        assert!(difference(pair[0], pair[1]) > 1e-5, "it moves");
    }
    assert!(difference(frozen[0], frozen[frozen.len() - 1]) < 3e-3, "and comes back");
    let furthest = frozen.iter().map(|s| difference(s, frozen[0])).fold(0.0, f64::max);
    assert!(furthest > 0.05, "{furthest}");
    // Time never goes back, and never faster than the source.
    for pair in all.windows(2) {
        let step = pair[1].t - pair[0].t;
        assert!((-1e-9..=10.0 / 30.0 + 1e-9).contains(&step), "{step}");
    }
    assert!(all[0].t.abs() < 1e-9 && (all[all.len() - 1].t - 30.0).abs() < 1e-9);
    // No jump anywhere.
    let largest = all.windows(2).map(|p| difference(&p[0], &p[1])).fold(0.0, f64::max);
    assert!(largest < 0.05, "{largest}");
}

#[test]
fn bullet_path_has_the_requested_length() {
    let config = PathConfig::default();
    let of = |seconds: f64, hold_s: Option<f64>| {
        let options = PathOptions { seconds: Some(seconds), hold_s, ..NONE };
        Bullet::new(1.2, 3.0, &options, &config)
    };
    for seconds in [5.0, 7.4, 20.0] {
        assert!((of(seconds, None).unwrap().seconds() - seconds).abs() < 1e-9, "{seconds}");
    }
    assert!((of(4.0, Some(1.0)).unwrap().seconds() - 4.0).abs() < 1e-9);
    assert!(of(4.2, None).unwrap_err().to_string().contains("--seconds 4.2 leaves no time"));
    let cut = of(6.0, None).unwrap();
    let (first, last) = (cut.at(0.0).0, cut.at(6.0).0);
    assert!(first > 0.1 && last < 2.9 && first < 1.2 && last > 1.2, "{first} {last}");
}
