//! Metrics and the tables of a run.
