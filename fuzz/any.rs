//! One target for all readers, so that one program is built for a run through all: `M4_FUZZ_READER` names the reader.

#![no_main]

use std::sync::LazyLock;

static READER: LazyLock<String> =
    LazyLock::new(|| std::env::var("M4_FUZZ_READER").expect("M4_FUZZ_READER names a reader"));

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| m4_fuzz_targets::read(&READER, bytes));
