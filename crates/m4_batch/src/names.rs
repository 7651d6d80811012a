//! Names of jobs: from file names, unique, safe as the name of a folder on any system.

use std::cmp::Ordering;
use std::collections::HashMap;

/// Most characters of a name before what makes it unique.
const LONGEST: usize = 80;
/// Characters of a hash that make a name unique.
const HASH_CHARS: usize = 8;

/// Names that Windows keeps for devices.
const DEVICES: [&str; 4] = ["con", "prn", "aux", "nul"];

/// Gives each input `(name, path)` an id. Those whose names fall together, also where case does not count, get a
/// piece of the hash of their path, so that no id depends on which other clips are listed later or earlier.
pub(crate) fn ids(inputs: &[(String, String)]) -> Vec<String> {
    let plain: Vec<String> = inputs.iter().map(|(name, _)| safe(name)).collect();
    let mut count: HashMap<String, usize> = HashMap::new();
    for name in &plain {
        *count.entry(name.to_lowercase()).or_default() += 1;
    }
    let mut given = Vec::with_capacity(plain.len());
    for (name, (_, path)) in plain.into_iter().zip(inputs) {
        let alone = count.get(&name.to_lowercase()).is_some_and(|&n| n == 1);
        given.push(if alone {
            name
        } else {
            format!("{name}-{}", short_hash(path))
        });
    }
    given
}

fn short_hash(text: &str) -> String {
    blake3::hash(text.as_bytes())
        .to_hex()
        .chars()
        .take(HASH_CHARS)
        .collect()
}

fn safe(name: &str) -> String {
    let kept = |c: char| {
        if c.is_ascii_alphanumeric() || "._-".contains(c) {
            c
        } else {
            '_'
        }
    };
    let text: String = name.chars().map(kept).take(LONGEST).collect();
    let text = text.trim_start_matches(['.', '-']).trim_end_matches('.');
    match text {
        "" => "clip".to_owned(),
        text if DEVICES.contains(&text.to_lowercase().as_str()) => format!("{text}_"),
        text => text.to_owned(),
    }
}

/// Whether an id of a manifest can be the name of a folder: it names no other place.
pub(crate) fn is_safe(id: &str) -> bool {
    !id.is_empty()
        && id.len() <= LONGEST + HASH_CHARS + 1
        && !id.starts_with(['.', '-'])
        && id.chars().all(|c| c.is_ascii_alphanumeric() || "._-".contains(c))
}

/// `clip2` before `clip10`: digits are compared as numbers, everything else as characters.
#[must_use]
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    loop {
        let (l, r) = (piece(left), piece(right));
        let order = match (number(l), number(r)) {
            // 007 and 7 are the same number, so the text decides between them in the end
            (Some(x), Some(y)) => x.len().cmp(&y.len()).then_with(|| x.cmp(y)),
            _ => l.cmp(r),
        };
        if order != Ordering::Equal || l.is_empty() {
            return order.then_with(|| a.cmp(b));
        }
        (left, right) = (&left[l.len()..], &right[r.len()..]);
    }
}

/// The digits, or the characters that are none, at the start.
fn piece(text: &str) -> &str {
    let digits = text.starts_with(|c: char| c.is_ascii_digit());
    let end = text.find(|c: char| c.is_ascii_digit() != digits).unwrap_or(text.len());
    &text[..end]
}

/// The digits of a number without leading zeros.
fn number(piece: &str) -> Option<&str> {
    piece
        .starts_with(|c: char| c.is_ascii_digit())
        .then(|| piece.trim_start_matches('0'))
}

#[cfg(test)]
mod tests {
    use super::{ids, is_safe, natural_order};

    #[test]
    fn numbers_count_as_numbers() {
        let mut names = ["clip10", "clip2", "b", "clip2a", "a9", "clip02", "", "a10"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["", "a9", "a10", "b", "clip02", "clip2", "clip2a", "clip10"]);
    }

    #[test]
    fn ids_are_safe_unique_and_do_not_depend_on_the_order() {
        let given = |names: &[(&str, &str)]| {
            let owned: Vec<_> = names.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect();
            ids(&owned)
        };
        let odd = given(&[
            ("../../etc", "1"),
            ("a b\nc", "2"),
            ("ü", "3"),
            ("con", "4"),
            ("...", "5"),
            ("x", "6"),
        ]);
        assert_eq!(odd, ["_.._etc", "a_b_c", "_", "con_", "clip", "x"]);
        let long = "l".repeat(500);
        let clash = given(&[("Clip", "/a/Clip.mp4"), ("clip", "/b/clip.mp4"), (&long, "l")]);
        assert!(
            clash[0].starts_with("Clip-") && clash[1].starts_with("clip-"),
            "{clash:?}"
        );
        assert_ne!(clash[0].to_lowercase(), clash[1].to_lowercase());
        let turned = given(&[("clip", "/b/clip.mp4"), ("Clip", "/a/Clip.mp4")]);
        assert_eq!((&turned[0], &turned[1]), (&clash[1], &clash[0]));
        assert!(odd.iter().chain(&clash).all(|id| is_safe(id)), "{odd:?} {clash:?}");
        for bad in ["", "..", ".hidden", "a/b", "-rf", "a\\b", "ä"] {
            assert!(!is_safe(bad), "{bad}");
        }
    }
}
