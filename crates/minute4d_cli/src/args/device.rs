//! The device to run on: CPU or GPU.

use crate::failure::Failure;
use clap::Args;
use minute4d::device::{DeviceChoice, DeviceRequest, UnknownDevice};

/// The device for training.
#[derive(Debug, Args)]
pub struct DeviceArgs {
    /// Device for training and networks: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or `auto` (a hardware
    /// GPU if there is one, else the CPU)
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = device)]
    pub device: DeviceChoice,
    /// Limit of GPU memory for training in megabytes: frames that do not fit are uploaded when needed; training that does not
    /// fit without them is refused [default: unlimited]
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_vram: Option<u32>,
}

impl DeviceArgs {
    /// Returns the request in the library's type.
    pub fn request(&self) -> Result<DeviceRequest, Failure> {
        Ok(DeviceRequest {
            choice: self.device,
            max_vram_mb: limit(self.device, self.max_vram)?,
        })
    }
}

/// Checks `--max-vram`, which applies to GPUs only; returns megabytes.
pub fn limit(device: DeviceChoice, max_vram: Option<u32>) -> Result<Option<usize>, Failure> {
    if device == DeviceChoice::Cpu && max_vram.is_some() {
        return Err(Failure::usage(
            "--max-vram limits a GPU's memory; choose a GPU with --device gpu, or omit --max-vram",
        ));
    }
    Ok(max_vram.map(|mb| mb as usize))
}

/// Parses the name of a device.
pub fn device(text: &str) -> Result<DeviceChoice, UnknownDevice> {
    text.parse()
}
