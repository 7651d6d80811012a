//! Image metrics: PSNR and SSIM of a rendering against a photograph, whole and inside a mask, in
//! the variants that papers report.
//!
//! ```text
//! image, photograph, mask --Metric--> a number;  many --ImageReport--> rows, means, the protocol's name
//! depth of the training frames --covisible--> the mask of pixels that they saw
//! ```
//!
//! Colours are sRGB values in `[0, 1]`; both sides are clamped to it first unless a protocol says
//! otherwise ([`PlanarImage::from_planes_unclamped`]). What this crate reports by default is PSNR
//! joint over channels and SSIM over an 11x11 Gaussian window in the valid region
//! ([`PsnrKind::Joint`], [`SsimKind::GaussianValid`]); inside a mask, PSNR takes the pixels of the
//! mask and SSIM averages the map over those of its pixels that lie in the valid region. The other
//! flavours are named by [`PsnrKind`] and [`SsimKind`], and a report says which it holds. LPIPS is
//! `m4_nets::lpips`: it needs a network.

mod aligned;
pub mod covisible;
mod metric;
mod report;
mod ssim;

pub use aligned::{Shift, best_shift};
pub use metric::{ImageError, MAX_PSNR_DB, Metric, PlanarImage, PsnrKind, dilated, psnr_db};
pub use report::{FrameScore, ImageProtocol, ImageReport, MaskedScore, MeanScore};
pub use ssim::{SSIM_SIGMA_PX, SSIM_WINDOW_PX, SsimKind, SsimMap, ssim, ssim_map};

use metric::{check_sizes, same_size};
