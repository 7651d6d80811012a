//! The arrays of nested dictionaries, each once.

use super::{Array, Machine, Refused, Value};
use std::collections::{BTreeMap, BTreeSet};

/// Most dictionaries within one another.
const MAX_DEPTH: usize = 8;

impl<'a> Machine<'a> {
    /// What the dictionary on the stack holds.
    pub(super) fn finish(mut self) -> Result<BTreeMap<String, Array<'a>>, Refused> {
        if self.at != self.file.len() {
            return Err(self.refused("something comes after the end"));
        }
        let root = self.pop()?;
        let (Value::Dict(root), true) = (root, self.stack.is_empty()) else {
            return Err(self.refused("what was pickled is not a dictionary"));
        };
        let mut found = BTreeMap::new();
        let mut seen = BTreeSet::from([root]);
        let mut open = vec![(root, String::new(), 1)];
        while let Some((dict, prefix, depth)) = open.pop() {
            let entries = std::mem::take(&mut self.dicts[dict]);
            let mut keys = BTreeSet::new();
            for (key, value) in entries {
                if !keys.insert(key) {
                    return Err(self.refused("a key is there twice"));
                }
                let name = format!("{prefix}{key}");
                match value {
                    Value::Dict(inner) if depth < MAX_DEPTH && seen.insert(inner) => {
                        open.push((inner, name + "/", depth + 1));
                    }
                    Value::Dict(_) => {
                        return Err(self.refused("dictionaries lie in one another too deep, or in two places"));
                    }
                    Value::Array(array) => {
                        let array = self.arrays[array].take();
                        let array = array.ok_or_else(|| self.refused("an array is empty or in two places"))?;
                        if found.insert(name, array).is_some() {
                            return Err(self.refused("a name is there twice"));
                        }
                    }
                    _ => return Err(self.refused("a dictionary holds something that is not an array")),
                }
            }
        }
        Ok(found)
    }
}
