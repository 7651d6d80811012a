//! Which jobs are a worker's own.

use crate::error::WorkError;

/// Where engines say which task of an array this is: Slurm, Kubernetes, AWS Batch, HyperQueue.
pub const INDEX_VARIABLES: [&str; 4] = [
    "SLURM_ARRAY_TASK_ID",
    "JOB_COMPLETION_INDEX",
    "AWS_BATCH_JOB_ARRAY_INDEX",
    "HQ_TASK_ID",
];

/// Which jobs a worker does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Share {
    /// All, as one of any number of workers.
    All,
    /// One.
    One(usize),
    /// This one and every so many after it: one task of an array of `stride`.
    Every {
        /// The first.
        index: usize,
        /// How many tasks share the jobs, at least 1.
        stride: usize,
    },
}

impl Share {
    /// Of what the user gave, after what the engine says.
    #[must_use]
    pub fn new(index: Option<usize>, stride: Option<usize>) -> Self {
        match (index, stride) {
            (None, _) => Self::All,
            (Some(index), None) => Self::One(index),
            (Some(index), Some(stride)) => Self::Every {
                index,
                stride: stride.max(1),
            },
        }
    }

    /// The numbers of its jobs, of `jobs` in all.
    ///
    /// # Errors
    ///
    /// [`WorkError::NoSuchJob`] where it has none although there are some.
    pub fn of(self, jobs: usize) -> Result<Vec<usize>, WorkError> {
        match self {
            Self::All => Ok((0..jobs).collect()),
            Self::One(index) | Self::Every { index, .. } if index >= jobs => Err(WorkError::NoSuchJob { index, jobs }),
            Self::One(index) => Ok(vec![index]),
            Self::Every { index, stride } => Ok((index..jobs).step_by(stride).collect()),
        }
    }
}

/// The first index that an engine gives, if one does.
///
/// # Errors
///
/// [`WorkError::Index`] for a variable that is no number.
pub fn index_of_environment(get: impl Fn(&str) -> Option<String>) -> Result<Option<usize>, WorkError> {
    for name in INDEX_VARIABLES {
        if let Some(value) = get(name).filter(|v| !v.is_empty()) {
            let index = value.parse().map_err(|_| WorkError::Index { name, value })?;
            return Ok(Some(index));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::{Share, index_of_environment};

    #[test]
    fn tasks_of_an_array_do_each_job_once() {
        let mut all: Vec<usize> = (0..4)
            .flat_map(|i| Share::new(Some(i), Some(4)).of(10).unwrap())
            .collect();
        all.sort_unstable();
        assert_eq!(all, (0..10).collect::<Vec<_>>());
        assert_eq!(Share::new(Some(3), None).of(10).unwrap(), [3]);
        assert_eq!(Share::new(None, Some(4)).of(2).unwrap(), [0, 1]);
        assert!(Share::new(Some(10), None).of(10).is_err());
    }

    #[test]
    fn the_first_variable_counts() {
        let env = |name: &str| match name {
            "JOB_COMPLETION_INDEX" => Some("7".to_owned()),
            "HQ_TASK_ID" => Some("8".to_owned()),
            _ => None,
        };
        assert_eq!(index_of_environment(env).unwrap(), Some(7));
        assert_eq!(index_of_environment(|_| None).unwrap(), None);
        let said = index_of_environment(|_| Some("x".to_owned())).unwrap_err().to_string();
        assert!(said.contains("SLURM_ARRAY_TASK_ID"), "{said}");
    }
}
