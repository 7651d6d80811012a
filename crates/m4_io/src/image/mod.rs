//! Images, depth maps and masks, one file each.
//!
//! Reading takes 8- and 16-bit PNG and JPEG. Transparent pixels are laid over black. Writing is
//! atomic; the format follows the file name's extension.

mod exif;
mod read;
mod write;

pub use read::{
    Photo, decode_rgb, ids_of_bytes, read_depth, read_grey, read_ids, read_mask, read_photo, read_rgb, size,
};
pub use write::{write_depth, write_grey, write_ids, write_mask, write_rgb};
