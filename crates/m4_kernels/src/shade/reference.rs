//! The definition of the colour, forward and backward.
