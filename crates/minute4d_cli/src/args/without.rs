//! Switches for parts of the method.

use clap::Args;
use minute4d::Settings;
use minute4d::settings::Enhancement;

/// Switches for parts of the method (`minute4d ablate` measures each).
#[derive(Debug, Args)]
pub struct WithoutArgs {
    /// Disable segmentation networks
    #[arg(long)]
    pub no_seg: bool,
    /// Disable point tracking and the propagation of points between frames
    #[arg(long)]
    pub no_track: bool,
    /// Disable density control: no splats are added or pruned during training
    #[arg(long)]
    pub no_density: bool,
}

impl WithoutArgs {
    /// Applies the switches to the settings.
    pub fn apply(&self, settings: &mut Settings) {
        let parts = [
            (self.no_seg, Enhancement::Segmentation),
            (self.no_track, Enhancement::Tracking),
            (self.no_density, Enhancement::Density),
        ];
        for (off, part) in parts {
            if off {
                settings.switch_off(part);
            }
        }
    }
}
