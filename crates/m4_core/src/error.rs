//! The one error of this crate: columns or planes that do not fit together.

/// Two lengths that must agree do not.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what} has {found} entries where {expected} were expected")]
pub struct ShapeError {
    /// The column or plane at fault.
    pub what: &'static str,
    /// The length that the rest of the data implies.
    pub expected: usize,
    /// The length that was found.
    pub found: usize,
}

impl ShapeError {
    /// Fails unless `found == expected`.
    ///
    /// # Errors
    ///
    /// [`ShapeError`] naming `what` when the lengths differ.
    pub fn check(what: &'static str, expected: usize, found: usize) -> Result<(), Self> {
        if found == expected { Ok(()) } else { Err(Self { what, expected, found }) }
    }
}
