//! Layers of settings: a built-in profile, a TOML file, `--set a.b=c`, each over the one before.
//!
//! A layer is checked when it is laid: its error names the layer, the key and, where a key is not
//! known, the nearest one that is.

use super::ranges::out_of_range;
use super::{Profile, Settings};
use m4_io::{files, shortened};
use m4_train::TrainError;
use m4_train::init::InitError;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Largest file of settings that is read, bytes: one with every key and comments has some
/// kilobytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// What files and `--set` say, later ones over earlier ones; [`Self::over`] lays it over built-in
/// settings.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    named: Table,
}

impl Layers {
    /// Lays a TOML file over what is there.
    ///
    /// # Errors
    ///
    /// [`SettingsError`] naming the file and the key at fault.
    pub fn file(self, path: &Path) -> Result<Self, SettingsError> {
        let text =
            files::read_text(path, MAX_FILE_BYTES).map_err(|source| SettingsError::Read {
                path: path.to_path_buf(),
                source,
            })?;
        let layer: Table = text.parse().map_err(|e: toml::de::Error| {
            let reason = shortened(e.to_string().trim_end());
            SettingsError::Invalid(format!("{} is not valid TOML: {reason}", path.display()))
        })?;
        self.lay(layer, &path.display().to_string())
    }

    /// Lays one `key=value` over what is there. The value is read as TOML; what is not TOML is
    /// text.
    ///
    /// # Errors
    ///
    /// [`SettingsError`] naming the argument.
    pub fn set(self, assignment: &str) -> Result<Self, SettingsError> {
        let form = || {
            let what = "is not of the form key=value, such as train.iterations=2000";
            SettingsError::Invalid(format!("{assignment:?} {what}"))
        };
        let (key, text) = assignment.split_once('=').ok_or_else(form)?;
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
            Value::Table(layer) => self.lay(layer, assignment),
            _ => Err(form()),
        }
    }

    /// The profile that a layer names.
    pub fn profile(&self) -> Option<Profile> {
        self.named.get("profile")?.clone().try_into().ok()
    }

    /// The settings `base` with every layer over them.
    ///
    /// # Errors
    ///
    /// [`SettingsError::Invalid`] if the layers name another profile than `base` has.
    pub fn over(&self, base: &Settings) -> Result<Settings, SettingsError> {
        if let Some(named) = self.profile().filter(|named| *named != base.profile) {
            return Err(SettingsError::Invalid(format!(
                "a settings file or key names profile = {:?}, and {:?} was asked for; leave one of them out",
                named.name(),
                base.profile.name()
            )));
        }
        read(&self.table_over(base)?, "the settings")
    }

    /// The built-in settings of the profile that a layer names, else of the default one, with every
    /// layer over them.
    ///
    /// # Errors
    ///
    /// [`SettingsError::Internal`] if they cannot be written as TOML.
    pub fn finish(&self) -> Result<Settings, SettingsError> {
        self.over(&Settings::of(self.profile().unwrap_or_default()))
    }

    /// Whether a file or a `--set` named the key, dotted, whatever value it gave it.
    pub fn named(&self, key: &str) -> bool {
        let mut parts = key.split('.');
        let first = parts.next().and_then(|part| self.named.get(part));
        parts
            .fold(first, |at, part| at.and_then(|value| value.get(part)))
            .is_some()
    }

    fn lay(mut self, layer: Table, name: &str) -> Result<Self, SettingsError> {
        merge(&mut self.named, layer);
        let base = Settings::of(self.profile().unwrap_or_default());
        read(&self.table_over(&base)?, name)?;
        Ok(self)
    }

    fn table_over(&self, base: &Settings) -> Result<Table, SettingsError> {
        let mut table = table(base)?;
        merge(&mut table, self.named.clone());
        Ok(table)
    }
}

/// The settings in `table`, whose last layer is called `layer`. The seed of the training is that of
/// geometry, too.
fn read(table: &Table, layer: &str) -> Result<Settings, SettingsError> {
    let mut settings: Settings = serde_path_to_error::deserialize(table.clone())
        .map_err(|e| explain(&e.path().to_string(), e.inner().message(), table, layer))?;
    in_range(table, layer)?;
    settings.set_seed(settings.train.seed);
    Ok(settings)
}

/// The settings as a table.
pub(super) fn table(settings: &Settings) -> Result<Table, SettingsError> {
    Table::try_from(settings).map_err(|e| SettingsError::Internal {
        reason: e.to_string(),
    })
}

/// Refuses numbers out of their range; `layer` says where they come from.
pub(super) fn in_range(settings: &Table, layer: &str) -> Result<(), SettingsError> {
    let Some((key, value, range)) = out_of_range(settings) else {
        return Ok(());
    };
    Err(SettingsError::Invalid(format!(
        "{layer}: {key} = {value} is out of range: it must be {range}"
    )))
}

