//! 4D Gaussians in columns.
//!
//! A splat is *static* (it has no time parameters at all) or *dynamic*: then it also has a middle
//! of its life, a duration and a velocity (docs/spec/optimiser.md 1.4):
//!
//! ```text
//! m(t) = mean + velocity (t - time_mean)          S = Q diag(exp(2 log_scale)) Q^T
//! p(t) = exp(-(t - time_mean)^2 / (2 exp(2 log_time_sd)))      opacity(t) = sigmoid(opacity) p(t)
//! ```
//!
//! Rows `0..n_static` are static, the dynamic rows follow: first those that are bound to nodes,
//! which carry them ([`Binding`]), then free ones. Every column is one `Vec<f32>`, so a kernel
//! streams what it needs and a re-ordering is the same gather for each column.

mod bound;

use crate::{Binding, ShapeError, Window};
use std::{ops::Range, sync::Arc};

/// Which columns a set of splats has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SplatLayout {
    /// One scale and no rotation per splat, instead of three scales and a quaternion.
    pub isotropic: bool,
    /// Degree of the spatial harmonics of the colour, 0..=3.
    pub sh_degree: usize,
    /// Highest temporal harmonic of the colour, 0..=2.
    pub time_degree: usize,
}

impl SplatLayout {
    /// Spatial harmonics a colour channel: `(sh_degree + 1)^2`.
    pub fn sh_terms(&self) -> usize {
        (self.sh_degree + 1) * (self.sh_degree + 1)
    }

    /// Colour coefficients per channel: spatial terms times temporal terms, temporal index major.
    pub fn colour_terms(&self) -> usize {
        self.sh_terms() * (self.time_degree + 1)
    }

    /// Columns that every splat has.
    pub fn shared_columns(&self) -> usize {
        self.column(Column::TimeMean)
    }

    /// All columns, those of dynamic splats included.
    pub fn columns(&self) -> usize {
        self.shared_columns() + 8
    }

    /// Index of the first (for vectors: the x or w) column of a parameter.
    pub fn column(&self, column: Column) -> usize {
        let shape = if self.isotropic { 1 } else { 3 + 4 };
        match column {
            Column::Mean => 0,
            Column::LogScale => 3,
            Column::Quat => 3 + if self.isotropic { 1 } else { 3 },
            Column::Opacity => 3 + shape,
            Column::Colour => 4 + shape,
            Column::TimeMean => 4 + shape + 3 * self.colour_terms(),
            Column::LogTimeSd => 5 + shape + 3 * self.colour_terms(),
            Column::Velocity => 6 + shape + 3 * self.colour_terms(),
            Column::Trend => 9 + shape + 3 * self.colour_terms(),
        }
    }

    /// The columns of a parameter; empty for the quaternion of isotropic splats.
    pub fn range(&self, column: Column) -> Range<usize> {
        let start = self.column(column);
        let (scales, quats) = if self.isotropic { (1, 0) } else { (3, 4) };
        let len = match column {
            Column::Mean | Column::Velocity | Column::Trend => 3,
            Column::LogScale => scales,
            Column::Quat => quats,
            Column::Colour => 3 * self.colour_terms(),
            Column::Opacity | Column::TimeMean | Column::LogTimeSd => 1,
        };
        start..start + len
    }
}

/// A parameter of a splat. Lengths of columns: [`Splats::n`] for the first five, the number of
/// dynamic splats for the last three.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Column {
    /// 3 columns: x, y, z of the mean (of a dynamic splat: at `time_mean`), world units.
    Mean,
    /// 3 columns (isotropic: 1): natural logarithm of the standard deviation, world units.
    LogScale,
    /// 4 columns (isotropic: none): rotation as `(w, x, y, z)` of any length but 0.
    Quat,
    /// 1 column: logit of the opacity.
    Opacity,
    /// 3 x `colour_terms` columns, index `3 * term + channel`,
    /// `term = temporal * sh_terms + spatial`.
    Colour,
    /// 1 column, dynamic: the middle of the splat's life, frames.
    TimeMean,
    /// 1 column, dynamic: natural logarithm of the standard deviation in time, frames.
    LogTimeSd,
    /// 3 columns, dynamic: world units per frame.
    Velocity,
    /// 3 columns, dynamic: change of the colour a frame.
    Trend,
}

