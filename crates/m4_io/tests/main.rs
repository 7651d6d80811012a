//! Every test of this crate that works on files, in one program: they share their helpers.

#[cfg(test)]
mod bad_inputs;
#[cfg(test)]
mod capture;
#[cfg(test)]
mod common;
#[cfg(test)]
mod dataset;
#[cfg(test)]
mod decoder;
#[cfg(test)]
mod exports;
#[cfg(test)]
mod isolation;
#[cfg(test)]
mod memory;
#[cfg(test)]
mod mp4_writer;
#[cfg(test)]
mod resize;
#[cfg(test)]
mod scene_file;
#[cfg(test)]
mod tracks;
#[cfg(test)]
mod trajectory;
#[cfg(test)]
mod video;
