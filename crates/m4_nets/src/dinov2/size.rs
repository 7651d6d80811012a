//! The published sizes.

use crate::LoadError;
use crate::load::Shapes;
use std::path::Path;

/// How wide and how deep a backbone is. All of them have heads of 64 channels and feed-forward layers of four times the width.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum BackboneSize {
    /// ViT-S/14: 384 channels, 12 blocks, 22 million numbers.
    Small,
    /// ViT-B/14: 768 channels, 12 blocks, 87 million numbers.
    Base,
    /// ViT-L/14: 1024 channels, 24 blocks, 304 million numbers.
    Large,
}

impl BackboneSize {
    /// All of them, the smallest first.
    pub const ALL: [Self; 3] = [Self::Small, Self::Base, Self::Large];

    /// Channels of a token.
    #[must_use]
    pub fn width(self) -> usize {
        match self {
            Self::Small => 384,
            Self::Base => 768,
            Self::Large => 1024,
        }
    }

    /// Blocks.
    #[must_use]
    pub fn depth(self) -> usize {
        match self {
            Self::Small | Self::Base => 12,
            Self::Large => 24,
        }
    }

    /// Heads of attention.
    #[must_use]
    pub fn heads(self) -> usize {
        self.width() / 64
    }

    /// The name in papers: `ViT-S`, `ViT-B`, `ViT-L`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Small => "ViT-S",
            Self::Base => "ViT-B",
            Self::Large => "ViT-L",
        }
    }

    /// The size of the backbone under `prefix` (with its final dot) in a checkpoint of `network`, as its class token tells. A file's name says
    /// nothing: a small network under the name of a large one is a small one.
    ///
    /// # Errors
    ///
    /// [`LoadError::OtherNetwork`] if there is no such token or it has a width that no published backbone has.
    pub(crate) fn in_checkpoint(
        shapes: &Shapes,
        prefix: &str,
        network: &'static str,
        path: &Path,
    ) -> Result<Self, LoadError> {
        let name = format!("{prefix}cls_token");
        let other = |missing: Vec<String>, wrong: Vec<String>| LoadError::OtherNetwork {
            path: path.to_owned(),
            network,
            missing,
            unused: Vec::new(),
            wrong,
        };
        let Some(shape) = shapes.get(&name) else {
            return Err(other(vec![name], Vec::new()));
        };
        let found = Self::ALL.into_iter().find(|size| shape.last() == Some(&size.width()));
        found.ok_or_else(|| {
            let known = Self::ALL.map(|size| format!("{} of {}", size.width(), size.name()));
            let wrong = format!("{name} has the shape {shape:?}, known widths are {}", known.join(", "));
            other(Vec::new(), vec![wrong])
        })
    }
}
