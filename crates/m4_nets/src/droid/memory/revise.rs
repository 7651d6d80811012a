//! One update of all edges of a source frame.

use super::{DroidMemory, Edge, Key, read};
use crate::NetError;
use crate::correlation::FeatureMap;
use crate::error::refuse;
use crate::ops::tensor;
use burn_core::tensor::{Device, Tensor};
use std::collections::HashSet;

/// Edges whose maps are in memory at a time: on the processor, where more are not faster, and
/// elsewhere.
const AT_ONCE: [usize; 2] = [4, 16];
/// Motion beyond this many pixels looks the same.
const FAR_PX: f32 = 64.0;

/// One edge to revise. Planes are `[h * w]` of the grid, positions its pixels: u, then v.
#[derive(Debug)]
pub struct EdgeUpdate<'a> {
    /// Which edge.
    pub id: u64,
    /// Where the present geometry sees the pixels of the source in the target. One that is no
    /// number is seen nowhere.
    pub projected_px: [&'a [f32]; 2],
    /// On entry the previous answer (for a new edge the projection when it entered), on return the
    /// measured position.
    pub target_px: &'a mut [Vec<f32>; 2],
    /// Written: confidence of each component, in 0..1. Not yet multiplied by the static confidence.
    pub weight: &'a mut [Vec<f32>; 2],
    /// Written: how likely the pixel is static, in 0..1.
    pub static_confidence: &'a mut Vec<f32>,
}

