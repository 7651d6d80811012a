//! The ranges of numeric settings. They are wide: what they keep out are numbers that a file, a
//! counter or a step cannot hold, and steps that take so long that a stop is heard late. Stages
//! check closer what only they can know.

use toml::{Table, Value};

/// A numeric setting, its least and its greatest value.
type Range = (&'static str, f64, f64);

/// Bytes that settings may name: a petabyte.
const MOST_BYTES: f64 = 1e15;
/// The same in megabytes.
const MOST_MB: f64 = 1e9;
/// Seconds that settings may name: thirty years.
const MOST_S: f64 = 1e9;
/// Frames of a clip, steps between two events and the like.
const MOST_COUNT: f64 = 1e6;
/// Splats of a scene.
const MOST_SPLATS: f64 = 1e8;

/// Every numeric setting; `docs/settings.md` shows the ranges.
pub(super) const RANGES: [Range; 54] = [
    ("video.max_frames", 1.0, MOST_COUNT),
    ("video.size", 16.0, 16_384.0),
    ("video.start_s", 0.0, MOST_S),
    ("video.end_s", 0.0, MOST_S),
    ("video.max_memory_bytes", 0.0, MOST_BYTES),
    ("video.folder_fps", 1e-6, 1e6),
    ("video.decoder.memory_mb", 0.0, 16_777_216.0),
    ("video.decoder.cpu_seconds", 0.0, MOST_S),
    ("video.decoder.idle_seconds", 1.0, MOST_S),
    ("capture.max_memory_bytes", 0.0, MOST_BYTES),
    ("geometry.shot", 1.0, MOST_COUNT),
    ("sparse.fov_deg", 1.0, 175.0),
    ("sparse.focal_px", 1.0, 1e6),
    ("dense.working_side_px", 64.0, 2048.0),
    ("dense.memory_mb", 1.0, MOST_MB),
    ("megasam.flow_iterations", 1.0, 1000.0),
    ("megasam.memory_budget_mb", 0.0, MOST_MB),
    ("megasam.flow_budget_mb", 0.0, MOST_MB),
    ("megasam.default_fov_deg", 1.0, 175.0),
    ("enhance.masks.side_px", 64.0, 4096.0),
    ("enhance.masks.tau", 0.3, 1.0),
    ("enhance.masks.every_frames", 1.0, MOST_COUNT),
    ("enhance.tapip3d.every", 1.0, MOST_COUNT),
    ("enhance.tapip3d.spacing_px", 1.0, 1000.0),
    ("enhance.tapip3d.most", 1.0, MOST_COUNT),
    ("enhance.tapip3d.iterations", 1.0, 100.0),
    ("enhance.tapip3d.size", 0.01, 4.0),
    ("enhance.tapip3d.memory_mb", 0.0, MOST_MB),
    ("init.max_static", 1.0, MOST_SPLATS),
    ("init.max_dynamic", 1.0, MOST_SPLATS),
    ("init.voxel_px", 0.1, 1000.0),
    ("init.keyframe_gaps", 1e-3, MOST_COUNT),
    ("train.iterations", 1.0, 1e7),
    // A stop is heard between steps.
    ("train.batch", 1.0, 32.0),
    ("train.budget_s", 0.0, MOST_S),
    // TOML has numbers of 63 bits.
    ("train.seed", 0.0, 9e18),
    ("train.background", 0.0, 1.0),
    ("train.metrics_every", 1.0, 1e7),
    ("train.target_cache_mb", 0.0, MOST_MB),
    ("train.colour_degree.space", 0.0, 3.0),
    ("train.colour_degree.time", 0.0, 2.0),
    ("train.colour_fit.rounds", 0.0, 100.0),
    ("train.loss.lambda_ssim", 0.0, 1.0),
    // So is it between rounds of density control.
    ("train.density.frames", 1.0, 64.0),
    ("train.density.error_threshold", 0.0, 1.0),
    ("train.density.densify_threshold", 0.0, 1e6),
    ("train.density.prune_threshold", 0.0, 1e6),
    ("train.density.from", 0.0, 1.0),
    ("train.density.every", 0.0, 1.0),
    ("train.density.prune_every", 0.0, 1.0),
    ("limit.time_s", 0.0, MOST_S),
    ("checkpoint.every_s", 0.0, MOST_S),
    ("checkpoint.keep", 1.0, 1000.0),
    ("preview.panel_px", 16.0, 4096.0),
];

/// Returns the first number of `settings` that is out of its range: its key, its value and the
/// range.
pub(super) fn out_of_range(settings: &Table) -> Option<(&'static str, String, String)> {
    RANGES.iter().find_map(|&(key, least, most)| {
        let mut values = numbers(get(settings, key)?).into_iter();
        let bad = values.find(|value| !(least..=most).contains(value))?;
        Some((key, bad.to_string(), shown(least, most)))
    })
}

/// The range of a key as text, if it has one.
#[cfg(test)]
pub(super) fn range_of(key: &str) -> Option<String> {
    RANGES
        .iter()
        .find(|(name, ..)| *name == key)
        .map(|&(_, least, most)| shown(least, most))
}

fn shown(least: f64, most: f64) -> String {
    format!("{least} to {most}")
}

/// The value of a dotted key.
pub(super) fn get<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    let mut parts = key.split('.');
    let first = table.get(parts.next()?)?;
    parts.try_fold(first, |at, part| at.get(part))
}

