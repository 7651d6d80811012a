//! The reader of checkpoints: what numpy writes, and what it must not believe.

use super::pickle::{Array, arrays};
use m4_testkit::formula_input;
use std::fs;
use std::path::Path;

fn fixture(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/lpips");
    fs::read(folder.join(name)).unwrap()
}

fn numbers(array: &Array<'_>) -> Vec<f32> {
    let (words, rest) = array.bytes.as_chunks::<4>();
    assert!(rest.is_empty());
    words.iter().map(|&w| f32::from_le_bytes(w)).collect()
}

/// What may come out of any file: arrays whose bytes are those of their shapes, all of them out of
/// the file.
fn is_sound(file: &[u8]) -> bool {
    let Ok(arrays) = arrays(file) else {
        return false;
    };
    let fits = |a: &Array<'_>| a.shape.iter().product::<usize>() * 4 == a.bytes.len();
    assert!(arrays.values().all(fits));
    assert!(arrays.values().map(|a| a.bytes.len()).sum::<usize>() <= file.len());
    true
}

#[test]
fn numpy_files_are_read() {
    let file = fixture("arrays.pickle");
    let arrays = arrays(&file).unwrap();
    let wanted: [(&str, &str, &[usize]); 4] = [
        ("AlexNet_0/Conv_0/bias", "b", &[5]),
        ("AlexNet_0/Conv_0/kernel", "k", &[2, 3, 4, 5]),
        ("NetLinLayer_0/Conv_0/kernel", "l", &[1, 1, 7, 1]),
        ("scalar", "s", &[]),
    ];
    let keys: Vec<&String> = arrays.keys().collect();
    assert_eq!(keys, wanted.map(|(key, ..)| key));
    for ((_, name, shape), array) in wanted.into_iter().zip(arrays.values()) {
        assert_eq!(array.shape, shape);
        let want = formula_input(name, 0.0, 1.0, shape.iter().product());
        assert_eq!(numbers(array), want, "{name}");
    }
}

#[test]
fn other_numbers_and_orders_are_refused() {
    for name in ["doubles.pickle", "by_columns.pickle"] {
        let error = arrays(&fixture(name)).unwrap_err();
        assert!(
            error.to_string().contains("32-bit numbers, row by row"),
            "{name}: {error}"
        );
    }
}

/// Every cut, and every byte with each of its bits turned and as 0, 255 and the steps that change
/// most.
#[test]
fn damage_is_refused_or_harmless() {
    let file = fixture("arrays.pickle");
    assert!(is_sound(&file));
    for n in 0..file.len() {
        assert!(!is_sound(&file[..n]), "cut after {n}");
    }
    let (mut refused, mut read) = (0, 0);
    let mut damaged = file.clone();
    for i in 0..file.len() {
        let turned = (0..8).map(|bit| file[i] ^ (1 << bit));
        for byte in turned.chain([0, 255, b'R', b'b', b'u', b't', b'(', b'.', b'c']) {
            damaged[i] = byte;
            *(if is_sound(&damaged) {
                &mut read
            } else {
                &mut refused
            }) += 1;
        }
        damaged[i] = file[i];
    }
    // most of the file is numbers and names, where anything goes
    assert!(
        refused > 1000 && read > 1000,
        "{refused} refused, {read} read"
    );
    for i in 0..file.len() {
        let mut longer = file.clone();
        longer.splice(i..i, *b"(((}}hq\x01");
        is_sound(&longer);
        let mut shorter = file.clone();
        shorter.drain(i..(i + 5).min(file.len()));
        is_sound(&shorter);
    }
}

#[test]
fn attacks_are_refused() {
    let refused = |program: &[u8], what: &str| {
        let error = arrays(&[b"\x80\x03", program].concat()).unwrap_err();
        assert!(error.to_string().contains(what), "{error}, not {what}");
    };
    refused(b"cos\nsystem\nX\x02\0\0\0ls\x85R.", "not an array");
    refused(b"cnumpy\nndarray\n(tR.", "call");
    refused(b"}q\0X\x01\0\0\0ah\0s.", "two places");
    refused(b"}B\xff\xff\xff\xff", "ends too early");
    refused(b"}X\xff\xff\xff\x7fabc", "ends too early");
    refused(b"}.x", "after the end");
    refused(b"K\x01.", "not a dictionary");
    refused(b"}}.", "not a dictionary");
    refused(b"}X\x01\0\0\0aK\x01s.", "not an array");
    refused(b"}K\x01K\x01s.", "not text");
    refused(b"}(X\x01\0\0\0au.", "no value");
    refused(b"(}(0.", "not need");
    refused(b"}(.", "empty");
    refused(b"h\x05.", "number");
    refused(&b"}\x85".repeat(200_000), "more steps");
    refused(&b")\x85\x85\x85"[..], "too deep");
    let file = fixture("arrays.pickle");
    let nested = [
        &b"}X\x01\0\0\0a".repeat(20)[..],
        &file[2..file.len() - 1],
        &b"s".repeat(20),
        b".",
    ]
    .concat();
    refused(&nested, "too deep");
    let other = b"X\x06\0\0\0kernel";
    let at = file.windows(other.len()).position(|w| w == other).unwrap();
    refused(
        &[&file[2..at], b"X\x04\0\0\0bias", &file[at + other.len()..]].concat(),
        "twice",
    );
    // a shape whose product is beyond any memory, and one that comes out right only when it
    // overflows
    let shape = b"K\x02K\x03K\x04K\x05";
    let at = file.windows(shape.len()).position(|w| w == shape).unwrap();
    for sides in [
        b"J\xff\xff\xff\x7f".repeat(4),
        b"J\0\0\0\x40".repeat(4),
        b"K\x01".repeat(20),
    ] {
        let mut changed = file.clone();
        changed.splice(at..at + shape.len(), sides);
        assert!(!is_sound(&changed));
    }
}
