//! The definition of the projection, forward and backward.
