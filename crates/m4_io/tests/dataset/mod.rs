//! Data sets as tools, benchmarks and phones leave them, compared with what they were written from.

mod benchmarks;
mod detect;
mod export;
mod megasam;
mod nerfstudio;
mod outside;
mod reconstructions;
mod record3d;
mod support;
mod truth_a;
mod truth_b;