/// Tables are merged key by key; everything else is replaced.
fn merge(base: &mut Table, layer: Table) {
    for (key, value) in layer {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(over)) => merge(inner, over),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

/// Turns what serde says into a message with a way out.
fn explain(path: &str, message: &str, table: &Table, layer: &str) -> SettingsError {
    if message.starts_with("unknown field") {
        let mut quoted = message.split('`').skip(1).step_by(2).map(str::to_owned);
        let key = quoted.next().unwrap_or_default();
        let known_keys: Vec<String> = quoted.collect();
        let parent = path.rsplit_once('.').map_or("", |(parent, _)| parent);
        let dotted = |key: &str| {
            if parent.is_empty() {
                key.to_owned()
            } else {
                format!("{parent}.{key}")
            }
        };
        let suggestion = nearest(&key, &known_keys)
            .map(dotted)
            .or_else(|| elsewhere(&key, table))
            .filter(|other| *other != dotted(&key));
        return SettingsError::UnknownKey {
            layer: layer.to_owned(),
            key: dotted(&key),
            suggestion,
            known: known_keys,
        };
    }
    let value = path
        .split('.')
        .try_fold(Value::Table(table.clone()), |value, part| {
            value.get(part).cloned()
        })
        .map_or_else(String::new, |value| value.to_string());
    let (key, value, reason) = (shortened(path), shortened(&value), shortened(message));
    SettingsError::Invalid(format!("{layer}: {key} = {value} does not work: {reason}"))
}

/// The known word closest to `key`, if it is close enough to be meant.
fn nearest<'a>(key: &str, known_keys: &'a [String]) -> Option<&'a str> {
    let score = |word: &str| strsim::jaro_winkler(key, word);
    known_keys
        .iter()
        .map(|word| (score(word), word.as_str()))
        .filter(|&(score, _)| score > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, word)| word)
}

/// A setting of that name in another table, the least deep one: `--set iterations=10` meant
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
        let place = level
            .iter()
            .find(|(_, table)| table.get(key).is_some_and(|v| !v.is_table()));
        if let Some((path, _)) = place {
            return Some(format!("{path}.{key}"));
        }
    }
    None
}

/// Why settings could not be put together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// The file could not be read.
    #[error("cannot read the settings {}", path.display())]
    Read {
        /// The file given.
        path: PathBuf,
        /// Message of the system.
        source: std::io::Error,
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
    /// A file that is not TOML, a malformed `--set`, a value of the wrong type or out of range, or
    /// two profiles.
    #[error("{0}")]
    Invalid(String),
    /// Settings of the first splats that do not go together.
    #[error(transparent)]
    Init(#[from] InitError),
    /// Settings of training that do not go together.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// The built-in settings cannot be written as TOML, a bug of ours.
    #[error("the built-in settings cannot be written as TOML: {reason}")]
    Internal {
        /// Message of the serialiser.
        reason: String,
    },
}

fn suggest(nearest: &Option<String>) -> String {
    nearest
        .as_ref()
        .map_or_else(String::new, |key| format!("; did you mean {key:?}?"))
}

#[cfg(test)]
mod tests {
    use super::{Layers, SettingsError};
    use crate::settings::{Profile, Settings};
    use std::path::PathBuf;

    fn set(assignment: &str) -> Result<Layers, SettingsError> {
        Layers::default().set(assignment)
    }

    fn refusal(assignment: &str) -> String {
        set(assignment).unwrap_err().to_string()
    }

    #[test]
    fn later_layers_win_and_leave_the_rest() {
        let file = std::env::temp_dir().join(format!("minute4d-layers-{}", std::process::id()));
        std::fs::write(
            &file,
            "train.seed = 3\n[train.density]\nevery = 0.5\nerror_threshold = 1",
        )
        .unwrap();
        let layers = Layers::default()
            .file(&file)
            .and_then(|layers| layers.set("train.density.every=0.25"))
            .and_then(|layers| layers.set("video.ffmpeg=a b"));
        std::fs::remove_file(&file).unwrap();
        let mut want = Settings::fast();
        want.set_seed(3);
        want.train.density.every = 0.25;
        want.train.density.error_threshold = 1.0;
        want.video.ffmpeg = PathBuf::from("a b");
        let layers = layers.unwrap();
        assert_eq!(layers.finish().unwrap(), want);
        assert!(
            layers.named("train.density.every")
                && layers.named("train.density")
                && !layers.named("train.batch")
        );
    }

    #[test]
    fn a_profile_is_the_first_layer_wherever_it_is_named() {
        let layers = set("train.seed=3")
            .unwrap()
            .set("profile=faithful")
            .unwrap();
        let mut want = Settings::faithful();
        want.set_seed(3);
        assert_eq!(layers.profile(), Some(Profile::Faithful));
        assert_eq!(layers.finish().unwrap(), want);
        let text = layers.over(&Settings::fast()).unwrap_err().to_string();
        assert!(
            text.contains("\"faithful\"") && text.contains("\"fast\""),
            "{text}"
        );
        let text = refusal("profile=best");
        assert!(
            text.contains("profile = \"best\"") && text.contains("`faithful`"),
            "{text}"
        );
    }

    #[test]
    fn an_unknown_key_names_the_nearest() {
        let text = refusal("train.density.evry=2");
        assert!(
            text.contains("there is no setting \"train.density.evry\""),
            "{text}"
        );
        assert!(
            text.contains("did you mean \"train.density.every\"?"),
            "{text}"
        );
        let text = refusal("error_threshold=2");
        assert!(
            text.contains("did you mean \"train.density.error_threshold\"?"),
            "{text}"
        );
        assert!(refusal("iterations=7").contains("did you mean \"train.iterations\"?"));
        let text = refusal("train.density.until=2");
        assert!(
            text.contains("there is no setting") && !text.contains("did you mean"),
            "{text}"
        );
        let text = refusal("zzz=2");
        assert!(
            !text.contains("did you mean") && text.contains("profile, video, capture"),
            "{text}"
        );
    }
}
