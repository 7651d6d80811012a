//! The integration tests of this crate, in one program.

mod checkpoints;
mod common;
mod depth_anything;
mod droid;
mod gpu;
mod lpips;
mod mobile_sam;
mod moge;
mod raft;
mod sam2;
mod tapip3d;
mod unidepth;
