//! Layers of settings: a built-in profile, a TOML file, `--set a.b=c`, each over the one before.
//!
//! A layer is checked when it is laid: its error names the layer, the key and, where a key is not
//! known, the nearest one that is.

use m4_io::shortened;
use serde::{Serialize, de::DeserializeOwned};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Why settings could not be put together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// The file could not be read.
    #[error("cannot read the settings {}", path.display())]
    Read {
        /// The file given.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not TOML.
    #[error("{} is not valid TOML: {}", path.display(), shortened(reason))]
    Syntax {
        /// The file given.
        path: PathBuf,
        /// Line, column and what was expected there.
        reason: String,
    },
    /// A `--set` without `=`, or with an empty key.
    #[error("--set {given:?} is not of the form key=value, such as train.iterations=2000")]
    Form {
        /// The argument.
        given: String,
    },
    /// A key that no setting has.
    #[error("{layer}: there is no setting {:?}{}; known here: {}", shortened(key), suggest(suggestion), known.join(", "))]
    UnknownKey {
        /// The file or argument.
        layer: String,
        /// The whole key, dotted.
        key: String,
        /// The nearest known key, dotted.
        suggestion: Option<String>,
        /// The keys known at that place.
        known: Vec<String>,
    },
    /// A value of the wrong type or out of range.
    #[error(
        "{layer}: {} = {} does not work: {}",
        shortened(key),
        shortened(value),
        shortened(reason)
    )]
    BadValue {
        /// The file or argument.
        layer: String,
        /// The whole key, dotted.
        key: String,
        /// The value given.
        value: String,
        /// What would work.
        reason: String,
    },
    /// The built-in settings cannot be written as TOML, a bug of ours.
    #[error("the built-in settings cannot be written as TOML: {reason}")]
    Internal {
        /// What the serialiser said.
        reason: String,
    },
}

fn suggest(nearest: &Option<String>) -> String {
    nearest
        .as_ref()
        .map_or_else(String::new, |key| format!("; did you mean {key:?}?"))
}

/// Settings with their layers so far.
#[derive(Debug, Clone)]
pub struct Layers<T> {
    table: Table,
    value: T,
    /// What the layers over the first one named.
    named: Table,
}

impl<T: Serialize + DeserializeOwned> Layers<T> {
    /// Starts from built-in settings.
    ///
    /// # Errors
    ///
    /// [`SettingsError::Internal`] if `base` cannot be written as TOML.
    pub fn new(base: T) -> Result<Self, SettingsError> {
        let table = Table::try_from(&base).map_err(|e| SettingsError::Internal { reason: e.to_string() })?;
        Ok(Self {
            table,
            value: base,
            named: Table::new(),
        })
    }

    /// Lays a TOML file over what is there.
    ///
    /// # Errors
    ///
    /// [`SettingsError`] naming the file and the key at fault.
    pub fn file(self, path: &Path) -> Result<Self, SettingsError> {
        let text = std::fs::read_to_string(path).map_err(|source| SettingsError::Read {
            path: path.to_path_buf(),
            source,
        })?;
        let layer: Table = text.parse().map_err(|e: toml::de::Error| SettingsError::Syntax {
            path: path.to_path_buf(),
            reason: e.to_string().trim_end().to_owned(),
        })?;
        self.lay(layer, &path.display().to_string())
    }

    /// Lays one `key=value` over what is there. The value is read as TOML; what is not TOML is text.
    ///
    /// # Errors
    ///
    /// [`SettingsError`] naming the argument.
    pub fn set(self, given: &str) -> Result<Self, SettingsError> {
        let form = || SettingsError::Form {
            given: given.to_owned(),
        };
        let (key, text) = given.split_once('=').ok_or_else(form)?;
        let parts: Vec<&str> = key.split('.').map(str::trim).collect();
        if parts.iter().any(|part| part.is_empty()) {
            return Err(form());
        }
        let text = text.trim();
        let value = format!("x = {text}")
            .parse::<Table>()
            .ok()
            .and_then(|mut table| table.remove("x"))
            .unwrap_or_else(|| Value::String(text.to_owned()));
        let layer = parts.iter().rev().fold(value, |inner, &part| {
            Value::Table(Table::from_iter([(part.to_owned(), inner)]))
        });
        match layer {
            Value::Table(layer) => self.lay(layer, &format!("--set {given}")),
            _ => Err(form()),
        }
    }

