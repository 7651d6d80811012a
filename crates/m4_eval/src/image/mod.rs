//! How close a picture is to the photograph: PSNR and SSIM, whole and inside a mask.
//!
//! Colours are sRGB values in `[0, 1]`; both sides are clamped to it first. PSNR is joint over
//! channels: `-10 log10` of the mean squared error over all pixels *and* channels. SSIM (Wang et al.
//! 2004) uses an 11x11 Gaussian window with a standard deviation of 1.5 px and the constants
//! `0.01^2` and `0.03^2`, a map a channel, averaged over the three; only windows that lie wholly
//! inside the image count (the *valid* region). Inside a mask, PSNR takes the pixels of the mask and
//! SSIM averages the map over those of its pixels that lie in the valid region.

mod metrics;
mod picture;
mod report;

pub use metrics::{MAX_PSNR_DB, SSIM_SIGMA_PX, SSIM_WINDOW_PX, SsimMap, dilated, psnr_db, ssim_map};
pub use picture::{ImageError, Picture};
pub use report::{FrameScore, ImageProtocol, ImageReport, MaskedScore, MeanScore};
