//! Where long work puts what it finished.

use serde::{Serialize, de::DeserializeOwned};

/// Keeps finished pieces of a long stage, so that an attempt after it was killed need not make them again. Names are
/// unique within one stage with one input and one set of settings: the same name is the same bytes.
///
/// A cache that cannot store a value reports that itself; the work continues, and is repeated next time.
pub trait Shelf: Sync {
    /// What was put under this name, whole; `None` where nothing was, or it was damaged.
    fn get(&self, name: &str) -> Option<Vec<u8>>;

    /// Keeps these bytes.
    fn put(&self, name: &str, bytes: &[u8]);
}

/// The entries of a cache whose names begin with `prefix`, under the names without it.
#[derive(Clone, Copy)]
pub struct ShelfPart<'a> {
    /// Keeps them.
    pub shelf: &'a dyn Shelf,
    /// What their names begin with; a hyphen follows.
    pub prefix: &'a str,
}

impl Shelf for ShelfPart<'_> {
    fn get(&self, name: &str) -> Option<Vec<u8>> {
        self.shelf.get(&format!("{}-{name}", self.prefix))
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        self.shelf.put(&format!("{}-{name}", self.prefix), bytes);
    }
}

/// Keeps nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoShelf;

impl Shelf for NoShelf {
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
    shelf: &dyn Shelf,
    name: &str,
    work: impl FnOnce() -> Result<T, E>,
) -> Result<T, E> {
    if let Some(value) = load(shelf, name) {
        return Ok(value);
    }
    let value = work()?;
    store(shelf, name, &value);
    Ok(value)
}

/// A value that was put there.
pub fn load<T: DeserializeOwned>(shelf: &dyn Shelf, name: &str) -> Option<T> {
    postcard::from_bytes(&shelf.get(name)?).ok()
}

/// Puts a value there.
pub fn store<T: Serialize + ?Sized>(shelf: &dyn Shelf, name: &str, value: &T) {
    // One without a form in bytes is made again.
    if let Ok(bytes) = postcard::to_stdvec(value) {
        shelf.put(name, &bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::{NoShelf, Shelf, ShelfPart, kept};
    use std::collections::HashMap;
    use std::sync::Mutex;

    #[derive(Default)]
    struct Memory(Mutex<HashMap<String, Vec<u8>>>);

    impl Shelf for Memory {
        fn get(&self, name: &str) -> Option<Vec<u8>> {
            self.0.lock().unwrap().get(name).cloned()
        }

        fn put(&self, name: &str, bytes: &[u8]) {
            self.0.lock().unwrap().insert(name.to_owned(), bytes.to_vec());
        }
    }

    #[test]
    fn work_is_done_once_and_failures_are_not_kept() {
        let shelf = Memory::default();
        let failed: Result<f64, &str> = kept(&shelf, "a", || Err("stopped"));
        assert_eq!(failed, Err("stopped"));
        let nan = f64::from_bits(0x7ff8_0000_dead_beef);
        for made in [nan, 2.0] {
            let value: Result<f64, &str> = kept(&shelf, "a", || Ok(made));
            assert_eq!(value.map(f64::to_bits), Ok(nan.to_bits()));
        }
        // bytes of something else
        shelf.put("b", &[]);
        assert_eq!(kept(&shelf, "b", || Ok::<_, ()>(3_u32)), Ok(3));
        let part = ShelfPart {
            shelf: &shelf,
            prefix: "second",
        };
        part.put("b", b"12");
        assert_eq!((part.get("a"), shelf.get("second-b")), (None, Some(b"12".to_vec())));
        assert_eq!(kept(&NoShelf, "c", || Ok::<_, ()>(4_u32)), Ok(4));
    }
}
