//! Consistent video depth: the definition against the numbers of the original program, and the fast path against the
//! definition.

mod consistency;
mod fast;
mod fixture;
mod optimise;
mod reference;
