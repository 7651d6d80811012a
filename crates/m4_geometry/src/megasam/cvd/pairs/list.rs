//! Which frames are compared.

/// Distances of the frames of a pair. MegaSaM: 1, 2, 4, 8, 15.
pub const STEPS: [usize; 5] = [1, 2, 4, 8, 15];

/// A flow field from one frame to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FramePair {
    /// The frame that the flow starts in.
    pub source: usize,
    /// The frame that it leads to.
    pub target: usize,
}

/// Every pair of frames [`STEPS`] apart, forwards in time, by step and then by source: `5 n - 30` pairs from 15 frames
/// on. Steps as long as the clip or longer have no pairs.
#[must_use]
pub fn pair_list(frames: usize) -> Vec<FramePair> {
    let of_step = |step: usize| {
        (step..frames).map(move |target| FramePair {
            source: target - step,
            target,
        })
    };
    STEPS.into_iter().flat_map(of_step).collect()
}

#[cfg(test)]
mod tests {
    use super::{FramePair, pair_list};

    #[test]
    fn a_long_clip_has_five_pairs_a_frame_less_thirty() {
        for n in [15, 16, 96, 1500] {
            assert_eq!(pair_list(n).len(), 5 * n - 30);
        }
        let pairs = pair_list(20);
        assert_eq!(pairs[0], FramePair { source: 0, target: 1 });
        assert_eq!(pairs[pairs.len() - 1], FramePair { source: 4, target: 19 });
        assert!(pairs.iter().all(|p| p.source < p.target && p.target < 20));
    }

    #[test]
    fn short_clips_have_fewer_pairs() {
        assert!(pair_list(0).is_empty() && pair_list(1).is_empty());
        assert_eq!(pair_list(2), [FramePair { source: 0, target: 1 }]);
        // 2 of step 1, 1 of step 2
        assert_eq!(pair_list(3).len(), 3);
        // 8 + 7 + 5 + 1
        assert_eq!(pair_list(9).len(), 21);
    }
}
