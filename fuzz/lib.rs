//! What all targets share: the reader of the target's name, its folder, and what counts as a crash besides a panic.

pub use libfuzzer_sys;

use m4_fuzz::{Reader, Stage, reader};
use std::cell::OnceCell;

thread_local! {
    static STAGE: OnceCell<Stage<'static>> = const { OnceCell::new() };
}

fn stage(name: &str) -> Stage<'static> {
    let reader: &'static Reader = Box::leak(Box::new(reader(name).expect("a reader of the table")));
    reader.stage().expect("a temporary folder")
}

/// Reads the bytes; panics where what came of them is not sound or a message quotes the file.
pub fn read(name: &str, bytes: &[u8]) {
    STAGE.with(|held| {
        let outcome = held.get_or_init(|| stage(name)).read(bytes).expect("a temporary file");
        if let Some(fault) = Stage::fault(&outcome) {
            panic!("{name}: {fault}");
        }
    });
}

/// The target of a reader.
#[macro_export]
macro_rules! target {
    ($name:literal) => {
        $crate::libfuzzer_sys::fuzz_target!(|bytes: &[u8]| $crate::read($name, bytes));
    };
}
