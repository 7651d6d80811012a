//! Every kernel: the reference against the float64 oracle and against differences, the CPU twin
//! against both on every SIMD level of the machine.

mod twin;

mod chain;
mod definitions;
mod edge_cases;
mod finite_differences;
mod fixtures;
mod tools;
mod twins;
