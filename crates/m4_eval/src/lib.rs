//! Metrics and their tables.
//!
//! [`image`] scores rendered images against photographs (PSNR, SSIM, whole and inside a mask);
//! [`geometry`] scores estimated cameras, depth and motion masks against known ones. Both give
//! reports that serialise to JSON and say by which protocol they were made: a score without its
//! protocol cannot be compared. [`warp`] draws views by reprojected depth, without training.
#![forbid(unsafe_code)]

pub mod geometry;
pub mod image;
pub mod warp;
