//! Runs a test on every instruction set.

use crate::{Need, skip};

/// Runs `test` on every level of `available` and lists each name of `wanted` that this machine lacks as skipped, so that a
/// run shows what it did not cover.
///
/// # Panics
///
/// If `available` is empty: then nothing would be tested.
#[track_caller]
pub fn on_every_level<L: Copy>(
    available: &[L],
    name: impl Fn(L) -> &'static str,
    wanted: &[&str],
    mut test: impl FnMut(L),
) {
    assert!(!available.is_empty(), "no SIMD level: nothing would be tested");
    for missing in wanted.iter().filter(|w| !available.iter().any(|&l| name(l) == **w)) {
        skip(Need::Instructions, &format!("not tested on {missing}"));
    }
    for &level in available {
        test(level);
    }
}

#[cfg(test)]
mod tests {
    use super::on_every_level;

    #[test]
    fn every_level_runs_once() {
        let mut seen = Vec::new();
        on_every_level(&["a", "b"], |l| l, &["a", "c"], |l| seen.push(l));
        assert_eq!(seen, ["a", "b"]);
    }

    #[test]
    #[should_panic(expected = "nothing would be tested")]
    fn no_level_is_a_failure() {
        on_every_level::<&'static str>(&[], |l| l, &[], |_| {});
    }
}