/// A set of splats: the static ones first.
#[derive(Debug, PartialEq)]
pub struct Splats {
    layout: SplatLayout,
    n_static: usize,
    n_dynamic: usize,
    columns: Vec<Vec<f32>>,
    /// Of the first dynamic rows.
    bindings: Vec<Binding>,
    windows: Arc<Vec<Window>>,
}

impl Clone for Splats {
    fn clone(&self) -> Self {
        Self {
            layout: self.layout,
            n_static: self.n_static,
            n_dynamic: self.n_dynamic,
            columns: self.columns.clone(),
            bindings: self.bindings.clone(),
            windows: self.windows.clone(),
        }
    }

    /// Uses the memory that is there.
    fn clone_from(&mut self, source: &Self) {
        self.layout = source.layout;
        (self.n_static, self.n_dynamic) = (source.n_static, source.n_dynamic);
        self.columns.clone_from(&source.columns);
        self.bindings.clone_from(&source.bindings);
        self.windows.clone_from(&source.windows);
    }
}

impl Splats {
    /// Splats with every parameter 0.
    pub fn zeros(layout: SplatLayout, n_static: usize, n_dynamic: usize) -> Self {
        let shared = layout.shared_columns();
        let columns = (0..layout.columns())
            .map(|c| {
                vec![
                    0.0;
                    if c < shared {
                        n_static + n_dynamic
                    } else {
                        n_dynamic
                    }
                ]
            })
            .collect();
        Self {
            layout,
            n_static,
            n_dynamic,
            columns,
            bindings: Vec::new(),
            windows: Arc::default(),
        }
    }

    /// Takes columns in the order of [`SplatLayout::column`].
    /// Fails with [`ShapeError`] if a column is missing or has the wrong length.
    pub fn from_columns(
        layout: SplatLayout,
        n_static: usize,
        n_dynamic: usize,
        columns: Vec<Vec<f32>>,
    ) -> Result<Self, ShapeError> {
        ShapeError::check("columns", layout.columns(), columns.len())?;
        let shared = layout.shared_columns();
        for (c, column) in columns.iter().enumerate() {
            let expected = if c < shared {
                n_static + n_dynamic
            } else {
                n_dynamic
            };
            ShapeError::check("column", expected, column.len())?;
        }
        Ok(Self {
            layout,
            n_static,
            n_dynamic,
            columns,
            bindings: Vec::new(),
            windows: Arc::default(),
        })
    }

    /// Which columns there are.
    pub fn layout(&self) -> SplatLayout {
        self.layout
    }

    /// The number of them.
    pub fn n(&self) -> usize {
        self.n_static + self.n_dynamic
    }

    /// Number of splats without time parameters: rows `0..n_static` of the shared columns.
    pub fn n_static(&self) -> usize {
        self.n_static
    }

    /// Number of splats with time parameters: row `i` of a time column is row `n_static + i` of the
    /// others.
    pub fn n_dynamic(&self) -> usize {
        self.n_dynamic
    }

    /// Every column.
    pub fn columns(&self) -> &[Vec<f32>] {
        &self.columns
    }

    /// Every column; lengths cannot change.
    pub fn columns_mut(&mut self) -> impl ExactSizeIterator<Item = &mut [f32]> {
        self.columns.iter_mut().map(Vec::as_mut_slice)
    }

    /// Column `offset` of a parameter.
    pub fn column(&self, column: Column, offset: usize) -> &[f32] {
        &self.columns[self.layout.column(column) + offset]
    }

    /// Column `offset` of a parameter.
    pub fn column_mut(&mut self, column: Column, offset: usize) -> &mut [f32] {
        &mut self.columns[self.layout.column(column) + offset]
    }

