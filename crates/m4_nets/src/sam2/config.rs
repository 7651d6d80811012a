//! The published sizes.

use crate::load::Shapes;

/// A size of the image encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Sam2Size {
    /// 39.0 million numbers.
    Tiny,
    /// 46.1 million.
    Small,
    /// 80.9 million.
    BasePlus,
    /// 224.4 million.
    Large,
}

impl Sam2Size {
    /// All sizes, the smallest first.
    pub const ALL: [Self; 4] = [Self::Tiny, Self::Small, Self::BasePlus, Self::Large];

    /// The size whose width and number of blocks a checkpoint has; `None` if none has.
    pub(super) fn of(shapes: &Shapes) -> Option<Self> {
        let width = *shapes.get(&format!("{TRUNK}pos_embed"))?.get(1)?;
        let norms = shapes.keys().filter_map(|name| name.strip_prefix(TRUNK));
        let depth =
            norms.filter(|name| name.starts_with("blocks.") && name.ends_with(".norm1.weight"));
        let depth = depth.count();
        let fits = |size: &Self| {
            let config = size.config();
            config.width == width && config.depth() == depth
        };
        Self::ALL.into_iter().find(fits)
    }

    /// How its image encoder is made.
    pub(super) fn config(self) -> Config {
        let of = |width, heads, stages, global, windows, background| Config {
            width,
            heads,
            stages,
            global,
            windows,
            background,
        };
        match self {
            Self::Tiny => of(96, 1, [1, 2, 7, 2], [5, 7, 9], [8, 4, 14, 7], 7),
            Self::Small => of(96, 1, [1, 2, 11, 2], [7, 10, 13], [8, 4, 14, 7], 7),
            Self::BasePlus => of(112, 2, [2, 3, 16, 3], [12, 16, 20], [8, 4, 14, 7], 14),
            Self::Large => of(144, 2, [2, 6, 36, 4], [23, 33, 43], [8, 4, 16, 8], 7),
        }
    }
}

/// Where the image encoder's own part is in a checkpoint.
const TRUNK: &str = "image_encoder.trunk.";

/// How an image encoder is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// Channels of the first stage; each further one has twice as many.
    pub width: usize,
    /// Heads of the first stage; as above.
    pub heads: usize,
    /// Blocks of each stage.
    pub stages: [usize; 4],
    /// Blocks that see the whole image.
    pub global: [usize; 3],
    /// Sides of the windows that the other blocks of a stage see.
    pub windows: [usize; 4],
    /// Side of the learned map of positions that is stretched over the image.
    pub background: usize,
}

/// How a block is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BlockConfig {
    pub from: usize,
    pub to: usize,
    pub heads: usize,
    /// Side of its windows; `None` for the whole image.
    pub window: Option<usize>,
    /// Whether rows and columns are halved.
    pub halves: bool,
    /// Whether it is the last of its stage.
    pub ends: bool,
}

impl Config {
    pub fn depth(&self) -> usize {
        self.stages.iter().sum()
    }

    /// Channels of a stage.
    pub fn width_of(&self, stage: usize) -> usize {
        self.width << stage
    }

    /// All blocks. The first of a stage works in the windows of the stage before, in whose
    /// resolution it starts.
    pub fn blocks(&self) -> Vec<BlockConfig> {
        let mut blocks = Vec::new();
        for (stage, &count) in self.stages.iter().enumerate() {
            for i in 0..count {
                let first = i == 0 && stage > 0;
                let before = if first { stage - 1 } else { stage };
                let global = self.global.contains(&blocks.len());
                blocks.push(BlockConfig {
                    from: self.width_of(before),
                    to: self.width_of(stage),
                    heads: self.heads << stage,
                    window: (!global).then(|| self.windows[before]),
                    halves: first,
                    ends: i + 1 == count,
                });
            }
        }
        blocks
    }
}
