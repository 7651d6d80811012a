//! A round of density control on the device (Minute4D sec. 3.3): scores, the choice of splats to
//! clone, split and prune, and the new rows.
//!
//! | file | what it does |
//! |---|---|
//! | `error_mask` | the pixels whose error counts |
//! | `gradient` | the statistic of 3DGS in place of the scores, for comparison |
//! | `rank` | scores to the best that may grow, and the range that prune scores are measured in |
//! | `outcomes` | the rows that each splat keeps and adds, and their number |
//! | `new_splats` | the next rows, and the parameters of clones and halves |
//!
//! Rows are laid out by one exclusive sum: static splats that stay, then the new ones, then the
//! same of dynamic splats. All that is read back is how many there are.

mod error_mask;
mod gradient;
mod new_splats;
mod outcomes;
mod rank;

pub(crate) use error_mask::Mask;
pub(crate) use gradient::ImageGradients;
pub(crate) use new_splats::Rows;
pub(crate) use outcomes::Outcomes;
pub(crate) use rank::Rank;
