//! The definition of slicing, forward and backward.
