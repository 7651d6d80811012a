//! The definition of the photometric loss and its gradient.
