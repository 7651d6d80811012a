//! Blind changes of a sound file.

use m4_math::CounterRng;
use m4_testkit::harm;

/// Copy `i` of a file, changed once or a few times; what was done.
#[must_use]
pub fn harmed(sound: &[u8], seed: u64, i: u64) -> (Vec<u8>, String) {
    let mut rng = CounterRng::new(seed, 0xfa_22, i);
    let mut bytes = sound.to_vec();
    let mut what = Vec::new();
    for _ in 0..[1, 1, 1, 2, 2, 3, 5][rng.below(7)] {
        if bytes.is_empty() {
            break;
        }
        what.push(harm(&mut bytes, &mut rng));
    }
    (bytes, what.join(", "))
}
