//! Splats that are bound to nodes: the first dynamic rows (docs/spec/scaffold.md 2).

use super::Splats;
use crate::{Binding, ShapeError, Window};
use std::{ops::Range, sync::Arc};

impl Splats {
    /// Binds the first dynamic rows, one per binding, to nodes of `windows`. Fails with
    /// [`ShapeError`] if there are more bindings than dynamic rows, or a window or node does not
    /// exist.
    pub fn bind(
        &mut self,
        windows: Arc<Vec<Window>>,
        bindings: Vec<Binding>,
    ) -> Result<(), ShapeError> {
        if bindings.len() > self.n_dynamic {
            return Err(ShapeError {
                what: "bindings",
                expected: self.n_dynamic,
                found: bindings.len(),
            });
        }
        for binding in &bindings {
            let nodes = windows
                .get(binding.window as usize)
                .map_or(0, |w| w.anchors().len());
            if let Some(&node) = binding
                .nodes
                .iter()
                .find(|&&node| usize::from(node) >= nodes)
            {
                return Err(ShapeError {
                    what: "binding: node",
                    expected: nodes,
                    found: usize::from(node),
                });
            }
        }
        (self.windows, self.bindings) = (windows, bindings);
        Ok(())
    }

    /// The windows that bound splats move with.
    pub fn windows(&self) -> &Arc<Vec<Window>> {
        &self.windows
    }

    /// The windows that bound splats move with.
    pub fn windows_mut(&mut self) -> &mut Vec<Window> {
        Arc::make_mut(&mut self.windows)
    }

    /// Bindings of the bound splats: rows `n_static..n_static + bindings.len()`.
    pub fn bindings(&self) -> &[Binding] {
        &self.bindings
    }

    /// Rows of bound splats.
    pub fn bound(&self) -> Range<usize> {
        self.n_static..self.n_static + self.bindings.len()
    }

    pub(super) fn gather_bindings(&self, rows: &[u32]) -> Vec<Binding> {
        let bound = |r: &u32| {
            (*r as usize)
                .checked_sub(self.n_static)
                .and_then(|k| self.bindings.get(k))
        };
        rows.iter().filter_map(bound).copied().collect()
    }
}
