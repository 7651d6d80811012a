//! The effect of tracking as an image: the region of a held-out view that it changes most.

use m4_core::{Plane, RgbImage};
use m4_kernels::SimdLevel;
use minute4d::observer::check_stop;
use minute4d::render::SceneRenderer;
use minute4d_cli::run::Job;
use minute4d_eval::Error;
use minute4d_eval::HeldOut;
use std::path::{Path, PathBuf};

/// Side of the place that is shown, in parts of the shorter side of a view.
const PART: usize = 3;
/// Pixels that each pixel is shown as.
const ENLARGED: usize = 2;
/// Pixels between two panels.
const GAP: usize = 4;

/// A place of a view: the true image, without and with.
struct Place {
    gain: f64,
    panels: [RgbImage; 3],
}

/// Writes the ground truth of that region and the renders of the scenes in `folders` (without,
/// with) side by side to `path`;
pub fn write(
    folders: &[PathBuf; 2],
    data: &Path,
    path: &Path,
    job: &Job<'_>,
) -> Result<Option<PathBuf>, Error> {
    let level = SimdLevel::detect()?;
    let gpu = job.device.choice.open(|why| job.observer.warn(why))?;
    let read = |run: &Path| HeldOut::read(run, data, job.settings.capture.reach, job.observer);
    let (without, with) = (read(&folders[0])?, read(&folders[1])?);
    let mut draw_without = SceneRenderer::new(&without.scene, level, gpu.as_ref(), job.observer)?;
    let mut draw_with = SceneRenderer::new(&with.scene, level, gpu.as_ref(), job.observer)?;
    let mut best: Option<Place> = None;
    for frame in &with.test.frames {
        check_stop(job.observer, "ablate", true)?;
        let drawn = [
            &without.draw(&mut draw_without, frame)?,
            &with.draw(&mut draw_with, frame)?,
        ];
        let here = most_gained(&frame.rgb, drawn);
        if here.gain > best.as_ref().map_or(0.0, |place| place.gain) {
            best = Some(here);
        }
    }
    let Some(place) = best else { return Ok(None) };
    m4_io::image::write_rgb(path, &side_by_side(&place.panels))?;
    Ok(Some(path.to_owned()))
}

/// Where the second image is closer to the truth than the first by most.
fn most_gained(truth: &RgbImage, [without, with]: [&RgbImage; 2]) -> Place {
    let (width, height) = truth.size();
    let side = (width.min(height) / PART).max(1);
    let error = |a: [u8; 3], b: [u8; 3]| {
        let square = |k: usize| (f64::from(a[k]) - f64::from(b[k])).powi(2);
        square(0) + square(1) + square(2)
    };
    let gained = |left: usize, top: usize| {
        let pixels = (top..top + side).flat_map(|y| (left..left + side).map(move |x| (x, y)));
        pixels
            .map(|at| error(without[at], truth[at]) - error(with[at], truth[at]))
            .sum::<f64>()
    };
    let steps = |length: usize| (0..=(length - side)).step_by((side / 4).max(1));
    let places = steps(height).flat_map(|top| steps(width).map(move |left| (left, top)));
    let best = places
        .map(|(left, top)| (gained(left, top), left, top))
        .reduce(|best, next| if next.0 > best.0 { next } else { best });
    let (gain, left, top) = best.unwrap_or((0.0, 0, 0));
    let cut = |image: &RgbImage| Plane::from_fn(side, side, |x, y| image[(left + x, top + y)]);
    Place {
        gain,
        panels: [cut(truth), cut(without), cut(with)],
    }
}

fn side_by_side(panels: &[RgbImage; 3]) -> RgbImage {
    let (width, height) = (panels[0].width() * ENLARGED, panels[0].height() * ENLARGED);
    Plane::from_fn(3 * width + 2 * GAP, height, |x, y| {
        let (panel, x) = (x / (width + GAP), x % (width + GAP));
        if x < width {
            panels[panel][(x / ENLARGED, y / ENLARGED)]
        } else {
            [255; 3]
        }
    })
}

#[cfg(test)]
mod tests {
    use super::{most_gained, side_by_side};
    use m4_core::Plane;

    #[test]
    fn the_place_is_where_the_second_is_better() {
        let truth = Plane::filled(60, 48, [100, 100, 100]);
        let better = truth.clone();
        let hole = |x: usize, y: usize| (40..50).contains(&x) && (5..15).contains(&y);
        let worse = Plane::from_fn(
            60,
            48,
            |x, y| if hole(x, y) { [0; 3] } else { truth[(x, y)] },
        );
        let place = most_gained(&truth, [&worse, &better]);
        assert_eq!(place.gain, 100.0 * 3.0 * 100.0 * 100.0);
        assert_eq!(
            place.panels[1]
                .data()
                .iter()
                .filter(|&&p| p == [0; 3])
                .count(),
            100
        );
        assert!(most_gained(&truth, [&better, &worse]).gain <= 0.0);
        let all = side_by_side(&place.panels);
        assert_eq!(all.size(), (3 * 32 + 8, 32));
    }
}
