//! The version of the product: a few operations per splat, in parallel over rows.

use super::reference::gradient;
use crate::Gradients;
use m4_core::{Column, Splats};
use rayon::prelude::*;

/// Rows of a task.
const CHUNK_ROWS: usize = 8192;

/// Adds the gradient of the dynamic splats that `gradients` touch, with this `weight`.
/// Panics if `gradients` are not those of `splats`.
pub fn add(splats: &Splats, gradients: &mut Gradients, weight: f32) {
    let n_static = splats.n_static();
    let opacity = &splats.column(Column::Opacity, 0)[n_static..];
    let touched = &gradients.touched[n_static..];
    for column in &mut gradients.columns[splats.layout().range(Column::LogScale)] {
        column[n_static..]
            .par_chunks_mut(CHUNK_ROWS)
            .zip(
                opacity
                    .par_chunks(CHUNK_ROWS)
                    .zip(touched.par_chunks(CHUNK_ROWS)),
            )
            .for_each(|(column, (opacity, touched))| {
                for ((g, &logit), &touched) in column.iter_mut().zip(opacity).zip(touched) {
                    if touched != 0 {
                        *g += gradient(logit, weight);
                    }
                }
            });
    }
}

#[cfg(test)]
mod tests {
    use super::add;
    use crate::Gradients;
    use crate::cover::reference::gradient;
    use m4_core::{Column, SplatLayout, Splats};
    use m4_testkit::{assert_gradient, central_differences};

    #[test]
    fn opaque_dynamic_splats_that_were_touched_grow() {
        for isotropic in [false, true] {
            let layout = SplatLayout {
                isotropic,
                sh_degree: 0,
                time_degree: 0,
            };
            let mut splats = Splats::zeros(layout, 1, 3);
            // opacities 0.95, 0.05, 0.95
            splats
                .column_mut(Column::Opacity, 0)
                .copy_from_slice(&[3.0, 3.0, -3.0, 3.0]);
            let mut gradients = Gradients {
                columns: splats
                    .columns()
                    .iter()
                    .map(|c| vec![0.5; c.len()])
                    .collect(),
                touched: vec![1, 1, 1, 0],
                ..Gradients::default()
            };
            let before = gradients.columns.clone();
            add(&splats, &mut gradients, 0.01);
            let scales = layout.range(Column::LogScale);
            for (c, (now, before)) in gradients.columns.iter().zip(&before).enumerate() {
                if scales.contains(&c) {
                    let want = 0.5 + gradient(3.0, 0.01) as f32;
                    assert!((now[1] - want).abs() < 1e-7 && (want - 0.490_474).abs() < 1e-5);
                    assert_eq!([now[0], now[2], now[3]], [0.5; 3], "column {c}");
                } else {
                    assert_eq!(now, before, "column {c}");
                }
            }
        }
    }

    /// The loss of the module's formula, of the standard deviations of `splats`; opacities are
    /// those of `held`.
    fn loss(splats: &Splats, held: &Splats, touched: &[u8], weight: f64) -> f64 {
        let mut sum = 0.0;
        for row in (held.n_static()..held.n()).filter(|&row| touched[row] != 0) {
            let opacity = 1.0 / (1.0 + (-f64::from(held.column(Column::Opacity, 0)[row])).exp());
            if opacity > 0.1 {
                let scales = 0..splats.layout().range(Column::LogScale).len();
                sum += scales
                    .map(|k| opacity * f64::from(splats.column(Column::LogScale, k)[row]))
                    .sum::<f64>();
            }
        }
        -weight * sum
    }

    /// Of every column, opacities among them, which are held fixed; central differences are exact
    /// where a loss is linear.
    #[test]
    fn the_gradient_is_that_of_the_loss() {
        const WEIGHT: f32 = 0.25;
        for isotropic in [false, true] {
            let layout = SplatLayout {
                isotropic,
                sh_degree: 0,
                time_degree: 0,
            };
            let mut splats = Splats::zeros(layout, 1, 5);
            // static; opaque, half; 0.11 and 0.09, the sides of the limit; and one that no frame
            // touched
            splats
                .column_mut(Column::Opacity, 0)
                .copy_from_slice(&[3.0, 3.0, 0.0, -2.09, -2.31, 3.0]);
            let touched = vec![1, 1, 1, 1, 1, 0];
            let mut gradients = Gradients {
                columns: splats
                    .columns()
                    .iter()
                    .map(|c| vec![0.0; c.len()])
                    .collect(),
                touched: touched.clone(),
                ..Gradients::default()
            };
            add(&splats, &mut gradients, WEIGHT);
            let start: Vec<f64> = splats
                .columns()
                .iter()
                .flatten()
                .map(|&v| f64::from(v))
                .collect();
            let want = central_differences(&start, 0.5, |values| {
                let mut moved = splats.clone();
                let mut values = values.iter();
                moved
                    .columns_mut()
                    .flatten()
                    .for_each(|v| *v = values.next().copied().unwrap_or(0.0) as f32);
                loss(&moved, &splats, &touched, f64::from(WEIGHT))
            });
            let got: Vec<f64> = gradients
                .columns
                .iter()
                .flatten()
                .map(|&v| f64::from(v))
                .collect();
            assert!(
                want.gradient.iter().filter(|&&g| g != 0.0).count()
                    == if isotropic { 3 } else { 9 }
            );
            assert_gradient("cover", &got, &want.gradient, 1e-6);
        }
    }
}
