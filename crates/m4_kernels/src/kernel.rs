//! The kernels of a training step by name, for reports of times.

/// A kernel of the training step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// Slice, project and shade.
    Project,
    /// Depth order and tile lists.
    Bin,
    /// Tile lists to the image.
    Blend,
    /// L1 + SSIM and its gradient.
    Photo,
    /// Image gradient to ellipse gradients.
    BlendBackward,
    /// Ellipse gradients to parameter gradients.
    ProjectBackward,
    /// The optimiser.
    Adam,
}

impl Kernel {
    /// In the order in which a step runs them.
    pub const ALL: [Self; 7] = [
        Self::Project,
        Self::Bin,
        Self::Blend,
        Self::Photo,
        Self::BlendBackward,
        Self::ProjectBackward,
        Self::Adam,
    ];

    /// As reports call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Project => "project",
            Self::Bin => "bin",
            Self::Blend => "blend",
            Self::Photo => "photo",
            Self::BlendBackward => "blend backward",
            Self::ProjectBackward => "project backward",
            Self::Adam => "adam",
        }
    }

    /// True for the kernels that an image alone needs.
    #[must_use]
    pub fn renders(self) -> bool {
        matches!(self, Self::Project | Self::Bin | Self::Blend)
    }

    /// What a bench counts as one item of it: a splat that lives at the instant (forward) or was
    /// touched, an entry of a tile list that was looked at, a pixel.
    #[must_use]
    pub fn item(self) -> &'static str {
        match self {
            Self::Project | Self::ProjectBackward | Self::Adam => "splat",
            Self::Bin | Self::Blend | Self::BlendBackward => "pair",
            Self::Photo => "pixel",
        }
    }
}
