//! How far tracks are from the truth.

use m4_core::nalgebra::Vector3;
use m4_geometry::tracks::{PosedFrame, TrackedPoints};
use m4_testkit::BoxScene;
use std::fmt;

/// The frames of a scene, with true geometry.
pub fn clip(scene: &BoxScene) -> Vec<PosedFrame> {
    (0..scene.frames())
        .map(|t| PosedFrame {
            rgb: scene.rgb(t),
            depth: scene.depth(t),
            moving: scene.mask(t),
            camera: scene.cameras[t],
        })
        .collect()
}

/// How far tracks are from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Score {
    pub tracks: usize,
    /// Median distance to the truth where a point is reported visible, and where not, in per cent of its depth.
    pub seen_percent: f64,
    pub hidden_percent: f64,
    /// Share of all frames of all tracks in which the place is known and right: within 5 % of the depth and 10 px.
    pub survival: f64,
    /// The same among the frames in which the point cannot be seen.
    pub recovered: f64,
    /// Frames in which the point cannot be seen, of all.
    pub hidden: f64,
    /// Share of the frames said to see a point that do not.
    pub false_seen: f64,
}

impl fmt::Display for Score {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} tracks; off by {:.2} % seen, {:.2} % hidden (medians); right in {:.1} % of all frames, in {:.1} % of the {:.1} % in \
             which the point is hidden; {:.1} % of what is said to be seen is not",
            self.tracks,
            self.seen_percent,
            self.hidden_percent,
            100.0 * self.survival,
            100.0 * self.recovered,
            100.0 * self.hidden,
            100.0 * self.false_seen
        )
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Compares with the truth; the point of a track is the one that its query shows.
pub fn score(scene: &BoxScene, followed: &TrackedPoints) -> Score {
    let tracks = &followed.tracks;
    let (mut seen_errors, mut hidden_errors) = (Vec::new(), Vec::new());
    let (mut all, mut right, mut hidden, mut recovered, mut said, mut wrong) = (0u32, 0u32, 0u32, 0u32, 0u32, 0u32);
    for (k, query) in followed.queries.iter().enumerate() {
        let ([u, v], _) = scene.cameras[query.frame].project(&query.xyz.map(f64::from).into());
        let hit = scene.cast(query.frame, u, v);
        for t in 0..scene.frames() {
            let truth = scene.place(hit.body, &hit.local, t);
            let (there, z) = scene.cameras[t].project(&truth);
            let sees = scene.sees(hit.body, &hit.local, t);
            all += 1;
            hidden += u32::from(!sees);
            let visible = tracks.visible()[t * tracks.count() + k];
            said += u32::from(visible);
            wrong += u32::from(visible && !sees);
            let Some(place) = tracks.place(t, k) else { continue };
            let place = Vector3::from(place.map(f64::from));
            let error = 100.0 * (truth - place).norm() / z;
            if visible { &mut seen_errors } else { &mut hidden_errors }.push(error);
            let (here, depth) = scene.cameras[t].project(&place);
            let off_px = (here[0] - there[0]).hypot(here[1] - there[1]);
            if (depth / z - 1.0).abs() <= 0.05 && off_px <= 10.0 {
                right += 1;
                recovered += u32::from(!sees);
            }
        }
    }
    let share = |a: u32, b: u32| f64::from(a) / f64::from(b.max(1));
    Score {
        tracks: tracks.count(),
        seen_percent: median(seen_errors),
        hidden_percent: median(hidden_errors),
        survival: share(right, all),
        recovered: share(recovered, hidden),
        hidden: share(hidden, all),
        false_seen: share(wrong, said),
    }
}