    /// The settings with every layer laid.
    #[must_use]
    pub fn finish(self) -> T {
        self.value
    }

    /// Whether a file or a `--set` named the key, dotted, whatever value it gave it.
    #[must_use]
    pub fn named(&self, key: &str) -> bool {
        let mut parts = key.split('.');
        let first = parts.next().and_then(|part| self.named.get(part));
        parts
            .fold(first, |at, part| at.and_then(|value| value.get(part)))
            .is_some()
    }

    fn lay(mut self, layer: Table, name: &str) -> Result<Self, SettingsError> {
        merge(&mut self.named, layer.clone());
        merge(&mut self.table, layer);
        self.value = serde_path_to_error::deserialize(self.table.clone())
            .map_err(|e| explain(&e.path().to_string(), e.inner().message(), &self.table, name))?;
        Ok(self)
    }
}

/// Tables are merged key by key; everything else is replaced. A choice between forms (a table with
/// the name of the form as its only key) is replaced when another form is named.
fn merge(base: &mut Table, layer: Table) {
    let other_form = |inner: &Table, over: &Table| {
        inner.len() == 1 && over.len() == 1 && inner.keys().ne(over.keys()) && inner.values().all(Value::is_table)
    };
    for (key, value) in layer {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(over)) if !other_form(inner, &over) => merge(inner, over),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

/// Turns what serde says into a message with a way out.
fn explain(path: &str, message: &str, table: &Table, layer: &str) -> SettingsError {
    let layer = layer.to_owned();
    if message.starts_with("unknown field") {
        let mut quoted = message.split('`').skip(1).step_by(2).map(str::to_owned);
        let key = quoted.next().unwrap_or_default();
        let known: Vec<String> = quoted.collect();
        let parent = path.rsplit_once('.').map_or("", |(parent, _)| parent);
        let dotted = |key: &str| {
            if parent.is_empty() {
                key.to_owned()
            } else {
                format!("{parent}.{key}")
            }
        };
        let suggestion = nearest(&key, &known).map(dotted).or_else(|| elsewhere(&key, table));
        return SettingsError::UnknownKey {
            layer,
            key: dotted(&key),
            suggestion,
            known,
        };
    }
    let value = path
        .split('.')
        .try_fold(Value::Table(table.clone()), |value, part| value.get(part).cloned())
        .map_or_else(String::new, |value| value.to_string());
    SettingsError::BadValue {
        layer,
        key: path.to_owned(),
        value,
        reason: message.to_owned(),
    }
}

/// The known word closest to `key`, if it is close enough to be meant.
fn nearest<'a>(key: &str, known: &'a [String]) -> Option<&'a str> {
    let score = |word: &str| strsim::jaro_winkler(key, word);
    known
        .iter()
        .map(|word| (score(word), word.as_str()))
        .filter(|&(score, _)| score > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, word)| word)
}

