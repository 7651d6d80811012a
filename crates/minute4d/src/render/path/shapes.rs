//! Camera motions around the view of one camera.

use super::{PathConfig, PathOptions};
use crate::render::Region;
use crate::render::swing::{figure_of_eight, orbit};
use m4_core::{
    Camera, Se3,
    nalgebra::{Matrix3, Vector3},
};
use std::f64::consts::TAU;

/// Greatest turn to either side that is good for the scene, radians, or what was asked for.
pub fn side_rad(region: &Region, options: &PathOptions, config: &PathConfig) -> f64 {
    let [least, most] = config.side_deg.map(f64::to_radians);
    let good = (region.reach / region.distance).atan().clamp(least, most.max(least));
    options.degrees.map_or(good, f64::to_radians) * options.amount.unwrap_or(1.0)
}

/// The swing at a share of its length: a figure of eight, twice.
pub fn swing(region: &Region, share: f64, options: &PathOptions, config: &PathConfig) -> Camera {
    let own = &config.swing;
    let scale = options.amount.unwrap_or(1.0) * options.degrees.map_or(1.0, |d| d / own.side_deg);
    let (side, up) = figure_of_eight(2.0 * TAU * share, own);
    orbit(&region.stop.camera, &region.pivot(), side * scale, up * scale)
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
