//! Bytes to and from m4_scene: video, images, captures, scene files.
