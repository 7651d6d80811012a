//! Scores of a set of views, with the protocol that made them.

use super::{
    ImageError, Metric, PlanarImage, PsnrKind, SSIM_SIGMA_PX, SSIM_WINDOW_PX, SsimKind, dilated,
    psnr_db, same_size, ssim_map,
};
use m4_core::Mask;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Method of scoring: two reports compare only if these agree.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ImageProtocol {
    /// Which views were scored, such as `"mill-1 held-out"`.
    pub name: String,
    /// Columns of the scored images, pixels; 0 until the first is added.
    pub width: usize,
    /// Rows of the scored images, pixels; 0 until the first is added.
    pub height: usize,
    /// By how many pixels masks were grown (square structuring element) before use.
    pub mask_dilation_px: usize,
    /// Side of the SSIM window, pixels.
    pub ssim_window_px: usize,
    /// Standard deviation of the SSIM window, pixels.
    pub ssim_sigma_px: f64,
    /// Which windows count: `"valid"`, those that lie wholly inside the image.
    pub ssim_region: String,
    /// Channels share one mean squared error; colours are clamped to 0..1 first.
    pub psnr: String,
    /// Method of the mean line: `"mean over frames"`, of dB values for PSNR.
    pub mean: String,
    /// Meaning of the names in [`FrameScore::others`].
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub others: BTreeMap<String, String>,
}

/// Scores of one view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameScore {
    /// The reference image's name.
    pub name: String,
    /// When it was taken, frames of the training video.
    pub t: f64,
    /// Which held-out camera took it.
    pub camera: Option<u32>,
    /// Whole image, dB.
    pub psnr_db: f64,
    /// Whole image, valid region.
    pub ssim: f64,
    /// Inside the mask, where there was one with any pixel.
    pub masked: Option<MaskedScore>,
    /// Outside the mask, where there was one and it leaves any pixel.
    #[serde(default)]
    pub outside: Option<MaskedScore>,
    /// Scores by other metrics, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub others: BTreeMap<String, f64>,
}

/// Scores inside a mask, or outside it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MaskedScore {
    /// Over these pixels, dB.
    pub psnr_db: f64,
    /// SSIM map averaged over these pixels; `None` if all lie outside the valid region.
    pub ssim: Option<f64>,
    /// Pixels inside or outside the (grown) mask.
    pub pixels: usize,
}

/// Means over frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MeanScore {
    /// Views scored.
    pub frames: usize,
    /// Mean of the whole-image PSNR, dB.
    pub psnr_db: f64,
    /// Mean of the whole-image SSIM.
    pub ssim: f64,
    /// Views with a mask.
    pub masked_frames: usize,
    /// Mean PSNR inside the mask over those views, dB.
    pub masked_psnr_db: Option<f64>,
    /// Mean SSIM inside the mask over those views.
    pub masked_ssim: Option<f64>,
    /// Mean PSNR outside the mask over the views that have one, dB: static content alone.
    #[serde(default)]
    pub static_psnr_db: Option<f64>,
    /// Mean SSIM outside the mask over those views.
    #[serde(default)]
    pub static_ssim: Option<f64>,
}

/// The scores of a set of views of one size.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ImageReport {
    /// Method of scoring.
    pub protocol: ImageProtocol,
    /// One row per view, in the order added.
    pub frames: Vec<FrameScore>,
}

impl ImageReport {
    /// An empty report by the protocol of this crate.
    #[must_use]
    pub fn new(name: impl Into<String>, mask_dilation_px: usize) -> Self {
        let protocol = ImageProtocol {
            name: name.into(),
            width: 0,
            height: 0,
            mask_dilation_px,
            ssim_window_px: SSIM_WINDOW_PX,
            ssim_sigma_px: SSIM_SIGMA_PX,
            ssim_region: "valid".to_owned(),
            psnr: "joint over channels, clamped to 0..1".to_owned(),
            mean: "mean over frames".to_owned(),
            others: BTreeMap::new(),
        };
        Self {
            protocol,
            frames: Vec::new(),
        }
    }

    /// Scores one image; `mask` (not yet grown) is where its dynamic regions are.
    ///
    /// # Errors
    ///
    /// [`ImageError`] if image, mask and reference, or this and earlier views, differ in size, or
    /// SSIM cannot be computed. A failed view leaves the report as it was.
    pub fn add(
        &mut self,
        name: impl Into<String>,
        t: f64,
        camera: Option<u32>,
        image: &PlanarImage,
        reference: &PlanarImage,
        mask: Option<&Mask>,
    ) -> Result<&FrameScore, ImageError> {
        if !self.frames.is_empty() {
            same_size(
                "this view",
                (self.protocol.width, self.protocol.height),
                reference.size(),
            )?;
        }
        let map = ssim_map(SsimKind::GaussianValid, image, reference, None)?;
        let whole = psnr_db(PsnrKind::Joint, image, reference, None)?.unwrap_or(f64::NAN);
        let score = |region: Option<Mask>| -> Result<Option<MaskedScore>, ImageError> {
            let Some(region) = region else {
                return Ok(None);
            };
            let psnr_db = psnr_db(PsnrKind::Joint, image, reference, Some(&region))?;
            Ok(psnr_db.map(|psnr_db| MaskedScore {
                psnr_db,
                ssim: map.mean_inside(&region),
                pixels: region.data().iter().filter(|&&m| m != 0).count(),
            }))
        };
        let mask = mask.map(|mask| dilated(mask, self.protocol.mask_dilation_px));
        let outside = score(
            mask.as_ref()
                .map(|mask| mask.map(|&m| if m == 0 { 255 } else { 0 })),
        )?;
        let masked = score(mask)?;
        (self.protocol.width, self.protocol.height) = reference.size();
        self.frames.push(FrameScore {
            name: name.into(),
            t,
            camera,
            psnr_db: whole,
            ssim: map.mean(),
            masked,
            outside,
            others: BTreeMap::new(),
        });
        Ok(&self.frames[self.frames.len() - 1])
    }

