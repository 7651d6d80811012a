//! The definition of one optimiser step.
