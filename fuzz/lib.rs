//! What all targets share: the readers of a family, their folders, and what counts as a crash
//! besides a panic. The table of readers is that of the tests of `minute4d_cli`.

pub use libfuzzer_sys;

#[path = "../apps/minute4d/tests/fuzz/files.rs"]
pub mod files;
#[path = "../apps/minute4d/tests/fuzz/reader.rs"]
pub mod reader;
#[path = "../apps/minute4d/tests/fuzz/table/mod.rs"]
pub mod table;

use reader::{Reader, Stage};
use std::cell::{Cell, OnceCell};
use std::panic;

thread_local! {
    static STAGES: OnceCell<Vec<Stage<'static>>> = const { OnceCell::new() };
    static READER: Cell<&'static str> = const { Cell::new("") };
}

fn stages(family: &str) -> Vec<Stage<'static>> {
    // a finding is of one reader of the family: say which
    let before = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        eprintln!("reader: {}", READER.get());
        before(info);
    }));
    let readers: &'static [Reader] = Box::leak(of_family(family).into_boxed_slice());
    let stages = readers.iter().map(|reader| reader.stage().expect("a temporary folder"));
    stages.collect()
}

/// The readers of a family, in the order of the table.
pub fn of_family(family: &str) -> Vec<Reader> {
    table::readers().into_iter().filter(|r| r.family() == family).collect()
}

/// The first byte says which reader of the family reads the others; panics where what came of them
/// is not valid or a message quotes the file.
pub fn read(family: &str, input: &[u8]) {
    let Some((&which, bytes)) = input.split_first() else { return };
    STAGES.with(|held| {
        let stages = held.get_or_init(|| stages(family));
        let stage = &stages[usize::from(which) % stages.len()];
        READER.set(stage.reader().name);
        let outcome = stage.read(bytes).expect("a temporary file");
        if let Some(fault) = stage.fault(&outcome, false) {
            panic!("{fault}");
        }
    });
}

/// The target of a family of readers.
#[macro_export]
macro_rules! target {
    ($family:literal) => {
        $crate::libfuzzer_sys::fuzz_target!(|input: &[u8]| $crate::read($family, input));
    };
}
