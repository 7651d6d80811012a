//! The definition of a tile list, by brute force.
