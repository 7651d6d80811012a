//! The made-up clip of `oracles/import_formats_a.py` as every tool of reconstruction leaves it.

mod colmap;
mod da3;
mod lenses;
mod megasam;
mod monst3r;
mod nerfstudio;
mod trajectory;
mod truth;
mod vggt;
mod vipe;
