//! Optical flow by the classical search or RAFT.

use super::Plan;
use crate::Error;
use crate::cache::Steps;
use crate::device::NetworkDevice;
use m4_core::Flow;
use m4_geometry::classical::dense::{MeasureFlow, SourceError};
use m4_geometry::flow::InverseSearch;

impl Plan {
    /// Measures flow between neighbouring frames of a clip; a recurrent network takes `iterations`.
    /// What was measured is kept among `steps`. Fails if weights cannot be used.
    pub fn flow<'a>(
        &self,
        iterations: usize,
        device: &NetworkDevice,
        steps: Steps<'a>,
    ) -> Result<Box<MeasureFlow<'a>>, Error> {
        #[cfg(feature = "nets")]
        if let Some(net) = self.raft(device)? {
            return Ok(Box::new(move |i, a, b| {
                load_or_measure(steps, i, || raft::measure(&net, a, b, iterations))
            }));
        }
        let _ = (iterations, device);
        Ok(Box::new(move |i, a, b| {
            load_or_measure(steps, i, || Ok(InverseSearch.both(a, b)))
        }))
    }
}

/// The flow of frame `i`, measured once: it is asked for again after an interruption, and when
/// depth is estimated again with better cameras.
fn load_or_measure(
    steps: Steps<'_>,
    i: usize,
    measure: impl FnOnce() -> Result<(Flow, Flow), SourceError>,
) -> Result<(Flow, Flow), SourceError> {
    let name = format!("flow-{i:05}");
    if let Some(both) = steps.load(&name) {
        return Ok(both);
    }
    let both = measure()?;
    steps.store(&name, &both);
    Ok(both)
}

#[cfg(feature = "nets")]
mod raft {
    //! RAFT as a source of flow.

    use super::super::Plan;
    use super::{Error, Flow, NetworkDevice, SourceError};
    use crate::error::NetworkMethod;
    use crate::networks::unusable;
    use crate::settings::FrontendPart;
    use m4_core::{Plane, RgbImage};
    use m4_geometry::flow::ScaledFrame;
    use m4_geometry::megasam::PairFlow;
    use m4_geometry::megasam::cvd::pairs::FramePair;
    use m4_nets::Raft;
    use std::collections::HashMap;

    impl Plan {
        pub(super) fn raft(&self, device: &NetworkDevice) -> Result<Option<Raft>, Error> {
            let load = |path| {
                Raft::load(path, &device.device)
                    .map_err(unusable(NetworkMethod::FrontEnd(FrontendPart::Raft)))
            };
            self.file(FrontendPart::Raft).map(load).transpose()
        }

        /// RAFT along a clip; `None` if another method measures flow. Fails if its weights cannot
        /// be used.
        pub fn raft_pairs(
            &self,
            iterations: usize,
            device: &NetworkDevice,
        ) -> Result<Option<Box<dyn PairFlow>>, Error> {
            let (forward, backward) = (HashMap::new(), HashMap::new());
            let raft = self.raft(device)?;
            Ok(raft.map(|net| {
                Box::new(RaftPairs {
                    net,
                    iterations,
                    forward,
                    backward,
                }) as Box<dyn PairFlow>
            }))
        }
    }

    /// Features are made once a pair, for both directions.
    pub(super) fn measure(
        net: &Raft,
        a: &ScaledFrame,
        b: &ScaledFrame,
        iterations: usize,
    ) -> Result<(Flow, Flow), SourceError> {
        let image =
            |of: &ScaledFrame| Plane::from_fn(of.width, of.height, |x, y| of.rgb[y * of.width + x]);
        let (a, b) = (net.encode(&image(a))?, net.encode(&image(b))?);
        let [forward, backward] = net.flow_both(&a, &b, iterations, None)?;
        Ok((forward.flow, backward.flow))
    }

    /// RAFT along a clip: a longer step begins with the flow that the shorter one before it found
    /// at the same ends.
    struct RaftPairs {
        net: Raft,
        iterations: usize,
        /// By the frame that it starts in.
        forward: HashMap<usize, Flow>,
        /// By the frame that it starts in, which is the later one.
        backward: HashMap<usize, Flow>,
    }

    impl PairFlow for RaftPairs {
        fn name(&self) -> &'static str {
            "raft"
        }

        fn both(
            &mut self,
            pair: FramePair,
            a: &RgbImage,
            b: &RgbImage,
        ) -> Result<[Flow; 2], SourceError> {
            let begin = match (
                self.forward.get(&pair.source),
                self.backward.get(&pair.target),
            ) {
                (Some(forward), Some(backward)) if pair.target > pair.source + 1 => {
                    Some([forward, backward])
                }
                _ => None,
            };
            let (a, b) = (self.net.encode(a)?, self.net.encode(b)?);
            let [forward, backward] = self.net.flow_both(&a, &b, self.iterations, begin)?;
            self.forward.insert(pair.source, forward.low);
            self.backward.insert(pair.target, backward.low);
            Ok([forward.flow, backward.flow])
        }
    }
}
