//! Scores of each dynamic object after the best shift in the image: how far beside its place it is
//! drawn, how good a copy it is otherwise, and how much it swims from view to view.

use super::regions::regions;
use m4_core::{CaptureFrame, RgbImage};
use m4_eval::image::{ImageError, Shift, best_shift};
use serde::Serialize;
use std::collections::BTreeMap;

/// An object over the views of a set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AlignedScore {
    /// The set of views.
    pub set: String,
    /// Its number in the instance maps; 0 for connected regions of the masks where there are none.
    pub object: u16,
    /// Views that show it.
    pub views: usize,
    /// Mean length of the best shift, pixels.
    pub shift_px: f64,
    /// Root of the mean squared distance of the shifts from their mean, pixels.
    pub swim_px: f64,
    /// Mean PSNR over the object where it is drawn, dB.
    pub placed_db: f64,
    /// Mean PSNR over the object after the best shift, dB.
    pub aligned_db: f64,
}

/// The shifts of the objects of one set of views.
#[derive(Default)]
pub(super) struct Shifts(BTreeMap<u16, Vec<Shift>>);

impl Shifts {
    /// Compares what was drawn with a view.
    pub fn add(&mut self, drawn: &RgbImage, view: &CaptureFrame) -> Result<(), ImageError> {
        for (object, pixels) in regions(view) {
            self.0
                .entry(object)
                .or_default()
                .extend(best_shift(drawn, &view.rgb, &pixels)?);
        }
        Ok(())
    }

    /// One row per object.
    pub fn rows(&self, set: &str) -> Vec<AlignedScore> {
        let row = |(&object, shifts): (&u16, &Vec<Shift>)| {
            let mean =
                |f: &dyn Fn(&Shift) -> f64| shifts.iter().map(f).sum::<f64>() / shifts.len() as f64;
            let by = |s: &Shift| s.by_px.map(f64::from);
            let centre = [mean(&|s| by(s)[0]), mean(&|s| by(s)[1])];
            AlignedScore {
                set: set.to_owned(),
                object,
                views: shifts.len(),
                shift_px: mean(&|s| by(s)[0].hypot(by(s)[1])),
                swim_px: mean(&|s| (by(s)[0] - centre[0]).powi(2) + (by(s)[1] - centre[1]).powi(2))
                    .sqrt(),
                placed_db: mean(&|s| s.placed_db),
                aligned_db: mean(&|s| s.aligned_db),
            }
        };
        self.0
            .iter()
            .filter(|(_, shifts)| !shifts.is_empty())
            .map(row)
            .collect()
    }
}

/// The rows as a table for people.
pub(super) fn table(rows: &[AlignedScore]) -> String {
    let mut out = format!(
        "{:<22} {:>6} {:>5} {:>8} {:>7} {:>9} {:>10}\n",
        "object, best shift", "number", "views", "shift px", "swim px", "placed dB", "aligned dB"
    );
    for r in rows {
        out += &format!(
            "{:<22} {:>6} {:>5} {:>8.1} {:>7.1} {:>9.2} {:>10.2}\n",
            r.set, r.object, r.views, r.shift_px, r.swim_px, r.placed_db, r.aligned_db
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::Shifts;
    use m4_core::{
        Camera, CaptureFrame, CompactIds, CompactMask, Intrinsics, Plane, RgbImage, Se3,
    };

    /// Two textured squares on grey, the second `beside` pixels to the right of its place.
    fn image(beside: usize) -> RgbImage {
        let square = |x: usize, y: usize, left: usize| {
            (left..left + 20).contains(&x) && (10..30).contains(&y)
        };
        Plane::from_fn(100, 40, |x, y| {
            match (square(x, y, 10), square(x, y, 60 + beside)) {
                (true, _) => [(x * 37 % 200) as u8, (y * 53 % 200) as u8, 0],
                (_, true) => [((x - beside) * 37 % 200) as u8, (y * 53 % 200) as u8, 0],
                _ => [90; 3],
            }
        })
    }

    fn view(instances: bool) -> CaptureFrame {
        let id = |x: usize, y: usize| match (x, y) {
            (10..30, 10..30) => 1,
            (60..80, 10..30) => 2,
            _ => 0u16,
        };
        CaptureFrame {
            name: "view".to_owned(),
            camera: Camera {
                intrinsics: Intrinsics::centred(100, 40, 80.0),
                c2w: Se3::identity(),
            },
            t: 0.0,
            rgb: image(0),
            depth: None,
            mask: Some(CompactMask::from_fn(100, 40, |x, y| id(x, y) != 0)),
            motion: None,
            instances: instances.then(|| CompactIds::from(&Plane::from_fn(100, 40, id))),
            camera_index: None,
            distance_sigma: None,
        }
    }

    #[test]
    fn an_object_beside_its_place_is_a_good_copy_there() {
        let mut shifts = Shifts::default();
        shifts.add(&image(0), &view(true)).unwrap();
        shifts.add(&image(4), &view(true)).unwrap();
        let [first, second] = &shifts.rows("near")[..] else {
            panic!("two objects")
        };
        assert_eq!(
            (first.object, first.views, first.shift_px, first.swim_px),
            (1, 2, 0.0, 0.0)
        );
        assert_eq!(
            (second.object, second.shift_px, second.swim_px),
            (2, 2.0, 2.0)
        );
        assert!(second.aligned_db > second.placed_db + 20.0, "{second:?}");
        // without instances the two regions of the mask are found, under one number
        let mut shifts = Shifts::default();
        shifts.add(&image(0), &view(false)).unwrap();
        assert_eq!(
            shifts
                .rows("near")
                .iter()
                .map(|r| (r.object, r.views))
                .collect::<Vec<_>>(),
            [(0, 2)]
        );
    }
}
