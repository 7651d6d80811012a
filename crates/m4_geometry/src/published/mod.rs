//! Dense bundle adjustment, graph and tracker against `fixtures/geometry`, numbers of the published code.

mod dba;
mod golden;
mod graph;
mod tracker;
