//! Where long work puts what it finished.

/// Keeps finished pieces of a long stage, so that an attempt after it was killed need not make them again. Names are
/// unique within one stage with one input and one set of settings: the same name is the same bytes.
///
/// A shelf that cannot keep something says so itself; work goes on, and is done again next time.
pub trait Shelf: Sync {
    /// What was put under this name, whole; `None` where nothing was, or it was damaged.
    fn get(&self, name: &str) -> Option<Vec<u8>>;

    /// Keeps these bytes.
    fn put(&self, name: &str, bytes: &[u8]);
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
