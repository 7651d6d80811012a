//! Which files a data set may name.

use clap::Args;
use minute4d::io::reach::Reach;

/// Which files a data set may name.
#[derive(Debug, Args)]
pub struct ReachArgs {
    /// Read pictures, depth, masks and tracks that lie outside of the folder of the data set too, by their names or by links.
    /// Only for data sets of people you trust: the files of others may name private pictures of yours
    #[arg(long)]
    pub allow_outside: bool,
}

impl ReachArgs {
    /// As the library takes it.
    pub fn reach(&self) -> Reach {
        if self.allow_outside {
            Reach::Anywhere
        } else {
            Reach::Inside
        }
    }
}
