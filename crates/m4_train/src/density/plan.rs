//! The rows of the next set of splats.

/// Where a row of the next set comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// It is the splat it was.
    Kept,
    /// It is the splat it was, and a clone of it exists now.
    Cloned,
    /// A copy of a splat.
    Clone,
    /// One of the two children of a splat that is gone.
    Child(u8),
}

impl Origin {
    /// True for rows whose optimiser state starts from nothing.
    #[must_use]
    pub fn is_new(self) -> bool {
        matches!(self, Self::Clone | Self::Child(_))
    }
}

/// The next set of splats: static rows first.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Plan {
    /// The row of the old set that each row is taken from.
    pub rows: Vec<u32>,
    /// What becomes of it.
    pub origins: Vec<Origin>,
    /// Splats that were cloned.
    pub cloned: usize,
    /// Splats that were split.
    pub split: usize,
    /// Splats that were pruned.
    pub pruned: usize,
}

impl Plan {
    /// True where the row is new splat, `[rows]`.
    #[must_use]
    pub fn is_new(&self) -> Vec<bool> {
        self.origins.iter().map(|o| o.is_new()).collect()
    }

    /// True when the next set is the old one.
    #[must_use]
    pub fn changes_nothing(&self) -> bool {
        self.cloned + self.split + self.pruned == 0
    }
}
