//! Frames of a lens that bends straight lines, shown as by a pinhole.

use super::clip::Clip;
use crate::{Error, Refusal};
use m4_core::Intrinsics;
use m4_geometry::classical::sparse::RadialDistortion;
use m4_io::dataset::{Distortion, Lens, Undistort};
use rayon::prelude::*;

impl Clip {
    /// Shows the frames, and what the user gave for them, as a pinhole does; nothing changes where
    /// `lens` is one. Fails if no pinhole can show them.
    pub fn straighten(&mut self, lens: &Lens) -> Result<(), Error> {
        let map = Undistort::new(lens).map_err(|fault| {
            Refusal::bad_input(format!("the frames cannot be straightened: {fault}"))
        })?;
        let Some(map) = map else { return Ok(()) };
        self.video
            .frames
            .par_iter_mut()
            .for_each(|frame| frame.rgb = map.rgb(&frame.rgb));
        let given = &mut self.given;
        for mask in given.masks.iter_mut().flatten() {
            *mask = map.nearest(mask);
        }
        for depth in given.depth.iter_mut().flat_map(|depth| &mut depth.metric_m) {
            depth.par_iter_mut().for_each(|z| *z = map.nearest(z));
        }
        for camera in given.cameras.iter_mut().flatten() {
            camera.intrinsics = map.to;
        }
        if let Some(lens) = &mut given.lens {
            *lens = Lens::pinhole(map.to);
        }
        if let Some(intrinsics) = &mut self.sparse.intrinsics {
            *intrinsics = [map.to.fx, map.to.fy, map.to.cx, map.to.cy];
        }
        let stretch = map.to.fx / lens.intrinsics.fx;
        self.focal_px = self.focal_px.map(|focal_px| focal_px * stretch);
        (self.sparse.focal_px, self.sparse.fov_deg) = (self.focal_px, None);
        Ok(())
    }

    /// The lens of the frames by what was estimated of it.
    pub fn lens(&self, distortion: &RadialDistortion) -> Lens {
        let size = self.video.frames.first().map_or((1, 1), |f| f.rgb.size());
        let corner = 0.5 * (size.0 as f64).hypot(size.1 as f64) / distortion.focal_px;
        Lens {
            intrinsics: Intrinsics::centred(size.0, size.1, distortion.focal_px),
            distortion: Distortion::Division {
                k: distortion.coefficient / (corner * corner),
            },
        }
    }
}

/// Says what the lens does, and what was done about it.
pub(super) fn note(distortion: &RadialDistortion) -> String {
    let percent = 100.0 * distortion.coefficient.abs();
    let kind = if distortion.coefficient < 0.0 {
        "a wide-angle lens, as of action cameras"
    } else {
        "pincushion distortion"
    };
    format!(
        "the lens bends straight lines ({kind}, {percent:.0} % at the corners): the frames are straightened"
    )
}

#[cfg(test)]
mod tests {
    use super::super::clip::Between;
    use super::super::given::Given;
    use super::Clip;
    use m4_core::{Plane, Video, VideoFrame};
    use m4_geometry::classical::sparse::{RadialDistortion, SparseConfig};

    #[test]
    fn frames_masks_and_focal_length_follow_the_lens() {
        let (w, h, focal_px) = (80, 60, 40.0);
        let distortion = RadialDistortion {
            coefficient: -0.3,
            focal_px,
        };
        // A vertical line of the world, 25 pixels right of the centre in a pinhole image: through
        // the lens `u = d / (1 - 0.3 (d / 50)^2)`.
        let bent = |y: f64| {
            let at = |x: f64| x / (1.0 - 0.3 * (x * x + y * y) / 2500.0) - 25.0;
            let (mut low, mut high) = (0.0, 40.0);
            for _ in 0..50 {
                let middle = 0.5 * (low + high);
                if at(middle) < 0.0 {
                    low = middle
                } else {
                    high = middle
                }
            }
            low
        };
        let mask = Plane::from_fn(w, h, |x, y| {
            let line = bent(y as f64 + 0.5 - 30.0);
            if x as f64 + 0.5 - 40.0 > line {
                255_u8
            } else {
                0
            }
        });
        let frame = VideoFrame {
            rgb: mask.map(|m| [*m; 3]),
            time_s: 0.0,
        };
        let mut clip = Clip {
            video: Video {
                frames: vec![frame],
                in_range: 1,
                warnings: Vec::new(),
                focal_px: None,
            },
            given: Given {
                masks: Some(vec![mask]),
                ..Given::default()
            },
            sparse: SparseConfig {
                focal_px: Some(focal_px),
                ..SparseConfig::default()
            },
            focal_px: Some(focal_px),
            footage: None,
            between: Between::default(),
        };
        let lens = clip.lens(&distortion);
        clip.straighten(&lens).unwrap();
        let focal = clip.sparse.focal_px.unwrap();
        assert!(focal < focal_px && clip.focal_px == Some(focal), "{focal}");
        let line = 40.0 + 25.0 * focal / focal_px;
        let (mask, rgb) = (&clip.given.masks.unwrap()[0], &clip.video.frames[0].rgb);
        for y in 0..h {
            let edge = (0..w).find(|&x| mask[(x, y)] > 0).unwrap() as f64;
            assert!((edge - line).abs() <= 1.5, "row {y}: {edge}, not {line}");
            let edge = (0..w).find(|&x| rgb[(x, y)][0] > 127).unwrap() as f64;
            assert!((edge - line).abs() <= 1.5, "row {y}: {edge}, not {line}");
        }
    }
}
