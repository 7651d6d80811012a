//! Closed paths and arcs about what one camera sees.

use super::{PathConfig, PathOptions};
use crate::render::Region;
use crate::render::swing::{figure_of_eight, orbit};
use m4_math::Se3;
use m4_math::nalgebra::{Matrix3, Vector3};
use m4_scene::Camera;
use std::f64::consts::{PI, TAU};

/// Greatest turn to either side that is good for the scene, radians, or what was asked for.
pub fn side_rad(region: &Region, options: &PathOptions, config: &PathConfig) -> f64 {
    let [least, most] = config.side_deg.map(f64::to_radians);
    let good = (region.reach[0] / region.distance).atan().clamp(least, most.max(least));
    options.degrees.map_or(good, f64::to_radians) * options.amount.unwrap_or(1.0)
}

/// The swing at a share of its length: a figure of eight, twice.
pub fn swing(region: &Region, share: f64, options: &PathOptions, config: &PathConfig) -> Camera {
    let own = &config.swing;
    let scale = options.amount.unwrap_or(1.0) * options.degrees.map_or(1.0, |d| d / own.side_deg);
    let (side, up) = figure_of_eight(2.0 * TAU * share, own);
    orbit(&region.stop.camera, &region.pivot(), side * scale, up * scale)
}

/// From one side to the other on a circle, slowing down at both ends.
pub fn arc(region: &Region, share: f64, options: &PathOptions, config: &PathConfig) -> Camera {
    let side = -side_rad(region, options, config) * (PI * share).cos();
    orbit(&region.stop.camera, &region.pivot(), side, 0.0)
}

/// Round an ellipse while going ahead and back once, always looking at the middle. Never behind the start: from
/// there the edge of what was filmed comes into the picture.
pub fn spiral(region: &Region, share: f64, options: &PathOptions, config: &PathConfig) -> Camera {
    let across = region.share(0, config.spiral_across);
    let scale = options.amount.unwrap_or(1.0) * options.radius.map_or(1.0, |r| r / across);
    let clear = config.clear * region.near / region.distance;
    let ahead = (region.share(2, config.spiral_ahead) * scale).min(clear);
    let round = TAU * f64::from(options.turns.unwrap_or(config.turns)) * share;
    let offset = Vector3::new(
        across * scale * round.cos(),
        region.share(1, config.spiral_up) * scale * round.sin(),
        ahead * 0.5 * (1.0 - (TAU * share).cos()),
    );
    let camera = &region.stop.camera;
    let centre = camera.c2w.transform(&(offset * region.distance));
    Camera {
        intrinsics: camera.intrinsics,
        c2w: looking(centre, &region.pivot(), &camera.c2w.rotation.column(1).into_owned()),
    }
}

/// In along the view and back; with the dolly zoom the lens makes up for it.
pub fn dolly(region: &Region, share: f64, options: &PathOptions, config: &PathConfig) -> Camera {
    // A lens that widens would show what was never filmed, so the dolly zoom goes back first.
    let sign = if options.dolly_zoom { -1.0 } else { 1.0 };
    let good = region.share(2, config.dolly) * region.distance;
    let most = (config.clear * region.near).min(0.9 * region.distance);
    let furthest = (sign * good * options.amount.unwrap_or(1.0)).min(most);
    let way = furthest * 0.5 * (1.0 - (TAU * share).cos());
    let mut camera = region.stop.camera;
    camera.c2w.translation = camera.c2w.transform(&Vector3::new(0.0, 0.0, way));
    if options.dolly_zoom {
        camera.intrinsics = crate::render::zoomed(&camera.intrinsics, (region.distance - way) / region.distance);
    }
    camera
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
