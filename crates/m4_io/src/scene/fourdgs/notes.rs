//! The properties of a scene without a field in the format, as our own metadata record.

use ::fourdgs::Metadata;
use m4_core::Scene;
use std::collections::BTreeMap;

/// Name of the record.
const NAME: &str = "minute4d";
/// Longest clip that is read, frames; more is a damaged number.
pub(super) const MAX_FRAMES: usize = 100_000;

/// The facts of the record; those that are missing or make no sense are `None`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Notes {
    pub time_frames: Option<usize>,
    pub duration_s: Option<f64>,
    pub background: Option<[f32; 3]>,
    pub near: Option<f32>,
    pub mip: Option<bool>,
}

/// The metadata record of a scene. Numbers are written so that they come back bit by bit.
pub(super) fn record(scene: &Scene) -> Metadata {
    let [r, g, b] = scene.background;
    let mut entries = BTreeMap::from([
        ("time_frames".to_owned(), scene.time_frames.to_string()),
        ("background".to_owned(), format!("{r} {g} {b}")),
        ("near".to_owned(), scene.near.to_string()),
        ("mip".to_owned(), scene.mip.to_string()),
    ]);
    if let Some(s) = scene.duration_s {
        entries.insert("duration_s".to_owned(), s.to_string());
    }
    Metadata { name: NAME.to_owned(), entries }
}

impl Notes {
    /// The facts in the records of a file.
    pub(super) fn read(records: &[Metadata]) -> Self {
        let Some(record) = records.iter().find(|r| r.name == NAME) else {
            return Self::default();
        };
        let text = |key: &str| record.entries.get(key).map(String::as_str);
        let colour = |text: &str| {
            let parts: Vec<f32> = text.split(' ').map_while(|v| v.parse().ok()).collect();
            <[f32; 3]>::try_from(parts).ok()
        };
        Self {
            time_frames: text("time_frames").and_then(|v| v.parse().ok()).filter(|n| (1..=MAX_FRAMES).contains(n)),
            duration_s: text("duration_s").and_then(|v| v.parse().ok()).filter(|s: &f64| s.is_finite() && *s >= 0.0),
            background: text("background").and_then(colour).filter(|c| c.iter().all(|v| v.is_finite())),
            near: text("near").and_then(|v| v.parse().ok()).filter(|v: &f32| v.is_finite() && *v >= 0.0),
            mip: text("mip").and_then(|v| v.parse().ok()),
        }
    }
}
