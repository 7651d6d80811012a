//! Points of static regions, from depth.

use crate::dataset::colmap::ColmapPoint;
use m4_core::Capture;

/// Points of static pixels with known depth, at most `most`, spread evenly over frames and pixels.
pub(in crate::dataset) fn static_points(capture: &Capture, most: usize) -> Vec<ColmapPoint> {
    let with_depth = capture.frames.iter().filter(|f| f.depth.is_some()).count();
    let mut points = Vec::new();
    if with_depth == 0 || most == 0 {
        return points;
    }
    let of_frame = (most / with_depth).max(1);
    for frame in &capture.frames {
        let Some(depth) = &frame.depth else { continue };
        let (w, h) = depth.size();
        let (pw, ph) = frame.rgb.size();
        let step = ((w * h) as f64 / of_frame as f64).sqrt().ceil().max(1.0) as usize;
        // where the depth map has another size than the image
        let scale = [pw as f64 / w.max(1) as f64, ph as f64 / h.max(1) as f64];
        for y in (step / 2..h).step_by(step) {
            for x in (step / 2..w).step_by(step) {
                let z = f64::from(depth.at(x, y));
                if !(z > 0.0 && z.is_finite()) {
                    continue;
                }
                let (u, v) = ((x as f64 + 0.5) * scale[0], (y as f64 + 0.5) * scale[1]);
                if frame.mask.as_ref().is_some_and(|mask| {
                    let (mw, mh) = mask.size();
                    mask.at(
                        ((u * mw as f64 / pw as f64) as usize).min(mw.saturating_sub(1)),
                        ((v * mh as f64 / ph as f64) as usize).min(mh.saturating_sub(1)),
                    )
                }) {
                    continue;
                }
                // from the centre of the first pixel
                let position = frame.camera.unproject(u - 0.5, v - 0.5, z);
                points.push(ColmapPoint {
                    position: position.into(),
                    colour: frame.rgb[((u as usize).min(pw - 1), (v as usize).min(ph - 1))],
                });
            }
        }
    }
    points.truncate(most);
    points
}
