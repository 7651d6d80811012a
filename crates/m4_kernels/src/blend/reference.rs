//! The definition of compositing, forward and backward.
