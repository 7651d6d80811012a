//! Reads numpy arrays: `.npy` files (NumPy enhancement proposal 1) and `.npz` archives of them.
//!
//! ```text
//! .npy   header | numbers                       Header -> Array, read from front to back
//! .npz   zip of NAME.npy, stored or deflated    Npz: one Array a member
//! ```
//!
//! Files are not trusted. A shape is compared with the bytes that the file can hold (for a deflated member: 1032 times
//! what is packed, the most that deflate can do) before anything of its size is allocated, and pieces are read one by
//! one. Booleans, integers of 8 to 64 bits and floats of 16, 32 and 64 bits are read, of either byte order; arrays in Fortran order are
//! reversed. This is done here and not by a crate: `npyz` multiplies a shape without looking for an overflow.

mod array;
mod header;
mod npz;
mod number;

pub use array::Array;
pub(crate) use array::Numbers;
pub(crate) use header::Header;
pub use npz::Npz;
pub(crate) use number::Number;
