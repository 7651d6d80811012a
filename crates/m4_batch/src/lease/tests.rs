//! Leases between threads, which know of each other no more than machines do.

use super::{Holder, Taken, look, take};
use std::path::Path;
use std::sync::Barrier;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, SystemTime};

const LONG: Duration = Duration::from_secs(60);

fn holder(nonce: &str) -> Holder {
    Holder {
        nonce: nonce.to_owned(),
        host: "here".to_owned(),
        pid: 7,
        since_s: 0,
        released: false,
    }
}

fn mine(folder: &Path, lasts: Duration, nonce: &str) -> Option<(super::Lease, bool)> {
    match take(folder, lasts, &holder(nonce)).unwrap() {
        Taken::Mine { lease, vanished } => Some((lease, vanished.is_some())),
        Taken::Held(_) => None,
    }
}

/// As if its holder had died so long ago.
fn grow_old(folder: &Path, number: u64, age: Duration) {
    let path = super::store::file(folder, number);
    let file = std::fs::OpenOptions::new().write(true).open(path).unwrap();
    file.set_modified(SystemTime::now() - age).unwrap();
}

#[test]
fn a_job_has_one_holder_and_is_free_when_it_is_given_back() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("job");
    assert!(look(&folder).unwrap().is_none());
    let (lease, vanished) = mine(&folder, LONG, "a").unwrap();
    assert!(!vanished && !lease.is_lost());
    assert!(mine(&folder, LONG, "b").is_none());
    lease.release().unwrap();
    assert!(look(&folder).unwrap().unwrap().is_released());
    let (lease, vanished) = mine(&folder, LONG, "b").unwrap();
    assert!(!vanished, "it was given back");
    assert_eq!(lease.number(), 2);
}

#[test]
fn of_many_takers_of_a_dead_lease_one_wins() {
    let dir = tempfile::tempdir().unwrap();
    for round in 0..20 {
        let folder = dir.path().join(round.to_string());
        drop(mine(&folder, LONG, "dead").unwrap());
        grow_old(&folder, 1, 2 * LONG);
        let (barrier, winners) = (Barrier::new(8), AtomicUsize::new(0));
        thread::scope(|scope| {
            for i in 0..8 {
                let (folder, barrier, winners) = (&folder, &barrier, &winners);
                scope.spawn(move || {
                    barrier.wait();
                    let won = mine(folder, LONG, &i.to_string());
                    if let Some((_, vanished)) = &won {
                        assert!(*vanished);
                        winners.fetch_add(1, Ordering::SeqCst);
                    }
                    // held until all have tried
                    barrier.wait();
                });
            }
        });
        assert_eq!(winners.load(Ordering::SeqCst), 1, "round {round}");
    }
}

#[test]
fn who_was_taken_for_dead_cannot_confirm() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("job");
    let (old, _) = mine(&folder, LONG, "old").unwrap();
    assert!(old.confirm().unwrap(), "nobody else wanted it");
    assert_eq!(old.number(), 2);
    grow_old(&folder, 2, 2 * LONG);
    let (new, vanished) = mine(&folder, LONG, "new").unwrap();
    assert!(vanished);
    assert!(!old.confirm().unwrap() && old.is_lost());
    old.release().unwrap();
    assert!(
        !look(&folder).unwrap().unwrap().is_released(),
        "it was not the old one's to give"
    );
    assert!(new.confirm().unwrap());
}

#[test]
fn a_held_lease_stays_alive_and_a_dropped_one_dies() {
    let dir = tempfile::tempdir().unwrap();
    let (folder, short) = (dir.path().join("job"), Duration::from_millis(1200));
    let (lease, _) = mine(&folder, short, "a").unwrap();
    thread::sleep(2 * short);
    assert!(mine(&folder, short, "b").is_none(), "it is renewed");
    assert!(!lease.is_lost());
    drop(lease);
    thread::sleep(short + Duration::from_millis(300));
    assert!(mine(&folder, short, "b").unwrap().1);
}

#[test]
fn a_holder_notices_that_it_was_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let (folder, short) = (dir.path().join("job"), Duration::from_millis(800));
    let (lease, _) = mine(&folder, short, "a").unwrap();
    assert!(super::store::create(&folder, 2, &holder("b")).unwrap().is_some());
    thread::sleep(short);
    assert!(lease.is_lost());
}