    /// Scores the view that was added last by another metric too, whole or inside `mask` as it is
    /// (not grown); the name then ends in `_masked`. Nothing is kept, and `None` returned, where
    /// the mask leaves nothing.
    ///
    /// # Errors
    ///
    /// As [`Metric::score`].
    pub fn add_metric(
        &mut self,
        metric: Metric,
        image: &PlanarImage,
        reference: &PlanarImage,
        mask: Option<&Mask>,
    ) -> Result<Option<f64>, ImageError> {
        let score = metric.score(image, reference, mask)?;
        let (name, title) = match mask {
            None => (metric.to_string(), metric.title()),
            Some(_) => (
                format!("{metric}_masked"),
                format!("{}, inside a mask", metric.title()),
            ),
        };
        if let Some(score) = score {
            self.add_other(&name, &title, score);
        }
        Ok(score)
    }

    /// Keeps for the view that was added last what something else has scored it, such as
    /// `lpips_alex`; `title` says what that is.
    pub fn add_other(&mut self, name: &str, title: &str, score: f64) {
        if let Some(frame) = self.frames.last_mut() {
            frame.others.insert(name.to_owned(), score);
            self.protocol
                .others
                .insert(name.to_owned(), title.to_owned());
        }
    }

    /// Means of the other metrics over the views that have them, and how many these are.
    #[must_use]
    pub fn mean_others(&self) -> BTreeMap<String, (f64, usize)> {
        let mean = |name: &String| {
            let values = self.frames.iter().filter_map(|f| f.others.get(name));
            let (sum, n) = values.fold((0.0, 0usize), |(sum, n), v| (sum + v, n + 1));
            (name.clone(), (sum / n as f64, n))
        };
        self.protocol.others.keys().map(mean).collect()
    }

    /// Means over all views; `None` if there are none.
    #[must_use]
    pub fn mean(&self) -> Option<MeanScore> {
        self.mean_where(|_| true)
    }

    /// Means over the views, by index, that `counts` chooses; `None` if it chooses none.
    #[must_use]
    pub fn mean_where(&self, counts: impl Fn(usize) -> bool) -> Option<MeanScore> {
        let frames: Vec<&FrameScore> = (0..)
            .zip(&self.frames)
            .filter(|(i, _)| counts(*i))
            .map(|(_, f)| f)
            .collect();
        let mean = |values: Vec<f64>| {
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        let masked: Vec<MaskedScore> = frames.iter().filter_map(|f| f.masked).collect();
        let outside: Vec<MaskedScore> = frames.iter().filter_map(|f| f.outside).collect();
        Some(MeanScore {
            frames: frames.len(),
            psnr_db: mean(frames.iter().map(|f| f.psnr_db).collect())?,
            ssim: mean(frames.iter().map(|f| f.ssim).collect())?,
            masked_frames: masked.len(),
            masked_psnr_db: mean(masked.iter().map(|m| m.psnr_db).collect()),
            masked_ssim: mean(masked.iter().filter_map(|m| m.ssim).collect()),
            static_psnr_db: mean(outside.iter().map(|m| m.psnr_db).collect()),
            static_ssim: mean(outside.iter().filter_map(|m| m.ssim).collect()),
        })
    }

    /// The report as a table for people: one line per view, then the mean, then the protocol.
    #[must_use]
    pub fn table(&self) -> String {
        let cell =
            |v: Option<f64>, digits: usize| v.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
        let row = |name: &str,
                   t: String,
                   psnr: f64,
                   ssim: f64,
                   m_psnr: Option<f64>,
                   m_ssim: Option<f64>| {
            let (m_psnr, m_ssim) = (cell(m_psnr, 2), cell(m_ssim, 4));
            format!("{name:<28} {t:>7} {psnr:>8.2} {ssim:>7.4} {m_psnr:>9} {m_ssim:>9}\n")
        };
        let mut out = format!(
            "{:<28} {:>7} {:>8} {:>7} {:>9} {:>9}\n",
            "view", "t", "PSNR dB", "SSIM", "mask PSNR", "mask SSIM"
        );
        for f in &self.frames {
            let m = f.masked;
            let t = format!("{:.1}", f.t);
            out += &row(
                &f.name,
                t,
                f.psnr_db,
                f.ssim,
                m.map(|m| m.psnr_db),
                m.and_then(|m| m.ssim),
            );
        }
        if let Some(m) = self.mean() {
            out += &row(
                "mean",
                String::new(),
                m.psnr_db,
                m.ssim,
                m.masked_psnr_db,
                m.masked_ssim,
            );
        }
        let p = &self.protocol;
        for (name, (mean, views)) in self.mean_others() {
            let title = p.others.get(&name).map_or("", String::as_str);
            // into a text, which cannot fail
            let _ = writeln!(
                out,
                "{name:<28} {mean:>16.4}  mean of {views} views: {title}"
            );
        }
        out += &format!(
            "protocol: {}, {}x{}, PSNR {}, SSIM {} window {} sd {} px, masks grown by {} px\n",
            p.name,
            p.width,
            p.height,
            p.psnr,
            p.ssim_region,
            p.ssim_window_px,
            p.ssim_sigma_px,
            p.mask_dilation_px
        );
        out
    }
}

#[cfg(test)]
mod tests {
    use super::ImageReport;
    use crate::image::metric::flat;
    use crate::image::{Metric, PsnrKind};
    use m4_core::Plane;

