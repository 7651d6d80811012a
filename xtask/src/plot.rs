//! PSNR over seconds, as an image.

use anyhow::{Result, anyhow};
use plotters::prelude::*;
use std::path::Path;

/// Points of one curve: seconds and decibels.
pub struct Curve {
    /// What it is called in the legend.
    pub name: String,
    /// In order of time.
    pub points: Vec<(f64, f64)>,
}

/// Draws curves over a logarithmic axis of seconds into an SVG file.
///
/// # Errors
///
/// If there is no point, or the file cannot be written.
pub fn time_to_quality(path: &Path, curves: &[Curve]) -> Result<()> {
    let all = || curves.iter().flat_map(|c| &c.points);
    let range = |pick: fn(&(f64, f64)) -> f64| {
        all().map(pick).fold(None, |r: Option<(f64, f64)>, v| Some(r.map_or((v, v), |(a, b)| (a.min(v), b.max(v)))))
    };
    let (Some(x), Some(y)) = (range(|p| p.0), range(|p| p.1)) else {
        return Err(anyhow!("nothing to plot"));
    };
    let failed = |e: &dyn std::fmt::Display| anyhow!("{}: {e}", path.display());
    let root = SVGBackend::new(path, (860, 480)).into_drawing_area();
    root.fill(&WHITE).map_err(|e| failed(&e))?;
    let mut chart = ChartBuilder::on(&root)
        .margin(16)
        .x_label_area_size(56)
        .y_label_area_size(68)
        .build_cartesian_2d((0.9 * x.0..1.1 * x.1).log_scale(), y.0 - 0.5..y.1 + 0.5)
        .map_err(|e| failed(&e))?;
    chart
        .configure_mesh()
        .x_desc("seconds of optimisation")
        .y_desc("PSNR of held-out views, dB")
        .x_label_formatter(&|s| format!("{s:.0}"))
        .light_line_style(TRANSPARENT)
        .label_style(("sans-serif", 18))
        .axis_desc_style(("sans-serif", 18))
        .draw()
        .map_err(|e| failed(&e))?;
    for (i, curve) in curves.iter().enumerate() {
        let colour = Palette99::pick(i).stroke_width(2);
        chart
            .draw_series(LineSeries::new(curve.points.iter().copied(), colour).point_size(3))
            .map_err(|e| failed(&e))?
            .label(&curve.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::MiddleRight)
        .label_font(("sans-serif", 17))
        .background_style(WHITE)
        .border_style(BLACK.mix(0.2))
        .draw()
        .map_err(|e| failed(&e))?;
    root.present().map_err(|e| failed(&e))
}

#[cfg(test)]
mod tests {
    use super::{Curve, time_to_quality};

    #[test]
    fn curves_are_plotted_and_an_empty_table_is_rejected() {
        let path = std::env::temp_dir().join(format!("minute4d-plot-{}.svg", std::process::id()));
        let curve = Curve { name: "fast".to_owned(), points: vec![(5.0, 27.0), (60.0, 31.0)] };
        time_to_quality(&path, &[curve]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!(text.contains("<polyline") && text.contains("fast"));
        assert!(time_to_quality(&path, &[]).is_err());
    }
}
