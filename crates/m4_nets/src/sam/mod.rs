//! What the generations of "Segment Anything" share: prompts, the transformer between tokens and pixels, masks.

mod decoding;
mod layers;
mod prompt;
mod prompt_encoder;
mod two_way;

pub use decoding::{MAP_WIDTH, Mlp, Upscaling};
pub use layers::{channel_norm, heads, over_channels};
pub use prompt::{PointPrompt, Prompt};
pub use prompt_encoder::{PromptEncoder, Token};
pub use two_way::TwoWay;

/// Channels of embeddings and of tokens.
pub const WIDTH: usize = 256;
