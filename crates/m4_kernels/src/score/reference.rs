//! The definition of the score.
