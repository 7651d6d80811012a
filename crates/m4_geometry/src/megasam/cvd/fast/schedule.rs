//! Which sources may be worked on at the same time.

use crate::megasam::cvd::pairs::FramePair;
use std::collections::HashSet;

/// All pairs of one source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Task {
    pub source: usize,
    /// Indices of its pairs, in the order of their sums.
    pub pairs: Vec<usize>,
}

/// Rounds of tasks. Tasks of a round share no target, so each may add to its targets' gradients without waiting;
/// rounds follow one another, so every sum has one order on any number of threads.
pub(super) fn rounds(frames: usize, pairs: &[FramePair]) -> Vec<Vec<Task>> {
    let mut tasks: Vec<Task> = (0..frames)
        .map(|source| Task {
            source,
            pairs: Vec::new(),
        })
        .collect();
    for (index, pair) in pairs.iter().enumerate() {
        tasks[pair.source].pairs.push(index);
    }
    let mut rounds: Vec<(Vec<Task>, HashSet<usize>)> = Vec::new();
    for task in tasks.into_iter().filter(|t| !t.pairs.is_empty()) {
        let targets: Vec<usize> = task.pairs.iter().map(|&k| pairs[k].target).collect();
        let free = rounds
            .iter_mut()
            .find(|(_, taken)| targets.iter().all(|t| !taken.contains(t)));
        match free {
            Some((tasks, taken)) => {
                tasks.push(task);
                taken.extend(targets);
            }
            None => rounds.push((vec![task], targets.into_iter().collect())),
        }
    }
    rounds.into_iter().map(|(tasks, _)| tasks).collect()
}

#[cfg(test)]
mod tests {
    use super::rounds;
    use crate::megasam::cvd::pairs::{FramePair, pair_list};
    use std::collections::HashSet;

    #[test]
    fn every_pair_is_in_one_round_and_rounds_share_no_target() {
        let mut pairs = pair_list(60);
        let back: Vec<FramePair> = pairs
            .iter()
            .map(|p| FramePair {
                source: p.target,
                target: p.source,
            })
            .collect();
        for both in [false, true] {
            if both {
                pairs.extend(&back);
            }
            let rounds = rounds(60, &pairs);
            let mut seen = HashSet::new();
            for round in &rounds {
                let mut targets = HashSet::new();
                for task in round {
                    for &k in &task.pairs {
                        assert_eq!(pairs[k].source, task.source);
                        assert!(seen.insert(k) && targets.insert(pairs[k].target));
                    }
                }
            }
            assert_eq!(seen.len(), pairs.len());
            assert!(rounds.len() <= if both { 30 } else { 8 }, "{} rounds", rounds.len());
        }
    }
}
