//! Deliberately faulty readers, one per kind of fault, for files that start with `!`: they verify that each fault is detected.

use super::alone;
use crate::reader::{Outcome, Reader};
use std::hint::black_box;
use std::path::Path;

/// What is asked for where memory is limited, bytes.
const MUCH: usize = 1 << 40;

fn fails_on(path: &Path) -> bool {
    std::fs::read(path).is_ok_and(|bytes| bytes.starts_with(b"!"))
}

fn broken(name: &'static str, failure: fn() -> Outcome) -> Reader {
    let seeds = || vec![b"sound".to_vec(), b"!".to_vec(), b"sound too".to_vec()];
    alone(name, "file", seeds, move |path| {
        if fails_on(path) { failure() } else { Outcome::Read }
    })
}

pub fn rows() -> Vec<Reader> {
    vec![
        broken("broken-panic", || panic!("this reader is broken")),
        broken("broken-abort", || {
            let all: Vec<u8> = Vec::with_capacity(MUCH);
            Outcome::Refused(format!("{} bytes", black_box(all).capacity()))
        }),
        broken("broken-memory", || {
            let all = vec![1u8; 200 << 20];
            Outcome::Refused(format!("{} bytes", black_box(all).len()))
        }),
        broken("broken-message", || Outcome::Refused("long ".repeat(1000))),
        broken("broken-invalid", || Outcome::Invalid("what was read".into())),
    ]
}
