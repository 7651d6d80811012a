//! Malformed files: extreme numbers in each field of the header, truncation at many lengths, empty
//! files, random mutations.

use m4_core::CounterRng;
use m4_testkit::mutate;
use std::ops::Range;

/// Bytes at the start in which a field may lie.
const HEADER: usize = 96;
const CUTS: usize = 24;
/// What a field of a header is set to: more than any file holds, more than a type holds, less than
/// nothing, nothing.
const EXTREMES: [u64; 6] = [
    u64::MAX,
    0x7fff_ffff_ffff_ffff,
    0x4000_0000_4000_0000,
    0x7fff_7fff_7fff_7fff,
    1 << 20,
    0,
];
/// Numbers that take the place of a number of a text.
const NUMBERS: [&str; 9] = [
    "-1",
    "0",
    "NaN",
    "1e308",
    "-1e-320",
    "4294967296",
    "99999999999999999999",
    "1000000000",
    "9223372036854775807",
];
/// Numbers of a text that are replaced.
const NUMBERS_REPLACED: usize = 24;

enum Mutation {
    /// Only this many bytes remain.
    Cut(usize),
    /// A field is set.
    Field {
        at: usize,
        width: usize,
        value: u64,
        big: bool,
    },
    /// A number of a text is another.
    Number(Range<usize>, &'static str),
}

impl Mutation {
    fn on(&self, valid: &[u8]) -> (String, Vec<u8>) {
        match self {
            Self::Cut(at) => (format!("cut at {at}"), valid[..*at].to_vec()),
            Self::Field {
                at,
                width,
                value,
                big,
            } => {
                let mut bytes = valid.to_vec();
                let value = value.to_le_bytes();
                // of patterns the upper bytes, of small numbers the lower
                let part = if value[7] == 0 {
                    &value[..*width]
                } else {
                    &value[8 - width..]
                };
                let field = &mut bytes[*at..at + width];
                field.copy_from_slice(part);
                if *big {
                    field.reverse();
                }
                (
                    format!("{width} bytes at {at}: {:02x?}", &bytes[*at..at + width]),
                    bytes,
                )
            }
            Self::Number(place, number) => {
                let bytes = [
                    &valid[..place.start],
                    number.as_bytes(),
                    &valid[place.end..],
                ]
                .concat();
                (format!("{number} at {}", place.start), bytes)
            }
        }
    }
}

/// Malformed variants of a valid file, each with what was done. `most` bounds their number: where
/// there are more, they are thinned out evenly.
pub fn malformed(valid: Vec<u8>, most: usize) -> impl Iterator<Item = (String, Vec<u8>)> {
    let whole = of_nothing(&valid);
    let mut all = cuts(&valid);
    all.extend(fields(&valid));
    all.extend(numbers(&valid));
    let room = most.saturating_sub(whole.len()).max(1);
    let step = all.len().div_ceil(room).max(1);
    // another phase in each group of as many, so that not the same extreme is taken each time
    let selection = all
        .into_iter()
        .enumerate()
        .filter(move |(i, _)| (i + i / step).is_multiple_of(step));
    whole
        .into_iter()
        .chain(selection.map(move |(_, mutation)| mutation.on(&valid)))
}

/// `count` random mutations of a valid file, each once or sometimes twice, with what was done.
pub fn mutated(valid: Vec<u8>, count: usize) -> impl Iterator<Item = (String, Vec<u8>)> {
    (0..count as u64).map(move |i| {
        let mut rng = CounterRng::new(11, 0x5e_75, i);
        let mut bytes = valid.clone();
        let mut what = mutate(&mut bytes, &mut rng).to_owned();
        if rng.below(4) == 0 && !bytes.is_empty() {
            what = format!("{what} and {}", mutate(&mut bytes, &mut rng));
        }
        (format!("mutation {i}: {what}"), bytes)
    })
}

/// What has little to do with the file.
fn of_nothing(valid: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut all = vec![
        ("nothing".to_owned(), vec![]),
        ("a byte".to_owned(), valid.iter().copied().take(1).collect()),
        ("zeros".to_owned(), vec![0; 512]),
        ("ones".to_owned(), vec![0xff; 512]),
        ("lists without end".to_owned(), vec![b'['; 1 << 20]),
        ("a line without end".to_owned(), vec![b'9'; 1 << 20]),
        ("words without end".to_owned(), b"abc ".repeat(1 << 18)),
    ];
    let header = valid.len().min(HEADER);
    all.push((
        "a valid header, then ones".to_owned(),
        [&valid[..header], &[0xff; 4096]].concat(),
    ));
    all.push(("twice".to_owned(), [valid, valid].concat()));
    if let Some(at) = valid.iter().position(|b| *b == b'{') {
        let deep = [&valid[..=at], &b"\"a\":{".repeat(60_000)].concat();
        all.push(("objects without end".to_owned(), deep));
        let quoted = [&valid[..=at], b"\"", &b"q".repeat(100_000), &valid[at..]].concat();
        all.push(("a key without end".to_owned(), quoted));
    }
    if let Some(at) = valid.iter().position(|b| *b == b'"') {
        let long = [&valid[..=at], &b"q".repeat(100_000), &valid[at + 1..]].concat();
        all.push(("a long name".to_owned(), long));
    }
    all
}

fn cuts(valid: &[u8]) -> Vec<Mutation> {
    let n = valid.len();
    let near = (1..=8).map(|k| n.saturating_sub(k));
    let even = (0..CUTS).map(|k| n * k / CUTS);
    even.chain(near).map(Mutation::Cut).collect()
}

/// Fields of 1, 2, 4 and 8 bytes at each place of the header (and, of archives, of the end), of
/// either byte order.
fn fields(valid: &[u8]) -> Vec<Mutation> {
    let n = valid.len();
    let start = 0..n.min(HEADER);
    let end = if valid.starts_with(b"PK") {
        n.saturating_sub(HEADER).max(start.end)..n
    } else {
        n..n
    };
    let mut all = Vec::new();
    for at in start.chain(end).chain(boxes(valid)) {
        for width in [1, 2, 4, 8].into_iter().filter(|w| at + w <= n) {
            for value in EXTREMES {
                let orders: &[bool] = if width == 1 { &[false] } else { &[false, true] };
                all.extend(orders.iter().map(|&big| Mutation::Field {
                    at,
                    width,
                    value,
                    big,
                }));
            }
        }
    }
    all
}

/// Places of counts in what is nested: behind the names of boxes, chunks and segments.
fn boxes(valid: &[u8]) -> Vec<usize> {
    let names: [&[u8]; 16] = [
        b"stsz",
        b"stts",
        b"ctts",
        b"stsc",
        b"stco",
        b"elst",
        b"stsd",
        b"avcC",
        b"mvhd",
        b"mdhd",
        b"tkhd",
        b"moov",
        b"IHDR",
        b"PLTE",
        b"IDAT",
        b"dataWindow\0box2i\0",
    ];
    let mut all = Vec::new();
    for name in names {
        if let Some(at) = valid.windows(name.len()).position(|w| w == name) {
            let end = at + name.len();
            all.extend(at.saturating_sub(4)..at);
            all.extend(end..(end + 20).min(valid.len()));
        }
    }
    for at in 0..valid.len().saturating_sub(10) {
        // the frame of a JPEG file
        if valid.starts_with(&[0xff, 0xd8])
            && valid[at] == 0xff
            && (0xc0..=0xc2).contains(&valid[at + 1])
        {
            all.extend(at + 2..at + 10);
        }
    }
    all
}

fn numbers(valid: &[u8]) -> Vec<Mutation> {
    let digit = |i: usize| {
        valid
            .get(i)
            .is_some_and(|b| b.is_ascii_digit() || b"+-.eE".contains(b))
    };
    let mut places = Vec::new();
    let mut i = 0;
    while i < valid.len().min(1 << 14) {
        if valid[i].is_ascii_digit() {
            let mut end = i;
            while digit(end) {
                end += 1;
            }
            places.push(i..end);
            i = end;
        }
        i += 1;
    }
    let step = places.len().div_ceil(NUMBERS_REPLACED).max(1);
    let mut all = Vec::new();
    for place in places.into_iter().step_by(step) {
        all.extend(NUMBERS.map(|number| Mutation::Number(place.clone(), number)));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::malformed;

    #[test]
    fn malformed_files_differ_from_the_valid_one() {
        let valid = b"{\"n\": 12, \"name\": \"x\"}".to_vec();
        let all: Vec<_> = malformed(valid.clone(), 100).collect();
        assert!((60..=110).contains(&all.len()), "{}", all.len());
        assert!(all.iter().filter(|(_, bytes)| *bytes != valid).count() > 55);
        assert!(
            all.iter()
                .any(|(_, bytes)| bytes.windows(20).any(|w| w == b"99999999999999999999"))
        );
        assert!(all.iter().any(|(what, _)| what.starts_with("4 bytes")));
        assert!(malformed(Vec::new(), 50).any(|(what, _)| what == "ones"));
    }
}
