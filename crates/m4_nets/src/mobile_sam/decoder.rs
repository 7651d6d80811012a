//! The mask decoder: four masks of an embedding and a prompt, with predicted quality.

use crate::sam::{MAP_WIDTH, Mlp, Token, TwoWay, Upscaling};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::{Device, Tensor};

/// Masks of a prompt.
pub const MASKS: usize = 4;
/// The decoder.
#[derive(Module, Debug)]
pub struct MaskDecoder {
    transformer: TwoWay,
    iou_token: Token,
    mask_tokens: Token,
    output_upscaling: Upscaling,
    output_hypernetworks_mlps: [Mlp; MASKS],
    iou_prediction_head: Mlp,
}

impl MaskDecoder {
    pub fn new(device: &Device) -> Self {
        Self {
            transformer: TwoWay::new(device),
            iou_token: Token::new(1, device),
            mask_tokens: Token::new(MASKS, device),
            output_upscaling: Upscaling::new(device),
            output_hypernetworks_mlps: std::array::from_fn(|_| Mlp::new(MAP_WIDTH, device)),
            iou_prediction_head: Mlp::new(MASKS, device),
        }
    }

    /// Of an image's embedding with what is known of the mask, `[256, h, w]`, the places of its pixels, `[h w, 256]`, and the
    /// tokens of the prompt, `[n, 256]`: four masks `[4, 4 h, 4 w]` and their qualities `[4]`.
    pub fn forward(&self, map: Tensor<3>, grid: &Tensor<2>, prompt: Option<Tensor<2>>) -> (Tensor<3>, Tensor<1>) {
        let [c, h, w] = map.dims();
        let mut tokens = vec![self.iou_token.weight.val(), self.mask_tokens.weight.val()];
        tokens.extend(prompt);
        let pixels = map.reshape([1, c, h * w]).swap_dims(1, 2);
        let tokens = Tensor::cat(tokens, 0).unsqueeze_dim(0);
        let grid = grid.clone().unsqueeze_dim(0);
        let (tokens, pixels) = self.transformer.forward(tokens, pixels, &grid);
        let tokens = tokens.squeeze_dim::<2>(0);
        let map = self.output_upscaling.forward(pixels.reshape([1, h, w, c]), None);
        let of_masks = self.output_hypernetworks_mlps.iter().enumerate();
        let weights = of_masks.map(|(i, mlp)| mlp.forward(tokens.clone().narrow(0, 1 + i, 1)));
        let masks = Tensor::cat(weights.collect(), 0).matmul(map.reshape([16 * h * w, MAP_WIDTH]).transpose());
        let iou = self.iou_prediction_head.forward(tokens.narrow(0, 0, 1));
        (masks.reshape([MASKS, 4 * h, 4 * w]), iou.squeeze_dim(0))
    }
}
