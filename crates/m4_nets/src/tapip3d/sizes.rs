//! Sizes that follow from the tensors of a checkpoint.

use super::config::Config;
use super::encoding::width;
use crate::load::Shapes;

/// Widths and numbers of layers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sizes {
    /// Channels of features.
    pub features: usize,
    /// Channels of tokens of neighbourhoods.
    pub tokens: usize,
    /// Channels of all their heads together.
    pub token_heads: usize,
    /// Hidden channels of the layers that encode offsets.
    pub offsets_hidden: usize,
    /// Hidden channels of the feed-forward layers of neighbourhoods.
    pub tokens_hidden: usize,
    /// Sets of weights for neighbourhoods: a level, or one.
    pub sets: usize,
    /// Channels of what the updater is given.
    pub input: usize,
    /// Channels of the updater.
    pub hidden: usize,
    /// Hidden channels of its feed-forward layers.
    pub hidden_hidden: usize,
    /// Channels of its answer; 4 are used.
    pub output: usize,
    pub virtual_tracks: usize,
    pub time_depth: usize,
    pub space_depth: usize,
    /// Frames of the table of times.
    pub times: usize,
}

impl Sizes {
    /// Of the checkpoint whose tensors (by the fields' names) are `shapes`.
    ///
    /// # Errors
    ///
    /// What is missing, or does not fit `config` or upstream's layers.
    pub fn in_checkpoint(shapes: &Shapes, config: &Config) -> Result<Self, String> {
        let of = |name: &str, axis: usize| {
            let size = shapes.get(name).and_then(|shape| shape.get(axis).copied());
            size.filter(|&n| n > 0).ok_or_else(|| format!("{name} is missing or has no axis {axis}"))
        };
        let layers = |prefix: &str, rest: &str| {
            let there = |i: &usize| shapes.contains_key(&format!("{prefix}.{i}.{rest}"));
            (0..).take_while(there).count()
        };
        let first = "corr_processor.transformers.0";
        let sizes = Self {
            features: of("corr_processor.in_norm.weight", 0)?,
            tokens: of(&format!("{first}.output_token_1"), 1)?,
            token_heads: of(&format!("{first}.aggr1.to_q.weight"), 0)?,
            offsets_hidden: of("corr_processor.posenc_mlps.0.hidden.weight", 0)?,
            tokens_hidden: of(&format!("{first}.xblock1_2.mlp.fc1.weight"), 0)?,
            sets: layers("corr_processor.posenc_mlps", "hidden.weight"),
            input: of("point_updater.input_transform.weight", 1)?,
            hidden: of("point_updater.input_transform.weight", 0)?,
            hidden_hidden: of("point_updater.time_blocks.0.mlp.fc1.weight", 0)?,
            output: of("point_updater.flow_head.weight", 0)?,
            virtual_tracks: of("point_updater.virtual_tracks", 1)?,
            time_depth: layers("point_updater.time_blocks", "mlp.fc1.weight"),
            space_depth: layers("point_updater.space_virtual_blocks", "mlp.fc1.weight"),
            times: of("time_emb", 1)?,
        };
        sizes.check(config, of("corr_processor.posenc_mlps.0.norm_in.weight", 0)?)?;
        Ok(sizes)
    }

    fn check(&self, config: &Config, offsets: usize) -> Result<(), String> {
        let fits = |ok: bool, what: String| if ok { Ok(()) } else { Err(what) };
        fits(
            offsets == width(3),
            format!("offsets of {offsets} numbers are those of options that are not known here"),
        )?;
        let sets = if config.shared { 1 } else { config.levels };
        fits(self.sets == sets, format!("{} levels of neighbourhoods where the configuration has {sets}", self.sets))?;
        let input = 1 + config.levels * self.tokens + width(6);
        fits(self.input == input, format!("the updater takes {} numbers, not {input}", self.input))?;
        fits(self.output >= 4, format!("the updater says {} numbers, not 4", self.output))?;
        let heads = [(self.token_heads, config.heads), (self.hidden, config.updater_heads)];
        for (width, heads) in heads {
            fits(width % heads == 0, format!("{width} channels cannot be those of {heads} heads"))?;
        }
        fits(
            self.space_depth > 0 && self.time_depth >= self.space_depth,
            format!("{} layers over time and {} over space", self.time_depth, self.space_depth),
        )?;
        fits(self.times == config.window, format!("times of {} frames for windows of {}", self.times, config.window))
    }
}
