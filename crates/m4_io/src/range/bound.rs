//! Checks the numbers of windows and bindings.

use super::{Range, of_column, words};
use m4_core::{Binding, Column, Splats, Window};

/// Farthest that the length of a rotation may be from 1.
pub(crate) const UNIT_WITHIN: f32 = 1e-2;
/// Farthest that the sum of the weights of a splat may be from 1.
const SUM_WITHIN: f32 = 1e-3;
/// Least time between two keys, frames: velocities stay within what 32 bits hold.
pub(crate) const LEAST_GAP: f32 = 1e-3;

/// True where the second of two keys is later; NaN is not.
pub(crate) fn rises(keys: &[f32]) -> bool {
    keys[1] - keys[0] >= LEAST_GAP
}

/// How far the length of a rotation is from 1.
pub(crate) fn off_unit(rotation: &[f32; 4]) -> f32 {
    (rotation.iter().map(|v| v * v).sum::<f32>().sqrt() - 1.0).abs()
}

/// The first number of the windows and bindings that is out of its range.
pub(crate) fn of_bindings(splats: &Splats) -> Option<String> {
    let of_window =
        |(i, window): (usize, &Window)| Some(format!("window {i} has {}", of_window(window)?));
    let of_binding = |(i, binding): (usize, &Binding)| {
        Some(format!("bound splat {i} has {}", of_binding(binding)?))
    };
    splats
        .windows()
        .iter()
        .enumerate()
        .find_map(of_window)
        .or_else(|| {
            let mut bindings = splats.bindings().iter().enumerate();
            bindings.find_map(of_binding).or_else(|| trend(splats))
        })
}

fn of_window(window: &Window) -> Option<String> {
    let frames = of_column(Column::TimeMean);
    if let Some(what) = outside("a key", window.keys(), &frames) {
        return Some(what);
    }
    if let Some(gap) = window.keys().windows(2).find(|k| !rises(k)) {
        let what = format!("keys at {} and {}", short(gap[0]), short(gap[1]));
        return Some(format!(
            "{what}; keys that rise by at least {LEAST_GAP} frames were expected"
        ));
    }
    let place = of_column(Column::Mean);
    if let Some(what) = outside(
        "an anchor that holds",
        window.anchors().as_flattened(),
        &place,
    ) {
        return Some(what);
    }
    (0..window.keys().len()).find_map(|key| {
        window
            .poses(key)
            .iter()
            .enumerate()
            .find_map(|(node, pose)| {
                let at = || format!("node {node} at key {key}");
                if let Some(what) = outside("a position that holds", &pose.position, &place) {
                    return Some(format!("{what}: {}", at()));
                }
                let off = off_unit(&pose.rotation);
                // a comparison that NaN fails
                let unit = off <= UNIT_WITHIN;
                (!unit).then(|| {
                    format!(
                        "a rotation whose length is off 1 by {}: {}",
                        short(off),
                        at()
                    )
                })
            })
    })
}

fn of_binding(binding: &Binding) -> Option<String> {
    if let Some(what) = outside(
        "a weight",
        &binding.weights,
        &(0.0..=1.0 + f64::from(SUM_WITHIN)),
    ) {
        return Some(what);
    }
    let sum: f32 = binding.weights.iter().sum();
    if (sum - 1.0).abs() > SUM_WITHIN {
        return Some(format!(
            "weights whose sum is {}; 1 was expected",
            short(sum)
        ));
    }
    let [begin, end] = binding.life;
    let frames = of_column(Column::TimeMean);
    let at = |v: f32, open: f32| v == open || frames.contains(&f64::from(v));
    let valid = at(begin, f32::NEG_INFINITY) && at(end, f32::INFINITY) && begin <= end;
    (!valid).then(|| {
        let life = format!("a life from {} to {}", short(begin), short(end));
        format!(
            "{life}; {}, or -inf to inf, was expected",
            words(&frames, "frames")
        )
    })
}

fn trend(splats: &Splats) -> Option<String> {
    let range = of_column(Column::Trend);
    (0..3).find_map(|k| {
        let trend = &splats.column(Column::Trend, k)[..splats.bindings().len()];
        let i = trend.iter().position(|v| !range.contains(&f64::from(*v)))?;
        let value = short(trend[i]);
        Some(format!(
            "trend of bound splat {i} is {value}; {} was expected",
            words(&range, "")
        ))
    })
}

fn outside(what: &str, values: &[f32], range: &Range) -> Option<String> {
    let value = values.iter().find(|v| !range.contains(&f64::from(**v)))?;
    Some(format!(
        "{what} {}; {} was expected",
        short(*value),
        words(range, "")
    ))
}

/// A number of few letters, as 32 bits have it.
fn short(value: f32) -> String {
    let plain = value == 0.0 || !value.is_finite() || (1e-4..1e7).contains(&value.abs());
    if plain {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

#[cfg(test)]
mod tests {
    use super::of_bindings;
    use crate::range::of_splats;
    use m4_core::{Binding, Column, Splats};
    use m4_testkit::{SceneSpec, bound_scene};
    use std::sync::Arc;

    fn said(change: impl FnOnce(&mut Splats)) -> String {
        let mut splats = bound_scene(&SceneSpec::default()).splats;
        assert_eq!(of_bindings(&splats), None);
        change(&mut splats);
        of_splats(&splats).unwrap_or_default()
    }

    fn binding(splats: &mut Splats, change: impl FnOnce(&mut Binding)) {
        let mut bindings = splats.bindings().to_vec();
        change(&mut bindings[1]);
        splats.bind(Arc::clone(splats.windows()), bindings).unwrap();
    }

    #[test]
    fn numbers_of_windows_and_bindings_out_of_range_are_named() {
        let window = |change: fn(&mut m4_core::Pose)| {
            said(|s| change(&mut s.windows_mut()[1].poses_mut(2)[3]))
        };
        let text = window(|p| p.position[1] = f32::NAN);
        assert!(
            text.starts_with("window 1 has a position that holds NaN")
                && text.ends_with("node 3 at key 2"),
            "{text}"
        );
        let text = window(|p| p.rotation = [0.5, 0.0, 0.0, 0.0]);
        assert!(
            text.contains("window 1 has a rotation whose length is off 1 by 0.5: node 3 at key 2"),
            "{text}"
        );
        assert!(window(|p| p.rotation[0] = f32::INFINITY).contains("off 1 by inf"));
        let of = |change: fn(&mut Binding)| said(|s| binding(s, change));
        assert!(
            of(|b| b.weights = [1.5, -0.5, 0.0, 0.0])
                .starts_with("bound splat 1 has a weight 1.5; 0 to 1")
        );
        assert!(
            of(|b| b.weights = [0.5, 0.4, 0.0, 0.0])
                .contains("weights whose sum is 0.9; 1 was expected")
        );
        assert!(of(|b| b.weights[2] = f32::NAN).contains("a weight NaN"));
        for life in [
            [3.0, 2.0],
            [f32::NAN, 2.0],
            [f32::INFINITY, f32::INFINITY],
            [-1e30, 2.0],
        ] {
            let text = said(|s| binding(s, |b| b.life = life));
            assert!(
                text.starts_with("bound splat 1 has a life from"),
                "{life:?}: {text}"
            );
        }
        assert_eq!(of(|b| b.life = [f32::NEG_INFINITY, f32::INFINITY]), "");
        let text = said(|s| s.column_mut(Column::Trend, 2)[1] = 1e30);
        assert!(text.starts_with("trend of bound splat 1 is 1"), "{text}");
    }
}