    /// The rows named, in that order; a row may be named more than once. Static rows must come
    /// first. Fails with [`ShapeError`] if a row does not exist or a static row follows a dynamic
    /// one.
    pub fn gather(&self, rows: &[u32]) -> Result<Self, ShapeError> {
        let (n_static, n_dynamic) = self.check_rows(rows)?;
        let mut columns = Vec::with_capacity(self.columns.len());
        for (c, column) in self.columns.iter().enumerate() {
            let mut gathered = Vec::new();
            self.gather_column(rows, n_static, c, column, &mut gathered);
            columns.push(gathered);
        }
        let bindings = self.gather_bindings(rows);
        Ok(Self {
            layout: self.layout,
            n_static,
            n_dynamic,
            columns,
            bindings,
            windows: self.windows.clone(),
        })
    }

    /// Becomes [`gather`](Self::gather) of itself, one column after the other: with memory for one
    /// more column instead of all. Fails as [`gather`](Self::gather); nothing is changed then.
    pub fn rearrange(&mut self, rows: &[u32]) -> Result<(), ShapeError> {
        let (n_static, n_dynamic) = self.check_rows(rows)?;
        let mut columns = std::mem::take(&mut self.columns);
        let mut spare = Vec::new();
        for (c, column) in columns.iter_mut().enumerate() {
            self.gather_column(rows, n_static, c, column, &mut spare);
            std::mem::swap(column, &mut spare);
        }
        self.columns = columns;
        self.bindings = self.gather_bindings(rows);
        (self.n_static, self.n_dynamic) = (n_static, n_dynamic);
        Ok(())
    }

    /// Number of static and of dynamic rows among those named.
    fn check_rows(&self, rows: &[u32]) -> Result<(usize, usize), ShapeError> {
        let n_static = rows
            .iter()
            .take_while(|&&r| (r as usize) < self.n_static)
            .count();
        let free = rows[n_static..]
            .iter()
            .skip_while(|&&r| self.bound().contains(&(r as usize)));
        if let Some(&r) = free
            .clone()
            .find(|&&r| self.bound().contains(&(r as usize)))
        {
            return Err(ShapeError {
                what: "gather: bound row",
                expected: self.n(),
                found: r as usize,
            });
        }
        for &r in &rows[n_static..] {
            if (r as usize) < self.n_static || r as usize >= self.n() {
                return Err(ShapeError {
                    what: "gather: row",
                    expected: self.n(),
                    found: r as usize,
                });
            }
        }
        Ok((n_static, rows.len() - n_static))
    }

    /// Fills `out` with the rows named of column `c`.
    fn gather_column(
        &self,
        rows: &[u32],
        n_static: usize,
        c: usize,
        column: &[f32],
        out: &mut Vec<f32>,
    ) {
        out.clear();
        if c < self.layout.shared_columns() {
            out.extend(rows.iter().map(|&r| column[r as usize]));
        } else {
            out.extend(
                rows[n_static..]
                    .iter()
                    .map(|&r| column[r as usize - self.n_static]),
            );
        }
    }

    /// Has at least these degrees of the harmonics of the colour from here on; coefficients that
    /// are added are 0, so that nothing looks different.
    pub fn raise_degrees(&mut self, sh_degree: usize, time_degree: usize) {
        let (old, n) = (self.layout, self.n());
        let new = SplatLayout {
            sh_degree: sh_degree.max(old.sh_degree),
            time_degree: time_degree.max(old.time_degree),
            ..old
        };
        let mut rest = std::mem::take(&mut self.columns).into_iter();
        let mut columns: Vec<Vec<f32>> = rest.by_ref().take(new.column(Column::Colour)).collect();
        for term in 0..new.colour_terms() {
            let (temporal, spatial) = (term / new.sh_terms(), term % new.sh_terms());
            let exists = temporal <= old.time_degree && spatial < old.sh_terms();
            for _ in 0..3 {
                columns.extend(if exists {
                    rest.next()
                } else {
                    Some(vec![0.0; n])
                });
            }
        }
        columns.extend(rest);
        (self.layout, self.columns) = (new, columns);
    }

