#![no_main]
m4_fuzz_targets::target!("side-tracks-tapip3d");
