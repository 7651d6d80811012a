//! Scores by the distance of held-out views from the training camera. What a small change of view
//! costs (what a viewer shows) and what a large one costs are different questions, and their mean
//! answers neither.
//!
//! ```text
//! transforms_test.json     far: other cameras          whole, and split at 8 and 20 degrees
//! transforms_near.json     near: some degrees around the training camera of the moment
//! transforms_between.json  between: the training camera between two training frames
//! ```

use crate::error::Error;
use m4_core::{Camera, Capture, CaptureFrame};
use m4_eval::image::{ImageReport, MeanScore};
use m4_io::capture::{CaptureOptions, Split};
use minute4d::Observer;
use serde::Serialize;
use std::path::Path;

/// Where the far views are split, degrees.
const FAR_SPLIT_DEG: [f64; 2] = [8.0, 20.0];
/// Every this many columns and rows of a depth map are used to find where the dynamic content is.
const STRIDE_PX: usize = 4;

/// Means over one set of held-out views.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetScore {
    /// Its name: `far`, `far to 8 degrees`, `near`, ...
    pub set: String,
    /// Smallest and largest angle between its views and the training camera of the moment, degrees,
    /// as seen from the dynamic content; `None` where the capture has no masks and depth to tell.
    pub degrees: Option<[f64; 2]>,
    /// Whole, dynamic and static.
    pub mean: MeanScore,
    /// Mean LPIPS (AlexNet, whole images), where its weights are installed.
    pub lpips_alex: Option<f64>,
}

/// Another list of held-out views beside the test list, where the capture has it.
pub fn read(
    data: &Path,
    split: Split,
    options: &CaptureOptions,
    observer: &dyn Observer,
) -> Result<Option<Capture>, Error> {
    if !data.is_dir() || !data.join(split.file_name()).is_file() {
        return Ok(None);
    }
    Ok(Some(m4_io::capture::read(data, split, options, observer)?))
}

/// Rows for the views of one list, scored in `report`: all of them, and the far ones split by
/// angle.
pub(super) fn rows(set: &str, report: &ImageReport, angles: &[Option<f64>]) -> Vec<SetScore> {
    let row = |set: String, counts: &dyn Fn(usize) -> bool| {
        let mean = report.mean_where(counts)?;
        let chosen = (0..).zip(&report.frames).filter(|(i, _)| counts(*i));
        let lpips: Vec<f64> = chosen
            .filter_map(|(_, f)| f.others.get("lpips_alex").copied())
            .collect();
        let set_angles: Option<Vec<f64>> = (0..angles.len())
            .filter(|&i| counts(i))
            .map(|i| angles[i])
            .collect();
        let degrees = set_angles
            .filter(|values| !values.is_empty())
            .map(|values| {
                let least = values.iter().copied().fold(f64::INFINITY, f64::min);
                [least, values.iter().copied().fold(0.0, f64::max)]
            });
        let lpips_alex =
            (!lpips.is_empty()).then(|| lpips.iter().sum::<f64>() / lpips.len() as f64);
        Some(SetScore {
            set,
            degrees,
            mean,
            lpips_alex,
        })
    };
    let mut rows = Vec::from_iter(row(set.to_owned(), &|_| true));
    if set == "far" && angles.iter().all(Option::is_some) {
        let [low, high] = FAR_SPLIT_DEG;
        let within = |i: usize, from: f64, to: f64| angles[i].is_some_and(|a| a > from && a <= to);
        rows.extend(row(format!("far to {low} degrees"), &|i| {
            within(i, -1.0, low)
        }));
        rows.extend(row(format!("far to {high} degrees"), &|i| {
            within(i, low, high)
        }));
        rows.extend(row(format!("far over {high} degrees"), &|i| {
            within(i, high, f64::INFINITY)
        }));
    }
    rows
}

/// The rows as a table for people.
pub(super) fn table(rows: &[SetScore]) -> String {
    let cell =
        |v: Option<f64>, digits: usize| v.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    let mut out = format!(
        "{:<22} {:>5} {:>9} {:>14} {:>16} {:>15} {:>7}\n",
        "set", "views", "degrees", "PSNR dB, SSIM", "dynamic", "static", "LPIPS"
    );
    for row in rows {
        let m = &row.mean;
        let degrees = row
            .degrees
            .map_or("-".to_owned(), |[a, b]| format!("{a:.1}-{b:.1}"));
        let pair =
            |psnr: Option<f64>, ssim: Option<f64>| format!("{} {}", cell(psnr, 2), cell(ssim, 4));
        out += &format!(
            "{:<22} {:>5} {degrees:>9} {:>14} {:>16} {:>15} {:>7}\n",
            row.set,
            m.frames,
            pair(Some(m.psnr_db), Some(m.ssim)),
            pair(m.masked_psnr_db, m.masked_ssim),
            pair(m.static_psnr_db, m.static_ssim),
            cell(row.lpips_alex, 4)
        );
    }
    out
}

