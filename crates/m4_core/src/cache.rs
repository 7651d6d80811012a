//! A cache for the finished parts of a long computation.

use serde::{Serialize, de::DeserializeOwned};

/// Keeps finished pieces of a long stage, so that an attempt after it was killed need not make them again. Names are
/// unique within one stage with one input and one set of settings: the same name is the same bytes.
///
/// A cache that cannot store a value reports that itself; the work continues, and is repeated next time.
pub trait Cache: Sync {
    /// The bytes stored under this name; `None` if missing or damaged.
    fn get(&self, name: &str) -> Option<Vec<u8>>;

    /// Keeps these bytes.
    fn put(&self, name: &str, bytes: &[u8]);
}

/// The entries of a cache whose names begin with `prefix`, under the names without it.
#[derive(Clone, Copy)]
pub struct ScopedCache<'a> {
    /// Keeps them.
    pub cache: &'a dyn Cache,
    /// Prefix of the names; a hyphen follows.
    pub prefix: &'a str,
}

impl Cache for ScopedCache<'_> {
    fn get(&self, name: &str) -> Option<Vec<u8>> {
        self.cache.get(&format!("{}-{name}", self.prefix))
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        self.cache.put(&format!("{}-{name}", self.prefix), bytes);
    }
}

/// Keeps nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoCache;

impl Cache for NoCache {
    fn get(&self, _: &str) -> Option<Vec<u8>> {
        None
    }

    fn put(&self, _: &str, _: &[u8]) {}
}

/// Returns the cached value, bit by bit, or computes it with `work` and stores it.
///
/// # Errors
///
/// Those of `work`; nothing is kept then.
pub fn kept<T: Serialize + DeserializeOwned, E>(
    cache: &dyn Cache,
    name: &str,
    work: impl FnOnce() -> Result<T, E>,
) -> Result<T, E> {
    if let Some(value) = load(cache, name) {
        return Ok(value);
    }
    let value = work()?;
    store(cache, name, &value);
    Ok(value)
}

/// A value that was put there.
pub fn load<T: DeserializeOwned>(cache: &dyn Cache, name: &str) -> Option<T> {
    postcard::from_bytes(&cache.get(name)?).ok()
}

/// Puts a value there.
pub fn store<T: Serialize + ?Sized>(cache: &dyn Cache, name: &str, value: &T) {
    // One without a form in bytes is made again.
    if let Ok(bytes) = postcard::to_stdvec(value) {
        cache.put(name, &bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::{Cache, NoCache, ScopedCache, kept};
    use std::collections::HashMap;
    use std::sync::Mutex;

    #[derive(Default)]
    struct Memory(Mutex<HashMap<String, Vec<u8>>>);

    impl Cache for Memory {
        fn get(&self, name: &str) -> Option<Vec<u8>> {
            self.0.lock().unwrap().get(name).cloned()
        }

        fn put(&self, name: &str, bytes: &[u8]) {
            self.0.lock().unwrap().insert(name.to_owned(), bytes.to_vec());
        }
    }

    #[test]
    fn results_are_cached_and_failures_are_not() {
        let cache = Memory::default();
        let failed: Result<f64, &str> = kept(&cache, "a", || Err("stopped"));
        assert_eq!(failed, Err("stopped"));
        let nan = f64::from_bits(0x7ff8_0000_dead_beef);
        for made in [nan, 2.0] {
            let value: Result<f64, &str> = kept(&cache, "a", || Ok(made));
            assert_eq!(value.map(f64::to_bits), Ok(nan.to_bits()));
        }
        // bytes of something else
        cache.put("b", &[]);
        assert_eq!(kept(&cache, "b", || Ok::<_, ()>(3_u32)), Ok(3));
        let part = ScopedCache {
            cache: &cache,
            prefix: "second",
        };
        part.put("b", b"12");
        assert_eq!((part.get("a"), cache.get("second-b")), (None, Some(b"12".to_vec())));
        assert_eq!(kept(&NoCache, "c", || Ok::<_, ()>(4_u32)), Ok(4));
    }
}
