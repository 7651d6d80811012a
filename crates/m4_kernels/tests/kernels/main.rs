//! Every kernel: the reference against the float64 oracle and against differences, the CPU twin against
//! both on every SIMD level of the machine.

mod scenes;
mod twin;

mod chain;
mod definitions;
mod determinism;
mod edge_cases;
mod finite_differences;
mod fixtures;
mod loss;
mod tools;
mod twins;
