//! What a worker does with object stores: fetches a clip, copies a result.

use super::attempt::{Attempt, CANNOT_READ, NO_DEVICE};
use super::{JobEnd, Worker};
use crate::cloud::{self, CloudError, Wanted};
use crate::error::{FileError, WorkError};
use crate::lease::Lease;
use crate::manifest::Job;
use crate::publish::{Present, present};
use crate::record::{JobRecord, Verdict};
use crate::verdict::Meaning;
use std::fs;
use std::path::PathBuf;

/// Exit code of a run that should be tried again.
const AGAIN: i32 = 75;

impl Worker<'_> {
    /// The clip as a file of this machine: an object of a store is fetched first.
    pub(super) fn fetched(&self, job: &Job, lease: &Lease) -> Result<Result<PathBuf, Attempt>, WorkError> {
        let Some(etag) = &job.etag else {
            return Ok(Ok(PathBuf::from(&job.input)));
        };
        let (file, note) = self.layout.input(&job.id, cloud::extension(&job.input));
        let wanted = Wanted {
            uri: &job.input,
            bytes: job.bytes,
            etag,
        };
        self.listener.progress(&job.id, "fetch", 0, 1, "");
        let stop = || lease.is_lost() || self.listener.stop();
        let refused = |how, code, error: CloudError| Ok(Err(Attempt::Refused(how, code, error.to_string())));
        match cloud::fetch(wanted, &file, &note, &stop) {
            Ok(()) => Ok(Ok(file)),
            Err(_) if lease.is_lost() => Ok(Err(Attempt::Lost)),
            Err(CloudError::File(error)) => Err(error.into()),
            Err(error @ CloudError::NotFound { .. }) => refused(Meaning::Poison, 66, error),
            Err(error @ (CloudError::Changed { .. } | CloudError::Uri { .. })) => refused(Meaning::Poison, 65, error),
            // The next clip would fare no better here.
            Err(error @ CloudError::Without { .. }) => refused(Meaning::GiveBack, NO_DEVICE, error),
            Err(error @ CloudError::Denied { .. }) => refused(Meaning::GiveBack, CANNOT_READ, error),
            Err(error) => refused(Meaning::GiveBack, AGAIN, error),
        }
    }

    /// Removes what was fetched.
    pub(super) fn forget_input(&self, job: &Job) {
        if job.etag.is_some() {
            let (file, note) = self.layout.input(&job.id, cloud::extension(&job.input));
            // What stays costs room alone.
            let _ = fs::remove_file(note);
            let _ = fs::remove_file(file);
        }
    }

    /// Whether the result is here; that it is not uploaded is known.
    pub(super) fn is_published(&self, job: &Job, key: &str) -> Result<bool, FileError> {
        Ok(present(&self.layout.result(&job.id), key)? == Present::Same)
    }

    /// Uploads what another worker, or this one, published before.
    pub(super) fn upload_late(&self, job: &Job, key: &str, lease: &Lease) -> Result<Option<JobEnd>, WorkError> {
        let record = JobRecord::read(&self.layout.state(&job.id), key)?;
        let mut record = record.unwrap_or_else(|| JobRecord::new(&job.id, key, &self.tools.host));
        // Its worker may have died between the publication and the record of it.
        (record.verdict, record.code) = (Verdict::Done, Some(0));
        record.reason.clear();
        self.uploaded(job, record, lease, None)
    }

    /// Copies the published result to where the manifest says, if it says so; `None` where the lease was lost.
    pub(super) fn uploaded(
        &self,
        job: &Job,
        mut record: JobRecord,
        lease: &Lease,
        seconds: Option<f64>,
    ) -> Result<Option<JobEnd>, WorkError> {
        let Some(uri) = &self.manifest.upload else {
            return Ok(Some(JobEnd::Done { seconds }));
        };
        self.listener.progress(&job.id, "upload", 0, 1, "");
        let stop = || lease.is_lost() || self.listener.stop();
        let folder = self.layout.result(&job.id);
        let came = cloud::upload(&folder, uri, &job.id, &stop);
        if lease.is_lost() {
            return Ok(None);
        }
        record.uploaded = came.is_ok();
        if let Err(error) = &came {
            record.reason = format!("{} is published and not uploaded: {error}", job.id);
        }
        record.write(&self.layout.state(&job.id))?;
        Ok(Some(match came {
            Ok(()) => JobEnd::Done { seconds },
            Err(error) => JobEnd::Again {
                reason: record.reason.clone(),
                machine: matches!(error, CloudError::Without { .. }),
            },
        }))
    }
}
