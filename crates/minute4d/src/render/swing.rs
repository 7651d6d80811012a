//! Cameras that swing around the centre of their view, and bullet time: plays, freezes time while
//! the camera moves around, and plays on.

use super::{PathOptions, Region, SourcePath};
use crate::Refusal;
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{Camera, Se3, SourceFrame, exp_so3};
use std::f64::consts::TAU;

/// Greatest turn of a swing to either side, degrees. 6: beyond, dynamic regions, which were seen
/// from one side alone at each moment, begin to come apart (ours, judged by eye on the pinwheel of
/// the examples).
const SIDE_DEG: f64 = 6.0;
/// Greatest turn up or down, degrees.
const UP_DEG: f64 = 2.0;
/// Frames of one swing there and back: two seconds at 30 frames per second.
pub const SWING_FRAMES: usize = 60;
/// Smallest and greatest turn of a bullet to either side, degrees: the reach of the source camera
/// is used within these limits.
const BULLET_SIDE_DEG: [f64; 2] = [4.0, 6.0];
/// Turn of a bullet up and down, as a share of the turn to the side.
const BULLET_UP_SHARE: f64 = 0.3;
/// Seconds for which a bullet path freezes time.
const HOLD_S: f64 = 4.0;
/// Seconds in which time slows down before, and speeds up after.
const EASE_S: f64 = 0.4;

/// `n` cameras that look at the point `distance` in front of `camera` (world units), swinging to
/// both sides on a flat figure of eight, there and back in `period_frames`; the first is `camera`
/// itself.
pub fn swing(camera: &Camera, distance: f64, n: usize, period_frames: usize) -> Vec<Camera> {
    let pivot = camera.c2w.transform(&Vector3::new(0.0, 0.0, distance));
    let period = period_frames.max(2) as f64;
    (0..n)
        .map(|i| {
            let (side, up) = figure_of_eight(TAU * i as f64 / period);
            orbit(camera, &pivot, side, up)
        })
        .collect()
}

/// Turns to the side and up, radians, at a phase of the swing, radians.
fn figure_of_eight(phase: f64) -> (f64, f64) {
    (
        SIDE_DEG.to_radians() * phase.sin(),
        UP_DEG.to_radians() * (2.0 * phase).sin(),
    )
}

/// The camera turned about `pivot`: `side` radians about its own vertical, `up` about its
/// horizontal.
fn orbit(camera: &Camera, pivot: &Vector3<f64>, side: f64, up: f64) -> Camera {
    let axes = &camera.c2w.rotation;
    let (right, down) = (axes.column(0).into_owned(), axes.column(1).into_owned());
    let turn: Matrix3<f64> = exp_so3(&(down * side)) * exp_so3(&(right * up));
    let about_pivot = Se3 {
        rotation: turn,
        translation: pivot - turn * pivot,
    };
    Camera {
        intrinsics: camera.intrinsics,
        c2w: about_pivot.compose(&camera.c2w),
    }
}

/// When a bullet path does what; seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bullet {
    /// The moment that is static, from the first frame of the source.
    freeze_s: f64,
    /// Seconds of the source that are played before it and after it.
    played_s: [f64; 2],
    /// In which time slows down, and speeds up again.
    ease_s: [f64; 2],
    /// For which time is frozen.
    hold_s: f64,
}

impl Bullet {
    /// A bullet that is static at `freeze_s` of a source of `source_s`; with a length asked for,
    /// less of the source is played, or time is frozen for longer.
    ///
    /// # Errors
    ///
    /// A refusal of a path that is over before time is frozen.
    pub fn new(freeze_s: f64, source_s: f64, seconds: Option<f64>) -> Result<Self, Refusal> {
        let all = [freeze_s, (source_s - freeze_s).max(0.0)];
        // Slowing down over e seconds covers e / 2 seconds of the source.
        let ease_s = all.map(|s| EASE_S.min(2.0 * s).max(0.0));
        let mut bullet = Self {
            freeze_s,
            played_s: all,
            ease_s,
            hold_s: HOLD_S,
        };
        if let Some(seconds) = seconds {
            let short = seconds - bullet.seconds();
            let played_s = source_s + short;
            if short > 0.0 {
                bullet.hold_s += short;
            } else if short < 0.0 {
                let least: f64 = ease_s.iter().sum::<f64>() * 0.5;
                if played_s < least {
                    let hold_s = bullet.hold_s + 2.0 * least;
                    return Err(Refusal::usage(format!(
                        "a path of {seconds} seconds leaves no time besides the {hold_s} s for which time is frozen; choose more"
                    )));
                }
                // Both sides give in proportion, but keep what the slowing down needs.
                let spare = all
                    .iter()
                    .zip(ease_s)
                    .map(|(a, e)| a - 0.5 * e)
                    .sum::<f64>();
                let share = if spare > 0.0 {
                    (played_s - least) / spare
                } else {
                    0.0
                };
                bullet.played_s =
                    std::array::from_fn(|i| 0.5 * ease_s[i] + share * (all[i] - 0.5 * ease_s[i]));
            }
        }
        Ok(bullet)
    }

