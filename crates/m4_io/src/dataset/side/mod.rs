//! Files of depth, masks and tracks: those of formats, and those from another tool for a clip of any format.
//!
//! ```text
//! options.depth, masks, tracks -> attach -> the frames of a listing
//!
//! depth   folder of maps, one a training frame in natural order of names, or an npz stack (depths | depth | depth_map | arr_0:
//!         [n][h][w] or [n][h][w][1])
//!           .exr   first of the channels Z, depth, Y, R; half or float                 .pfm   one channel, rows from the bottom
//!           .png   16 bits per pixel, times ImportOptions::depth_unit                    .npy   [h][w]; integers times depth_unit
//! masks   folder, one a training frame, or an npz stack (masks | mask | dyn_masks | arr_0)
//!           .png   not 0 moves: a number of a palette (DAVIS, SAM 2), a grey value or a colour    .jpg  128 and more moves
//! tracks  npz   TAPIP3D, SpatialTracker v2: coords [n][k][3], visibs, extrinsics
//!               SpatialTracker v1: pred_tracks [n][k][3], pixels and z-depth; CoTracker: tracks or pred_tracks [n][k][2], pixels
//! ```
//!
//! What is converted: NaN, infinite and negative depth become 0 (unknown); PFM's rows are turned; places in pixels are counted
//! from the centre of the first pixel there and from the corner here; coordinates of a world whose cameras the file brings
//! (`extrinsics`, world to camera) go through those cameras to ours.

pub mod depth;
pub mod mask;
pub mod tracks;

mod attach;
mod palette;
mod stack;

pub use attach::attach;
