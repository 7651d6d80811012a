//! Data sets as tools, benchmarks and phones leave them, compared with what they were written from.

mod detect;
mod export;
mod outside;
mod sets;
mod support;
mod tools;
