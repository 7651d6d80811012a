//! Random mutations of files.

use m4_core::CounterRng;

/// Changes the bytes of a file in one of several ways, and returns which.
pub fn mutate(bytes: &mut Vec<u8>, rng: &mut CounterRng) -> &'static str {
    let n = bytes.len();
    if n == 0 {
        return "nothing";
    }
    // half of the mutations go to the start, where the counts are
    let place = |rng: &mut CounterRng| {
        let within = if rng.below(2) == 0 { n.min(512) } else { n };
        rng.below(within)
    };
    match rng.below(9) {
        0 => {
            for _ in 0..=rng.below(4) {
                let at = place(rng);
                bytes[at] ^= 1 << rng.below(8);
            }
            "flipped bits"
        }
        1 => {
            bytes.truncate(rng.below(n));
            "a cut"
        }
        2 | 3 => {
            // a count that is far too large, of either byte order
            let (at, width) = (place(rng), [1, 2, 4, 8][rng.below(4)]);
            let value: u64 = [
                u64::MAX,
                1 << 31,
                0x7fff_ffff,
                1 << 20,
                60_000,
                1 << 40,
                0,
                1,
                0x8000,
                255,
            ][rng.below(10)];
            let value = if rng.below(2) == 0 {
                value.to_le_bytes()
            } else {
                value.rotate_right(8 * width as u32).to_be_bytes()
            };
            let width = width.min(n - at);
            bytes[at..at + width].copy_from_slice(&value[..width]);
            "an extreme count"
        }
        4 => {
            let (from, len, to) = (place(rng), rng.below(200), place(rng));
            let piece = bytes[from..(from + len).min(n)].to_vec();
            bytes.splice(to..to, piece);
            "a piece twice"
        }
        5 => {
            let (from, len) = (place(rng), 1 + rng.below(64));
            bytes.drain(from..(from + len).min(n));
            "a piece missing"
        }
        6 => {
            let at = place(rng);
            let text = [
                &b"1e308"[..],
                b"-",
                b"NaN",
                b"null",
                b"99999999999999999999",
                b"[[[[",
                b"\xff\xfe",
                b"\n",
            ][rng.below(8)];
            bytes.splice(at..(at + text.len()).min(n), text.iter().copied());
            "other text"
        }
        7 => {
            // floats that are no numbers, or enormous
            let at = place(rng) & !3;
            let value = [
                f32::NAN,
                f32::INFINITY,
                f32::MAX,
                -f32::MAX,
                f32::MIN_POSITIVE / 2.0,
            ][rng.below(5)];
            let width = 4.min(n - at);
            bytes[at..at + width].copy_from_slice(&value.to_le_bytes()[..width]);
            "another float"
        }
        _ => {
            let at = place(rng);
            let end = (at + rng.below(16)).min(n);
            for byte in &mut bytes[at..end] {
                *byte = rng.next_u64() as u8;
            }
            "noise"
        }
    }
}
