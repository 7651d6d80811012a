#![no_main]
m4_fuzz_targets::target!("import-monst3r-intrinsics");
