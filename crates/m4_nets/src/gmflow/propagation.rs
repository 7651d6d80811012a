//! Flow carried to pixels that look alike, for those that the other picture does not show (section 3.3).

use crate::ops::{attend, linear, neighbours, window_scores};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::softmax;
use burn_core::tensor::{Device, Tensor};
use burn_nn::Linear;

/// Attention of a picture's features to themselves, with flow as the value.
#[derive(Module, Debug)]
pub struct Propagation {
    q_proj: Linear,
    k_proj: Linear,
}

impl Propagation {
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            q_proj: linear(width, width, true, device),
            k_proj: linear(width, width, true, device),
        }
    }

    /// `flow` `[h, w, 2]` averaged over the whole map by the likeness of `features` `[h, w, c]`. The weights were trained
    /// with keys that are projections of the queries, not of the features.
    pub fn global(&self, features: Tensor<3>, flow: Tensor<3>) -> Tensor<3> {
        let [h, w, c] = features.dims();
        let q = self.q_proj.forward(features.reshape([h * w, c]));
        let k = self.k_proj.forward(q.clone());
        attend(q, k, flow.reshape([h * w, 2])).reshape([h, w, 2])
    }

    /// The same over the pixels at most one away, with keys of the features. Outside the picture the score and the flow are 0.
    pub fn local(&self, features: Tensor<3>, flow: Tensor<3>) -> Tensor<3> {
        let [h, w, _] = flow.dims();
        let q = self.q_proj.forward(features.clone());
        let k = self.k_proj.forward(features);
        let share = softmax(window_scores(q, k, 1).reshape([h, w, 9]), 2).reshape([h, w, 9, 1]);
        (share * neighbours(flow)).sum_dim(2).squeeze_dim(2)
    }
}