/// The number of a value, or those of a list.
fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Integer(n) => vec![*n as f64],
        Value::Float(x) => vec![*x],
        Value::Array(values) => values.iter().flat_map(numbers).collect(),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::{RANGES, get, numbers, out_of_range};
    use crate::Settings;
    use crate::settings::Layers;
    use toml::{Table, Value};

    fn table(settings: &Settings) -> Table {
        settings.to_toml().unwrap().parse().unwrap()
    }

    fn numeric_keys(path: &str, table: &Table, keys: &mut Vec<String>) {
        for (name, value) in table {
            let key = if path.is_empty() {
                name.clone()
            } else {
                format!("{path}.{name}")
            };
            match value {
                Value::Table(inner) => numeric_keys(&key, inner, keys),
                value if !numbers(value).is_empty() => keys.push(key),
                _ => {}
            }
        }
    }

    #[test]
    fn every_number_has_a_range_that_its_default_is_in() {
        for settings in [Settings::fast(), Settings::faithful()] {
            let table = table(&settings);
            assert_eq!(out_of_range(&table), None);
            let mut keys = Vec::new();
            numeric_keys("", &table, &mut keys);
            for key in keys {
                assert!(
                    RANGES.iter().any(|(name, ..)| *name == key),
                    "{key} has no range"
                );
            }
        }
    }

    #[test]
    fn numbers_beyond_each_range_are_refused_by_name() {
        for (key, least, most) in RANGES {
            let beyond = [most * 2.0 + 1.0, -1.0 - least];
            // What is whole is whole beyond its range, too.
            let of = |number: f64| match (key, get(&table(&Settings::fast()), key)) {
                ("train.background", _) => format!("[0.0, {number:.1}, 0.0]"),
                (_, Some(Value::Float(_)))
                | ("sparse.fov_deg" | "sparse.focal_px" | "video.start_s" | "video.end_s", _) => {
                    format!("{number:.3}")
                }
                _ => format!("{}", number as i64),
            };
            for number in beyond {
                let text = of(number);
                let refused = Layers::default().set(&format!("{key}={text}"));
                let message = refused.expect_err(&text).to_string();
                assert!(message.contains(key), "{text}: {message}");
            }
        }
        let message = Layers::default()
            .set("train.iterations=5000000000")
            .unwrap_err()
            .to_string();
        assert_eq!(
            message,
            "train.iterations=5000000000: train.iterations = 5000000000 is out of range: it must be 1 to 10000000"
        );
        let mut settings = Settings::fast();
        settings.train.batch = 100_000;
        assert!(
            settings
                .check()
                .unwrap_err()
                .to_string()
                .contains("train.batch = 100000")
        );
    }
}
