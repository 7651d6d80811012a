//! Does nothing: without it, cargo ignores the build dependencies (`Cargo.toml`).

fn main() {}