/// A setting of that very name in another table, the least deep one: `--set iterations=10` meant
/// `train.iterations`.
fn elsewhere(key: &str, table: &Table) -> Option<String> {
    let mut level: Vec<(String, &Table)> = vec![(String::new(), table)];
    while !level.is_empty() {
        let inner = level.iter().flat_map(|(path, table)| {
            table.iter().filter_map(move |(name, value)| {
                let path = if path.is_empty() {
                    name.clone()
                } else {
                    format!("{path}.{name}")
                };
                Some((path, value.as_table()?))
            })
        });
        level = inner.collect();
        let found = level
            .iter()
            .find(|(_, table)| table.get(key).is_some_and(|v| !v.is_table()));
        if let Some((path, _)) = found {
            return Some(format!("{path}.{key}"));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::{Layers, SettingsError};
    use serde::{Deserialize, Serialize};

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    struct Inner {
        every: u32,
        threshold: f32,
        name: String,
    }

    impl Default for Inner {
        fn default() -> Self {
            Self {
                every: 100,
                threshold: 0.1,
                name: "plain".to_owned(),
            }
        }
    }

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Form {
        Even { step: u32 },
        Random { count: u32, spread: f32 },
        None,
    }

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    struct Outer {
        seed: u64,
        limit: Option<u32>,
        density: Inner,
        form: Form,
    }

    impl Default for Outer {
        fn default() -> Self {
            Self {
                seed: 0,
                limit: None,
                density: Inner::default(),
                form: Form::Even { step: 2 },
            }
        }
    }

    fn layers() -> Layers<Outer> {
        Layers::new(Outer::default()).unwrap()
    }

    #[test]
    fn later_layers_win_and_leave_the_rest() {
        let dir = std::env::temp_dir().join(format!("minute4d-layers-{}", std::process::id()));
        std::fs::write(&dir, "limit = 3\n[density]\nevery = 50\nthreshold = 1").unwrap();
        let got = layers()
            .file(&dir)
            .unwrap()
            .set("density.every=7")
            .unwrap()
            .set("density.name=a b")
            .unwrap();
        std::fs::remove_file(&dir).unwrap();
        let want = Outer {
            limit: Some(3),
            density: Inner {
                every: 7,
                threshold: 1.0,
                name: "a b".to_owned(),
            },
            ..Outer::default()
        };
        assert_eq!(got.finish(), want);
    }

    #[test]
    fn another_form_replaces_the_one_before() {
        let form = |sets: &[&str]| {
            let laid = sets.iter().try_fold(layers(), |layers, given| layers.set(given));
            laid.map(|l| l.finish().form)
        };
        assert_eq!(form(&["form.even.step=5"]).unwrap(), Form::Even { step: 5 });
        let random = form(&["form={random={count=3, spread=1.5}}", "form.random.count=4"]).unwrap();
        assert_eq!(random, Form::Random { count: 4, spread: 1.5 });
        assert_eq!(form(&["form=none"]).unwrap(), Form::None);
        assert!(
            form(&["form.random.count=3"])
                .unwrap_err()
                .to_string()
                .contains("spread")
        );
        assert!(form(&["form=neither"]).unwrap_err().to_string().contains("`even`"));
    }

    #[test]
    fn an_unknown_key_names_the_nearest() {
        let error = layers().set("density.thresold=2").unwrap_err();
        let text = error.to_string();
        assert!(text.contains("there is no setting \"density.thresold\""), "{text}");
        assert!(text.contains("did you mean \"density.threshold\"?"), "{text}");
        let text = layers().set("threshold=2").unwrap_err().to_string();
        assert!(text.contains("did you mean \"density.threshold\"?"), "{text}");
        let text = layers().set("zzz=2").unwrap_err().to_string();
        assert!(
            !text.contains("did you mean") && text.contains("seed, limit, density, form"),
            "{text}"
        );
    }

    #[test]
    fn a_wrong_type_names_key_and_value() {
        let text = layers().set("density.every=often").unwrap_err().to_string();
        assert!(
            text.contains("density.every = \"often\"") && text.contains("u32"),
            "{text}"
        );
        let text = layers().set("density.every=-1").unwrap_err().to_string();
        assert!(text.contains("density.every = -1"), "{text}");
        let text = layers().set("density=3").unwrap_err().to_string();
        assert!(text.contains("density = 3"), "{text}");
    }

    #[test]
    fn a_set_without_a_value_is_refused() {
        for given in ["density.every", "=3", "density..every=3"] {
            assert!(
                matches!(layers().set(given), Err(SettingsError::Form { .. })),
                "{given}"
            );
        }
    }
}
