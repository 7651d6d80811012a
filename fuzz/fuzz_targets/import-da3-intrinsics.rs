#![no_main]
m4_fuzz_targets::target!("import-da3-intrinsics");