    /// Length of the path.
    pub fn seconds(&self) -> f64 {
        self.lead_s() + self.hold_s + self.played_s[1] + 0.5 * self.ease_s[1]
    }

    /// When time begins to be frozen.
    fn lead_s(&self) -> f64 {
        self.played_s[0] + 0.5 * self.ease_s[0]
    }

    /// The moment of the source at a time of the path, and how far the camera is on its way round,
    /// 0..1.
    pub fn at(&self, path_s: f64) -> (f64, f64) {
        let left = self.lead_s() - path_s;
        if left > 0.0 {
            return (self.freeze_s - eased(left, self.ease_s[0]), 0.0);
        }
        let held = -left;
        if held <= self.hold_s {
            return (self.freeze_s, held / self.hold_s);
        }
        (
            self.freeze_s + eased(held - self.hold_s, self.ease_s[1]),
            1.0,
        )
    }

    /// The camera at a time of the path; `region` is where time is frozen.
    pub fn stop(
        &self,
        path_s: f64,
        source: &SourcePath,
        region: &Region,
        options: &PathOptions,
    ) -> SourceFrame {
        let (source_s, round) = self.at(path_s);
        if round <= 0.0 || round >= 1.0 {
            return source.at(source.moment(source_s));
        }
        // At rest at both ends.
        let phase = TAU * round * round * (3.0 - 2.0 * round);
        let side = side_rad(region, options);
        let (side, up) = (
            side * phase.sin(),
            side.abs() * BULLET_UP_SHARE * (2.0 * phase).sin(),
        );
        SourceFrame {
            camera: orbit(&region.stop.camera, &region.pivot(), side, up),
            ..region.stop
        }
    }
}

/// Seconds of the source in `s` seconds after standing still, with speed growing evenly for
/// `ease_s`.
fn eased(s: f64, ease_s: f64) -> f64 {
    if s < ease_s {
        s * s / (2.0 * ease_s)
    } else {
        s - 0.5 * ease_s
    }
}

/// Greatest turn to either side that is good for the scene, radians, or what was asked for.
fn side_rad(region: &Region, options: &PathOptions) -> f64 {
    let [least, most] = BULLET_SIDE_DEG.map(f64::to_radians);
    options.degrees.map_or_else(
        || (region.reach / region.distance).atan().clamp(least, most),
        f64::to_radians,
    )
}

/// The swing at a share of its length: a figure of eight, twice.
pub fn swing_camera(region: &Region, share: f64, options: &PathOptions) -> Camera {
    let scale = options.degrees.map_or(1.0, |d| d / SIDE_DEG);
    let (side, up) = figure_of_eight(2.0 * TAU * share);
    orbit(
        &region.stop.camera,
        &region.pivot(),
        side * scale,
        up * scale,
    )
}

/// The pose at `centre` with `target` on its axis and `down` downwards, as far as it can be.
pub fn looking(centre: Vector3<f64>, target: &Vector3<f64>, down: &Vector3<f64>) -> Se3<f64> {
    let ahead = (target - centre).normalize();
    let across = down.cross(&ahead);
    // Straight up or down there is no side; any will do.
    let across = if across.norm() > 1e-9 * down.norm() {
        across.normalize()
    } else {
        let least = ahead.iamin();
        Vector3::ith(least, 1.0).cross(&ahead).normalize()
    };
    Se3 {
        rotation: Matrix3::from_columns(&[across, ahead.cross(&across), ahead]),
        translation: centre,
    }
}

#[cfg(test)]
mod tests {
    use super::{SWING_FRAMES, swing};
    use m4_core::nalgebra::{Vector3, Vector6};
    use m4_core::{Camera, Intrinsics, Se3};

    #[test]
    fn every_camera_looks_at_the_pivot_from_the_same_distance() {
        let camera = Camera {
            intrinsics: Intrinsics::centred(64, 48, 50.0),
            c2w: Se3::identity().retract(&Vector6::new(1.0, -2.0, 0.5, 0.3, -0.4, 0.2)),
        };
        let pivot = camera.c2w.transform(&Vector3::new(0.0, 0.0, 3.0));
        let cameras = swing(&camera, 3.0, 60, SWING_FRAMES);
        assert!((cameras[0].c2w.matrix() - camera.c2w.matrix()).norm() < 1e-12);
        for c in &cameras {
            let ([u, v], z) = c.project(&pivot);
            assert!((u - 31.5).abs() < 1e-9 && (v - 23.5).abs() < 1e-9 && (z - 3.0).abs() < 1e-9);
        }
        let angle = |c: &Camera| {
            (c.c2w.rotation.column(2).dot(&camera.c2w.rotation.column(2)))
                .acos()
                .to_degrees()
        };
        let widest = cameras.iter().map(angle).fold(0.0, f64::max);
        assert!((5.9..6.5).contains(&widest), "{widest}");
    }
}
