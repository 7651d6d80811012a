//! Formats lists and numbers in messages.

/// `1 splat`, `2 splats`.
pub(crate) fn plural(n: usize, noun: &str) -> String {
    let s = if n == 1 { "" } else { "s" };
    format!("{n} {noun}{s}")
}
