//! Processor or GPU.

use crate::failure::Failure;
use clap::Args;
use minute4d::device::{DeviceChoice, DeviceRequest, UnknownDevice};

/// Where to train.
#[derive(Debug, Args)]
pub struct DeviceArgs {
    /// Where training steps are taken and networks run: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or `auto` (a
    /// GPU where there is one that is more than software)
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// Most memory that training may take on a GPU, megabytes: frames that do not fit are sent when they are needed, and
    /// what does not fit without them is refused [default: as much as it takes]
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_vram: Option<u32>,
}

impl DeviceArgs {
    /// As the library takes it.
    pub fn request(&self) -> Result<DeviceRequest, Failure> {
        Ok(DeviceRequest {
            choice: self.device,
            max_vram_mb: limit(self.device, self.max_vram)?,
        })
    }
}

/// `--max-vram`, which says nothing about the processor.
pub fn limit(device: DeviceChoice, max_vram: Option<u32>) -> Result<Option<usize>, Failure> {
    if device == DeviceChoice::Cpu && max_vram.is_some() {
        return Err(Failure::usage(
            "--max-vram limits a GPU's memory; name one with --device gpu, or leave it out",
        ));
    }
    Ok(max_vram.map(|mb| mb as usize))
}

/// A device by its name.
pub fn device(text: &str) -> Result<DeviceChoice, UnknownDevice> {
    text.parse()
}
