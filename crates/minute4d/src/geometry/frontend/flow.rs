//! Networks for optical flow.

use m4_core::{Flow, Plane, RgbImage};
use m4_geometry::classical::dense::{FlowError, FlowImage, FlowSource};
use m4_geometry::megasam::cvd::pairs::FramePair;
use m4_geometry::megasam::{PairFlow, PairFlowError};
use m4_nets::Raft;
use std::collections::HashMap;

const RAFT: &str = "raft";

fn image(image: &FlowImage<'_>) -> RgbImage {
    Plane::from_fn(image.width, image.height, |x, y| image.rgb[y * image.width + x])
}

/// RAFT; features are made once a pair, for both directions.
pub struct RaftSource {
    pub net: Raft,
    pub iterations: usize,
}

impl RaftSource {
    fn measure(&self, a: &RgbImage, b: &RgbImage) -> Result<(Flow, Flow), m4_nets::NetError> {
        let (a, b) = (self.net.encode(a)?, self.net.encode(b)?);
        let [there, back] = self.net.flow_both(&a, &b, self.iterations, None)?;
        Ok((there.flow, back.flow))
    }
}

impl FlowSource for RaftSource {
    fn name(&self) -> &'static str {
        RAFT
    }

    fn both(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> Result<(Flow, Flow), FlowError> {
        self.measure(&image(a), &image(b))
            .map_err(|error| FlowError::Source { source_name: RAFT.to_owned(), reason: Box::new(error) })
    }
}

/// RAFT along a clip: a longer step begins with the flow that the shorter one before it found at the same ends.
pub struct RaftPairs {
    net: Raft,
    iterations: usize,
    /// By the frame that it starts in.
    there: HashMap<usize, Flow>,
    /// By the frame that it starts in, which is the later one.
    back: HashMap<usize, Flow>,
}

impl RaftPairs {
    pub fn new(net: Raft, iterations: usize) -> Self {
        Self { net, iterations, there: HashMap::new(), back: HashMap::new() }
    }

    fn measure(&mut self, pair: FramePair, a: &RgbImage, b: &RgbImage) -> Result<[Flow; 2], m4_nets::NetError> {
        let begin = match (self.there.get(&pair.source), self.back.get(&pair.target)) {
            (Some(there), Some(back)) if pair.target > pair.source + 1 => Some([there, back]),
            _ => None,
        };
        let (a, b) = (self.net.encode(a)?, self.net.encode(b)?);
        let [there, back] = self.net.flow_both(&a, &b, self.iterations, begin)?;
        self.there.insert(pair.source, there.low);
        self.back.insert(pair.target, back.low);
        Ok([there.flow, back.flow])
    }
}

impl PairFlow for RaftPairs {
    fn name(&self) -> &'static str {
        RAFT
    }

    fn both(&mut self, pair: FramePair, a: &RgbImage, b: &RgbImage) -> Result<[Flow; 2], PairFlowError> {
        self.measure(pair, a, b).map_err(|error| PairFlowError {
            source_frame: pair.source,
            target_frame: pair.target,
            reason: Box::new(error),
        })
    }
}
