//! Many clips on many machines: what to do, who does it, what came of it.
//!
//! A [`Manifest`] lists the clips and holds the settings. Any number of workers ([`work`]) share it: each takes
//! a [lease] on a clip, has a child process make the scene in a working folder, and publishes the
//! whole result by one rename. All that is known afterwards ([`Report`]) is read from the results themselves, so it needs no
//! engine and no server. [`slurm`] hands the same worker to a cluster.
#![forbid(unsafe_code)]

pub mod lease;
pub mod slurm;

mod child;
mod credentials;
mod error;
mod layout;
mod manifest;
mod names;
mod plan;
mod publish;
mod record;
mod report;
mod share;
mod verdict;
mod worker;

pub use child::Watch;
pub use error::{FileError, ManifestError, PlanError, WorkError};
pub use layout::{Layout, POSTER_FILE, RESULT_FILE};
pub use manifest::{Arguments, FORMAT, Job, Manifest, VERSION};
pub use names::natural_order;
pub use plan::{Plan, plan};
pub use record::{JobRecord, Verdict};
pub use report::{ClipReport, ClipState, Report, sheet};
pub use share::{INDEX_VARIABLES, Share, index_of_environment};
pub use worker::{JobEnd, Listener, Summary, Tools, WorkOptions, work};
