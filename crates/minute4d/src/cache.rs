//! Finished steps of a long computation, so that an interrupted one continues after the last of
//! them.

use crate::observer::Recording;
use m4_core::Progress;
use serde::{Serialize, de::DeserializeOwned};

/// A place for finished steps by name. What was put in comes back bit by bit, or not at all.
pub trait StepCache: Sync {
    /// Returns the bytes of a step; `None` if there are none that can be trusted.
    fn get(&self, name: &str) -> Option<Vec<u8>>;

    /// Keeps the bytes of a step; a failure costs time when the work is interrupted, and nothing
    /// else.
    fn put(&self, name: &str, bytes: Vec<u8>);
}

/// The steps of a computation, with its progress.
#[derive(Clone, Copy)]
pub struct Steps<'a> {
    progress: &'a dyn Progress,
    cache: Option<&'a dyn StepCache>,
    /// What the names of the steps begin with.
    prefix: &'static str,
}

impl<'a> Steps<'a> {
    /// Steps that are kept in `cache`; in none, every step is computed.
    pub fn new(progress: &'a dyn Progress, cache: Option<&'a dyn StepCache>) -> Self {
        Self {
            progress,
            cache,
            prefix: "",
        }
    }

    /// The same steps under names of their own, which begin with `prefix`.
    pub(crate) fn named(self, prefix: &'static str) -> Self {
        Self { prefix, ..self }
    }

    /// Receives progress and warnings, and says when to stop.
    pub fn observer(&self) -> &'a dyn Progress {
        self.progress
    }

    /// Returns the same steps with another receiver of progress and warnings.
    pub(crate) fn observed_by<'b>(&self, progress: &'b dyn Progress) -> Steps<'b>
    where
        'a: 'b,
    {
        Steps {
            progress,
            cache: self.cache,
            prefix: self.prefix,
        }
    }

    /// Returns the value of a step: from the cache, with its warnings repeated, or computed by
    /// `work` and kept. Warnings of `work` go to the progress that it is given.
    pub(crate) fn keep<T: Serialize + DeserializeOwned, E>(
        &self,
        name: &str,
        work: impl FnOnce(&dyn Progress) -> Result<T, E>,
    ) -> Result<T, E> {
        if let Some((warnings, value)) = self.load::<(Vec<String>, T)>(name) {
            for warning in &warnings {
                self.progress.warn(warning);
            }
            return Ok(value);
        }
        let recorder = Recording::new(self.progress);
        let value = work(&recorder)?;
        self.store(name, &(recorder.warnings(), &value));
        Ok(value)
    }

    /// Returns a kept value, bit by bit.
    pub(crate) fn load<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        postcard::from_bytes(&self.cache?.get(&format!("{}{name}", self.prefix))?).ok()
    }

    /// Keeps a value.
    pub(crate) fn store(&self, name: &str, value: &impl Serialize) {
        // One that cannot be serialised is computed again.
        if let Some(cache) = self.cache
            && let Ok(bytes) = postcard::to_stdvec(value)
        {
            cache.put(&format!("{}{name}", self.prefix), bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{StepCache, Steps};
    use m4_core::Flow;
    use m4_testkit::Heard;
    use std::collections::BTreeMap;
    use std::convert::Infallible;
    use std::sync::Mutex;

    #[derive(Default)]
    struct Memory(Mutex<BTreeMap<String, Vec<u8>>>);

    impl StepCache for Memory {
        fn get(&self, name: &str) -> Option<Vec<u8>> {
            self.0.lock().unwrap().get(name).cloned()
        }

        fn put(&self, name: &str, bytes: Vec<u8>) {
            self.0.lock().unwrap().insert(name.to_owned(), bytes);
        }
    }

    fn step(steps: &Steps<'_>, value: f64) -> f64 {
        let result = steps.keep("cameras", |progress| {
            progress.warn("blurred");
            Ok::<_, Infallible>(value)
        });
        result.unwrap()
    }

    #[test]
    fn a_step_is_computed_once_and_its_warnings_are_repeated() {
        let (cache, warnings) = (Memory::default(), Heard::default());
        let steps = Steps::new(&warnings, Some(&cache));
        let nan = f64::from_bits(0x7ff8_0000_dead_beef);
        assert_eq!(step(&steps, nan).to_bits(), nan.to_bits());
        assert_eq!(
            step(&steps, 1.0).to_bits(),
            nan.to_bits(),
            "from the cache, bit by bit"
        );
        assert_eq!(warnings.all(), "blurred\nblurred");
        let none = Steps::new(&warnings, None);
        assert_eq!((step(&none, 2.0), step(&none, 3.0)), (2.0, 3.0), "no cache");
    }

    #[test]
    fn flow_comes_back_bit_by_bit() {
        let (cache, warnings) = (Memory::default(), Heard::default());
        let steps = Steps::new(&warnings, Some(&cache));
        let numbers = |offset: u32| {
            (0..35)
                .map(|i| f32::from_bits(0x7f80_0000 - 17 + offset + i))
                .collect()
        };
        let flow = Flow {
            width: 7,
            height: 5,
            u: numbers(0),
            v: numbers(1),
        };
        steps.store("flow", &flow);
        let back: Flow = steps.load("flow").unwrap();
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!((back.width, back.height), (7, 5));
        assert!(bits(&back.u) == bits(&flow.u) && bits(&back.v) == bits(&flow.v));
        // as another type it is not there
        assert!(steps.load::<Vec<Vec<f32>>>("flow").is_none());
    }
}