    #[test]
    fn means_are_over_frames_and_over_masked_frames() {
        let mut report = ImageReport::new("unit", 1);
        let mask = Plane::from_fn(16, 16, |x, y| if (x, y) == (8, 8) { 255 } else { 0 });
        let none = Plane::filled(16, 16, 0u8);
        let reference = flat(16, 16, 0.5);
        report
            .add("a", 0.0, None, &flat(16, 16, 0.6), &reference, Some(&mask))
            .unwrap();
        report
            .add(
                "b",
                1.0,
                Some(1),
                &flat(16, 16, 0.51),
                &reference,
                Some(&none),
            )
            .unwrap();
        let mean = report.mean().unwrap();
        assert!((mean.psnr_db - 30.0).abs() < 1e-3, "{mean:?}");
        assert_eq!((mean.frames, mean.masked_frames), (2, 1));
        assert!((mean.masked_psnr_db.unwrap() - 20.0).abs() < 1e-3);
        assert_eq!(report.frames[0].masked.unwrap().pixels, 9);
        assert_eq!(
            (report.protocol.width, report.protocol.mask_dilation_px),
            (16, 1)
        );
        let table = report.table();
        assert!(table.contains("mean") && table.contains("30.00"), "{table}");
        let text = serde_json::to_string(&report).unwrap();
        assert_eq!(serde_json::from_str::<ImageReport>(&text).unwrap(), report);
        assert!(!text.contains("others"), "{text}");
        assert!(ImageReport::new("none", 0).mean().is_none());
    }

    #[test]
    fn a_view_of_another_size_is_refused_and_leaves_no_trace() {
        let mut report = ImageReport::new("unit", 0);
        report
            .add("a", 0.0, None, &flat(16, 16, 0.6), &flat(16, 16, 0.5), None)
            .unwrap();
        let other = report.add("b", 0.0, None, &flat(20, 16, 0.6), &flat(20, 16, 0.5), None);
        assert!(
            other
                .unwrap_err()
                .to_string()
                .contains("the reference is 16x16")
        );
        assert_eq!(report.frames.len(), 1);
    }

    #[test]
    fn extra_metrics_are_reported_by_name_with_means() {
        let mut report = ImageReport::new("unit", 0);
        let per_channel = Metric::Psnr(PsnrKind::PerChannel);
        let reference = flat(16, 16, 0.5);
        let mask = Plane::from_fn(16, 16, |x, _| u8::from(x == 3));
        for (name, value) in [("a", 0.6), ("b", 0.51)] {
            let image = flat(16, 16, value);
            report
                .add(name, 0.0, None, &image, &reference, None)
                .unwrap();
            report
                .add_metric(per_channel, &image, &reference, None)
                .unwrap();
            let none = Plane::filled(16, 16, 0);
            let mask = if name == "a" { &mask } else { &none };
            report
                .add_metric(per_channel, &image, &reference, Some(mask))
                .unwrap();
        }
        report.add_other("lpips_alex", "LPIPS 0.1 with AlexNet", 0.25);
        let means = report.mean_others();
        assert!(
            (means["psnr_per_channel"].0 - 30.0).abs() < 1e-3 && means["psnr_per_channel"].1 == 2
        );
        assert!(
            (means["psnr_per_channel_masked"].0 - 20.0).abs() < 1e-3
                && means["psnr_per_channel_masked"].1 == 1
        );
        assert_eq!(means["lpips_alex"], (0.25, 1));
        assert_eq!(report.frames[0].others.len(), 2);
        let table = report.table();
        assert!(
            table.contains("mean of 1 views: LPIPS 0.1 with AlexNet"),
            "{table}"
        );
        let text = serde_json::to_string(&report).unwrap();
        let back = serde_json::from_str::<ImageReport>(&text).unwrap();
        assert_eq!(
            (back.protocol, back.frames[1].others.len()),
            (report.protocol, 2)
        );
    }
}