    /// True when every parameter is a finite number.
    pub fn is_finite(&self) -> bool {
        self.columns.iter().flatten().all(|v| v.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::{Column, SplatLayout, Splats};

    #[test]
    fn columns_are_contiguous_for_every_layout() {
        for isotropic in [false, true] {
            for sh_degree in 0..=3 {
                for time_degree in 0..=2 {
                    let layout = SplatLayout {
                        isotropic,
                        sh_degree,
                        time_degree,
                    };
                    let order = [
                        Column::Mean,
                        Column::LogScale,
                        Column::Quat,
                        Column::Opacity,
                        Column::Colour,
                        Column::TimeMean,
                        Column::LogTimeSd,
                        Column::Velocity,
                        Column::Trend,
                    ];
                    let mut next = 0;
                    for column in order {
                        assert_eq!(layout.range(column).start, next, "{column:?} of {layout:?}");
                        next = layout.range(column).end;
                    }
                    assert_eq!(next, layout.columns());
                }
            }
        }
    }

    #[test]
    fn raised_degrees_keep_every_coefficient() {
        let start = SplatLayout {
            isotropic: true,
            sh_degree: 1,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(start, 1, 1);
        for (value, column) in splats.columns_mut().enumerate() {
            column.fill(1.0 + value as f32);
        }
        let before = splats.clone();
        splats.raise_degrees(0, 0);
        assert_eq!(splats, before);
        splats.raise_degrees(2, 1);
        let layout = SplatLayout {
            sh_degree: 2,
            time_degree: 1,
            ..start
        };
        assert_eq!(splats.layout(), layout);
        let columns = splats.columns().to_vec();
        assert_eq!(
            Splats::from_columns(layout, 1, 1, columns),
            Ok(splats.clone()),
            "columns have their lengths"
        );
        for c in 0..3 * 4 {
            assert_eq!(
                splats.column(Column::Colour, c),
                before.column(Column::Colour, c)
            );
        }
        for c in 3 * 4..3 * 18 {
            assert_eq!(splats.column(Column::Colour, c), [0.0, 0.0]);
        }
        for column in [
            Column::Mean,
            Column::Opacity,
            Column::TimeMean,
            Column::Velocity,
        ] {
            assert_eq!(splats.column(column, 0), before.column(column, 0));
        }
        // the index of time is major: terms of direction that are added now lie between the others
        let second = splats.layout().column(Column::Colour) + 3 * 9;
        splats.columns[second].fill(7.0);
        splats.raise_degrees(3, 1);
        assert_eq!(splats.column(Column::Colour, 3 * 16), [7.0, 7.0]);
    }

    #[test]
    fn gather_keeps_static_rows_first() {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, 2, 2);
        splats
            .column_mut(Column::Opacity, 0)
            .copy_from_slice(&[0.0, 1.0, 2.0, 3.0]);
        splats
            .column_mut(Column::TimeMean, 0)
            .copy_from_slice(&[20.0, 30.0]);
        let picked = splats.gather(&[1, 3, 3]).unwrap();
        assert_eq!((picked.n_static(), picked.n_dynamic()), (1, 2));
        assert_eq!(picked.column(Column::Opacity, 0), &[1.0, 3.0, 3.0]);
        assert_eq!(picked.column(Column::TimeMean, 0), &[30.0, 30.0]);
        let mut moved = splats.clone();
        moved.rearrange(&[1, 3, 3]).unwrap();
        assert_eq!(moved, picked);
        moved.clone_from(&splats);
        assert!(moved.rearrange(&[3, 0]).is_err());
        assert_eq!(moved, splats, "a failure changes nothing");
        assert!(splats.gather(&[3, 0]).is_err() && splats.gather(&[4]).is_err());
    }
}
