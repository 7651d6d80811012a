#![no_main]
m4_fuzz_targets::target!("formats");
