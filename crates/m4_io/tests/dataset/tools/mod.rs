//! The synthetic clip of `oracles/import_formats_a.py` as every tool of reconstruction leaves it.

mod colmap;
mod lenses;
mod megasam;
mod nerfstudio;
mod truth;
mod vipe;
