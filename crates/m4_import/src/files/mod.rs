//! What several formats need of files: bytes within a limit, JSON, arrays, names in order, rotations.
//!
//! Every function names the file that it fails on.

mod array;
mod json;
mod names;
mod options;
mod picture;
mod pose;
mod zipped;

pub(crate) use array::{NpyFile, array_fault};
pub(crate) use json::{bytes, json, parse_json};
pub(crate) use names::{first_bytes, listed, stem};
pub(crate) use options::{depth_unit, fps};
pub(crate) use picture::{check_pixels, kept_where, opened_size, resized_lens};
pub(crate) use pose::{from_quaternion_xyzw, from_rows};
pub(crate) use zipped::Members;