/// Angle of each view to the training camera of its moment, degrees, as seen from the dynamic
/// content that this camera saw.
pub(super) fn angles(train: &Capture, views: &Capture) -> Vec<Option<f64>> {
    let centres: Vec<_> = train
        .frames
        .iter()
        .filter(|f| f.camera_index.is_none())
        .map(|f| (f, dynamic_centre(f)))
        .collect();
    let share = |t: f64, of: &Capture| t / (of.time_frames.max(2) - 1) as f64;
    let angle = |view: &CaptureFrame| {
        let at = share(view.t, views);
        let distance = |f: &CaptureFrame| (share(f.t, train) - at).abs();
        let points = centres
            .iter()
            .filter_map(|(frame, centre)| Some((*frame, (*centre)?)));
        let (frame, centre) = points.min_by(|a, b| distance(a.0).total_cmp(&distance(b.0)))?;
        let ray = |camera: &Camera| camera.centre() - centre;
        Some(ray(&frame.camera).angle(&ray(&view.camera)).to_degrees())
    };
    views.frames.iter().map(angle).collect()
}

/// The median of the coordinates of the points inside the mask.
fn dynamic_centre(frame: &CaptureFrame) -> Option<m4_core::nalgebra::Vector3<f64>> {
    let (mask, depth) = (frame.mask.as_ref()?, frame.depth.as_ref()?);
    let size = depth.size();
    let camera = frame.camera.resized(size.0, size.1);
    let mut axes: [Vec<f64>; 3] = Default::default();
    for y in (0..size.1).step_by(STRIDE_PX) {
        for x in (0..size.0).step_by(STRIDE_PX) {
            let inside = mask.at(x * mask.size().0 / size.0, y * mask.size().1 / size.1);
            let z = depth.at(x, y);
            if inside && z.is_finite() && z > 0.0 {
                let point = camera.unproject(x as f64 + 0.5, y as f64 + 0.5, f64::from(z));
                axes.iter_mut()
                    .zip(point.iter())
                    .for_each(|(axis, v)| axis.push(*v));
            }
        }
    }
    let [x, y, z] = axes.map(|mut axis| {
        axis.sort_by(f64::total_cmp);
        axis.get(axis.len() / 2).copied()
    });
    Some([x?, y?, z?].into())
}

#[cfg(test)]
mod tests {
    use super::{angles, rows};
    use m4_core::{Camera, Capture, CaptureFrame, CompactMask, Intrinsics, Plane, Se3};
    use m4_eval::image::{ImageReport, PlanarImage};

    /// A view of a wall at a distance of 2, dynamic in the middle, from `x` to the side.
    fn view(x: f64, t: f64) -> CaptureFrame {
        let mut c2w = Se3::identity();
        c2w.translation.x = x;
        CaptureFrame {
            name: format!("{x}"),
            camera: Camera {
                intrinsics: Intrinsics::centred(64, 48, 60.0),
                c2w,
            },
            t,
            rgb: Plane::filled(64, 48, [0; 3]),
            depth: Some(Plane::filled(64, 48, 2.0f32).into()),
            mask: Some(CompactMask::from_fn(64, 48, |x, y| {
                x.abs_diff(32) < 8 && y.abs_diff(24) < 8
            })),
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        }
    }

    fn capture(frames: Vec<CaptureFrame>) -> Capture {
        Capture {
            frames,
            time_frames: 3,
            duration_s: None,
            metric: true,
            tracks: None,
        }
    }

    #[test]
    fn angles_are_those_at_the_dynamic_content_of_the_moment() {
        let train = capture((0..3).map(|i| view(0.0, f64::from(i))).collect());
        // tan 45 degrees = 2 / 2
        let actual = angles(&train, &capture(vec![view(2.0, 1.0), view(0.0, 2.0)]));
        assert!(
            (actual[0].unwrap() - 45.0).abs() < 1.5 && actual[1].unwrap() < 1e-4,
            "{actual:?}"
        );
        let blind = capture(vec![CaptureFrame {
            mask: None,
            ..view(0.0, 0.0)
        }]);
        assert_eq!(angles(&blind, &train), [None; 3]);
    }

    #[test]
    fn far_views_are_split_by_angle() {
        let mut report = ImageReport::new("unit", 0);
        let flat = |value: f32| {
            let plane = vec![value; 256];
            PlanarImage::from_planes(16, 16, [&plane, &plane, &plane]).unwrap()
        };
        for (name, value) in [("a", 0.6), ("b", 0.51), ("c", 0.501)] {
            report
                .add(name, 0.0, None, &flat(value), &flat(0.5), None)
                .unwrap();
        }
        let of = |set, angles: &[Option<f64>]| {
            let rows = rows(set, &report, angles);
            rows.into_iter()
                .map(|r| (r.set, r.mean.psnr_db.round(), r.degrees))
                .collect::<Vec<_>>()
        };
        let view_angles = [Some(3.0), Some(8.5), Some(20.0)];
        let expected = [
            ("far", 40.0, 3.0, 20.0),
            ("far to 8 degrees", 20.0, 3.0, 3.0),
            ("far to 20 degrees", 50.0, 8.5, 20.0),
        ];
        assert_eq!(
            of("far", &view_angles),
            expected.map(|(set, psnr, a, b)| (set.to_owned(), psnr, Some([a, b])))
        );
        assert_eq!(of("near", &view_angles).len(), 1);
        assert_eq!(
            of("far", &[Some(3.0), None, None]),
            [("far".to_owned(), 40.0, None)]
        );
    }
}
