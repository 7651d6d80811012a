//! Which files a data set may refer to.

use clap::Args;
use minute4d::io::reach::Reach;

/// Which files a data set may refer to.
#[derive(Debug, Args)]
pub struct ReachArgs {
    /// Also read images, depth, masks and tracks outside the folder of the data set, by path or by link. Only for data sets
    /// that you trust: a malicious one could refer to private images on this machine
    #[arg(long)]
    pub allow_outside: bool,
}

impl ReachArgs {
    /// Returns the choice in the library's type.
    pub fn reach(&self) -> Reach {
        if self.allow_outside {
            Reach::Anywhere
        } else {
            Reach::Inside
        }
    }
}
