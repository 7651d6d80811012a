//! The mask decoder: four masks of a map of features and a prompt, how good each is thought to be,
//! and whether the object is there.

use super::hiera::Pointwise;
use crate::ops::conv;
use crate::sam::{MAP_WIDTH, Mlp, Token, TwoWay, Upscaling, WIDTH};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::sigmoid;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::Conv2d;

/// Masks of a prompt: one that is meant beyond doubt, three readings of a prompt that is ambiguous.
pub const MASKS: usize = 4;

#[derive(Module, Debug)]
pub struct MaskDecoder {
    transformer: TwoWay,
    iou_token: Token,
    mask_tokens: Token,
    obj_score_token: Token,
    output_upscaling: Upscaling,
    conv_s0: Conv2d,
    conv_s1: Conv2d,
    output_hypernetworks_mlps: [Mlp; MASKS],
    iou_prediction_head: Mlp,
    pred_obj_score_head: Mlp,
}

/// What the decoder says of `b` prompts.
#[derive(Debug, Clone)]
pub struct Decoded {
    /// Logits `[b, 4, 4 h, 4 w]`.
    pub masks: Tensor<4>,
    /// `[b, 4]`.
    pub iou: Tensor<2>,
    /// The masks' tokens, `[b, 4, 256]`.
    pub tokens: Tensor<3>,
    /// `[b, 1]`: above 0 where the object is in the image.
    pub score: Tensor<2>,
}

impl MaskDecoder {
    pub fn new(device: &Device) -> Self {
        Self {
            transformer: TwoWay::new(device),
            iou_token: Token::new(1, device),
            mask_tokens: Token::new(MASKS, device),
            obj_score_token: Token::new(1, device),
            output_upscaling: Upscaling::new(device),
            conv_s0: conv([WIDTH, MAP_WIDTH], 1, 1, true, device),
            conv_s1: conv([WIDTH, 2 * MAP_WIDTH], 1, 1, true, device),
            output_hypernetworks_mlps: std::array::from_fn(|_| Mlp::new(MAP_WIDTH, device)),
            iou_prediction_head: Mlp::new(MASKS, device),
            pred_obj_score_head: Mlp::new(1, device),
        }
    }

    /// The layers that make the [fine maps](Self::forward) of the two finest levels of the neck,
    /// the finest first.
    pub fn fine(&self) -> [Pointwise; 2] {
        [Pointwise::of(&self.conv_s0), Pointwise::of(&self.conv_s1)]
    }

    /// The transformer's part: tokens `[b, 6 + n, 256]` and pixels `[b, h w, 256]` after each has
    /// seen the other.
    pub fn transformed(
        &self,
        map: Tensor<3>,
        grid: &Tensor<3>,
        prompts: Tensor<3>,
    ) -> (Tensor<3>, Tensor<3>) {
        let [b, _, _] = prompts.dims();
        let own = [&self.obj_score_token, &self.iou_token, &self.mask_tokens];
        let own = Tensor::cat(own.map(|token| token.weight.val()).to_vec(), 0);
        let own = own.unsqueeze_dim::<3>(0).expand([b, 2 + MASKS, WIDTH]);
        let [_, n, _] = map.dims();
        let map = map.expand([b, n, WIDTH]);
        self.transformer
            .forward(Tensor::cat(vec![own, prompts], 1), map, grid)
    }

    /// Of features with what is known of masks, `[b, h w, 256]` or one for all, the places of their
    /// pixels, `[1, h w, 256]`, the prompts' tokens, `[b, n, 256]`, and finer maps,
    /// `[1, 2 h, 2 w, 64]` and `[1, 4 h, 4 w, 32]` or `b` of each.
    pub fn forward(
        &self,
        map: Tensor<3>,
        grid: &Tensor<3>,
        prompts: Tensor<3>,
        [s1, s0]: [Tensor<4>; 2],
        [h, w]: [usize; 2],
    ) -> Decoded {
        let (tokens, pixels) = self.transformed(map, grid, prompts);
        let [b, _, _] = tokens.dims();
        let map = self
            .output_upscaling
            .forward(pixels.reshape([b, h, w, WIDTH]), Some([s1, s0]))
            .reshape([b, 16 * h * w, MAP_WIDTH]);
        let token = |i: usize| tokens.clone().narrow(1, i, 1).squeeze_dim::<2>(1);
        let of_masks = self.output_hypernetworks_mlps.iter().enumerate();
        let weights = of_masks.map(|(i, mlp)| mlp.forward(token(2 + i))).collect();
        let weights: Tensor<3> = Tensor::stack(weights, 1);
        Decoded {
            masks: weights
                .matmul(map.swap_dims(1, 2))
                .reshape([b, MASKS, 4 * h, 4 * w]),
            iou: sigmoid(self.iou_prediction_head.forward(token(1))),
            score: self.pred_obj_score_head.forward(token(0)),
            tokens: tokens.narrow(1, 2, MASKS),
        }
    }
}