impl DroidMemory<'_> {
    /// One update of `edges`: the damping of the disparities of `source`, `[h * w]`, above 0. They
    /// are all that start at `source` and take part in this step: damping and static confidence
    /// come from means over them.
    ///
    /// Holds maps of some edges at a time, and one map of each edge.
    ///
    /// # Errors
    ///
    /// [`NetError`] if an edge is not known, starts elsewhere or is there twice, if there is none,
    /// if a plane has another size, if an image cannot be had, or if file or device fail. Answers
    /// of some edges may be written by then.
    pub fn revise_source(
        &mut self,
        source: usize,
        edges: &mut [EdgeUpdate<'_>],
    ) -> Result<Vec<f32>, NetError> {
        let records = self.check(source, edges)?;
        let [first, context] = self.first_state(source)?;
        let features = FeatureMap::new(self.features(source)?);
        self.check_planes(edges)?;
        let context = self.net.gru.context(context);
        let net = self.net.clone();
        let update = &net.net.update;
        let at_once = AT_ONCE[usize::from(net.device != Device::flex())];
        let (mut sum, mut together) = (None, None);
        let mut alone = Vec::new();
        for (edges, records) in edges.chunks_mut(at_once).zip(records.chunks(at_once)) {
            let mut hidden = Vec::new();
            let mut corr = Vec::new();
            for (edge, record) in edges.iter().zip(records) {
                let key = Key::Hidden(edge.id);
                let started = self.store.contains(key);
                hidden.push(if started {
                    self.map(key)?
                } else {
                    first.clone()
                });
                let [u, v] = edge.projected_px;
                let centres = u.iter().zip(v).flat_map(|(&u, &v)| [u, v]).collect();
                corr.push(self.correlation(&features, record.target, centres)?);
            }
            let hidden = Tensor::cat(hidden, 0);
            let motion = self.motion(edges);
            let hidden = update.advance(
                &net.gru,
                hidden,
                context.clone(),
                Tensor::cat(corr, 0),
                Some(motion),
            );
            let weight = update.weight(hidden.clone());
            let delta = read(update.delta(hidden.clone()))?;
            write(edges, &delta, &read(weight.clone())?);
            for (edge, hidden) in edges.iter().zip(hidden.clone().split(1, 0)) {
                self.keep(Key::Hidden(edge.id), hidden)?;
            }
            add(&mut sum, update.agg.sum_of(hidden.clone()));
            let said = update.agg_motion.edges(hidden, weight);
            add(&mut together, said.clone().sum_dim(0));
            alone.push(said);
        }
        let (Some(sum), Some(together)) = (sum, together) else {
            return Err(NetError::Input(format!(
                "frame {source} is to be revised without an edge; its damping is a mean over its edges"
            )));
        };
        let n = edges.len() as f32;
        let together = update.agg_motion.together(together.div_scalar(n));
        for (edges, alone) in edges.chunks_mut(at_once).zip(alone) {
            let still = read(update.agg_motion.still(alone, together.clone()))?;
            let pixels = still.len() / edges.len();
            for (edge, still) in edges.iter_mut().zip(still.chunks(pixels)) {
                *edge.static_confidence = still.to_vec();
            }
        }
        let shared = update.agg.of_mean(sum.div_scalar(n));
        read(update.agg.eta(shared))
    }

    /// The edges, if they can be revised together.
    fn check(&self, source: usize, edges: &[EdgeUpdate<'_>]) -> Result<Vec<Edge>, NetError> {
        let mut ids = HashSet::new();
        let lookup = |edge: &EdgeUpdate<'_>| match self.edges.get(&edge.id) {
            None => refuse(format!(
                "edge {} is not known to the tracking network; let it enter first",
                edge.id
            )),
            Some(record) if record.source != source || !ids.insert(edge.id) => refuse(format!(
                "edge {} does not belong here: it starts at frame {}, and each edge of a source is revised once a time",
                edge.id, record.source
            )),
            Some(record) => Ok(*record),
        };
        edges.iter().map(lookup).collect()
    }

    fn check_planes(&self, edges: &[EdgeUpdate<'_>]) -> Result<(), NetError> {
        let (w, h) = self.grid();
        for edge in edges {
            let target = edge.target_px.iter().map(Vec::len);
            let mut sizes = edge.projected_px.iter().map(|p| p.len()).chain(target);
            if let Some(got) = sizes.find(|&n| n != w * h) {
                return refuse(format!(
                    "edge {} has a plane of {got} numbers where the grid has {} pixels",
                    edge.id,
                    w * h
                ));
            }
        }
        Ok(())
    }

    /// What the update sees of motion: from each pixel to its projection, and on to the previous
    /// answer; `[n, 4, h, w]`.
    fn motion(&self, edges: &[EdgeUpdate<'_>]) -> Tensor<4> {
        let (w, h) = self.grid();
        let mut values = Vec::with_capacity(edges.len() * 4 * w * h);
        let near = |x: f32| {
            if x.is_nan() {
                0.0
            } else {
                x.clamp(-FAR_PX, FAR_PX)
            }
        };
        for edge in edges {
            let [u, v] = edge.projected_px;
            values.extend(u.iter().zip(0..).map(|(u, i)| near(u - (i % w) as f32)));
            values.extend(v.iter().zip(0..).map(|(v, i)| near(v - (i / w) as f32)));
            for (target, projected) in edge.target_px.iter().zip(edge.projected_px) {
                values.extend(target.iter().zip(projected).map(|(t, p)| near(t - p)));
            }
        }
        tensor(values, [edges.len(), 4, h, w], &self.net.device).cast(self.net.dtype())
    }
}

fn add(sum: &mut Option<Tensor<4>>, x: Tensor<4>) {
    *sum = Some(match sum.take() {
        Some(sum) => sum + x,
        None => x,
    });
}

/// Writes positions and weights `[n][2][h * w]`.
fn write(edges: &mut [EdgeUpdate<'_>], delta: &[f32], weight: &[f32]) {
    let pixels = delta.len() / (2 * edges.len()).max(1);
    let planes = delta.chunks(pixels).zip(weight.chunks(pixels));
    let components = edges.iter_mut().flat_map(|edge| {
        let targets = edge.target_px.iter_mut().zip(edge.weight.iter_mut());
        targets.zip(edge.projected_px)
    });
    for (((target, edge_weight), projected), (delta, weight)) in components.zip(planes) {
        *target = projected.iter().zip(delta).map(|(p, d)| p + d).collect();
        *edge_weight = weight.to_vec();
    }
}
