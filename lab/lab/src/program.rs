//! The program that the laboratory measures, which is a part of it.

/// The command of this program that is `minute4d`.
pub const MINUTE4D: &str = "minute4d";
