//! Converts `motion_prob` to masks.

use crate::dataset::{ImportOptions, SourceErrorCause};
use m4_core::{CompactMask, Progress};
use std::path::{Path, PathBuf};

/// Name of the file.
const FILE: &str = "motion_prob.npy";
/// Pixels to a side of what one number stands for.
pub(super) const BLOCK: usize = 8;
/// Above this share of dynamic pixels, the map is probably inverted.
const MAX_DYNAMIC: f64 = 0.6;
/// How far rounding may put a probability outside of 0 to 1.
const ROUNDING: f64 = 1e-3;

/// The file of the clip at `path`: the one given, or the first that is there of those of [`candidates`].
pub(super) fn find(path: &Path, options: &ImportOptions) -> Option<PathBuf> {
    match &options.motion {
        Some(given) => Some(given.clone()),
        None => candidates(path).into_iter().find(|p| p.is_file()),
    }
}

/// Where the file of the clip at `path` may be: in the folder of reconstructions itself; of `NAME_droid.npz` in
/// `reconstructions/NAME` beside it or beside its folder (MegaSaM writes `outputs/` and `reconstructions/` side by
/// side), else right beside it.
pub(super) fn candidates(path: &Path) -> Vec<PathBuf> {
    if path.is_dir() {
        return vec![path.join(FILE)];
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut all = Vec::new();
    if let Some(scene) = path.file_stem().and_then(|s| s.to_str()).map(scene_name) {
        for base in [folder, &folder.join("..")] {
            all.push(base.join("reconstructions").join(scene).join(FILE));
        }
    }
    all.push(folder.join(FILE));
    all
}

/// `dog` of `dog_droid` and `dog_sgd_cvd_hr`.
fn scene_name(stem: &str) -> &str {
    let ends = ["_sgd_cvd_hr", "_sgd_cvd", "_cvd", "_droid"];
    ends.iter().find_map(|end| stem.strip_suffix(end)).unwrap_or(stem)
}

/// The mask of frame `frame` of `size` from the `map` of `of` numbers, row by row.
pub(super) fn mask(
    frame: usize,
    map: &[f64],
    of: (usize, usize),
    size: (usize, usize),
    tau_motion: f64,
) -> Result<CompactMask, SourceErrorCause> {
    if let Some(value) = map.iter().find(|m| !(-ROUNDING..=1.0 + ROUNDING).contains(*m)) {
        let what = format!("frame {frame} of the array `motion_prob` holds {value}");
        return Err(SourceErrorCause::bad(what, "0 (dynamic) to 1 (static) was expected"));
    }
    let across = taps(of.0, size.0);
    let down = taps(of.1, size.1);
    let at = |x: usize, y: usize| {
        let ((x0, x1, fx), (y0, y1, fy)) = (across[x], down[y]);
        let row = |y: usize| map[y * of.0 + x0] * (1.0 - fx) + map[y * of.0 + x1] * fx;
        row(y0) * (1.0 - fy) + row(y1) * fy
    };
    Ok(CompactMask::from_fn(size.0, size.1, |x, y| 1.0 - at(x, y) > tau_motion))
}

/// For each of `to` pixels its two neighbours of `from` and the weight of the second: bilinear, by the centres of
/// pixels, edges repeated.
fn taps(from: usize, to: usize) -> Vec<(usize, usize, f64)> {
    let last = (from - 1) as f64;
    (0..to)
        .map(|i| {
            let at = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).clamp(0.0, last);
            let first = at.floor() as usize;
            (first, (first + 1).min(from - 1), at - at.floor())
        })
        .collect()
}

/// Warns of masks with an improbable share of dynamic pixels.
pub(super) fn check_polarity<'a>(
    masks: impl Iterator<Item = &'a CompactMask>,
    tau_motion: f64,
    progress: &dyn Progress,
) {
    let (mut dynamic, mut all) = (0, 0);
    for mask in masks {
        dynamic += mask.count();
        all += mask.size().0 * mask.size().1;
    }
    let share = dynamic as f64 / all.max(1) as f64;
    if share > MAX_DYNAMIC {
        progress.warn(&format!(
            "{:.0} % of the pixels count as dynamic: motion_prob is high in static regions, and this file is \
             probably inverted; save 1 - motion_prob and import again, or raise tau_motion (now {tau_motion})",
            100.0 * share
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::{candidates, mask};
    use std::path::Path;

    #[test]
    fn high_motion_values_are_static_and_resized_bilinearly() {
        // one row: static, dynamic; the middle between them is at column 8 of 16
        let held = mask(0, &[1.0, 0.0], (2, 1), (16, 1), 0.7).unwrap();
        let dynamic: Vec<bool> = (0..16).map(|x| held.at(x, 0)).collect();
        // motion at column x is (x + 0.5 - 4) / 8: above 0.7 from x = 9.1 on
        assert_eq!(dynamic, (0..16).map(|x| x >= 10).collect::<Vec<_>>());
        let half = mask(0, &[1.0, 0.0], (2, 1), (16, 1), 0.5).unwrap();
        assert_eq!(half.count(), 8);
        assert!(mask(4, &[f64::NAN], (1, 1), (8, 8), 0.7).is_err());
        assert!(
            mask(4, &[1.5], (1, 1), (8, 8), 0.7)
                .unwrap_err()
                .to_string()
                .contains("frame 4")
        );
    }

    #[test]
    fn motion_map_candidates_follow_megasam_folders() {
        let at = candidates(Path::new("out/outputs_cvd/dog_sgd_cvd_hr.npz"));
        assert!(
            at.contains(&"out/outputs_cvd/../reconstructions/dog/motion_prob.npy".into()),
            "{at:?}"
        );
        assert_eq!(at.last().unwrap(), Path::new("out/outputs_cvd/motion_prob.npy"));
    }
}
