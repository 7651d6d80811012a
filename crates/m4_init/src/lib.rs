//! From depth and masks to the first splats.
