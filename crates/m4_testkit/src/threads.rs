//! Results that do not depend on the number of threads.

use std::fmt::Debug;

/// What `make` gives, which is the same for any number of threads.
#[track_caller]
pub fn same_on_any_threads<T: PartialEq + Debug + Send>(make: impl Fn() -> T + Sync) -> T {
    let [one, two, five] = [1, 2, 5].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads can be started");
        pool.install(&make)
    });
    assert_eq!(one, two);
    assert_eq!(one, five);
    one
}
