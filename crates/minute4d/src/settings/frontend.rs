//! The parts of a front end, and their names.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// A part of a front end, as `--frontend` names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum FrontendPart {
    /// Cameras, and the static part, by MegaSaM's tracking network; depth made consistent along
    /// flow.
    Megasam,
    /// Flow by inverse search with variational refinement; needs nothing.
    Classical,
    /// Flow by RAFT.
    Raft,
    /// Metric depth and field of view by MoGe-2.
    Moge,
    /// Metric depth and field of view by UniDepth V2 (not for commercial use).
    Unidepth,
    /// Relative depth by Depth-Anything V1; with one that knows metres, aligned to it.
    DepthAnything,
}

impl FrontendPart {
    /// Every part.
    pub const ALL: [Self; 6] = [
        Self::Megasam,
        Self::Classical,
        Self::Raft,
        Self::Moge,
        Self::Unidepth,
        Self::DepthAnything,
    ];

    /// As options and records name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Megasam => "megasam",
            Self::Classical => "classical",
            Self::Raft => "raft",
            Self::Moge => "moge",
            Self::Unidepth => "unidepth",
            Self::DepthAnything => "depth-anything",
        }
    }

    /// What two parts cannot both do.
    pub(crate) fn task(self) -> &'static str {
        match self {
            Self::Megasam => "cameras",
            Self::Classical | Self::Raft => "flow",
            Self::Moge | Self::Unidepth => "metric depth",
            Self::DepthAnything => "relative depth",
        }
    }
}

/// Parts of a front end, each with a task of its own; none for the choice of the program.
///
/// Written `auto`, or the names of parts joined by `+`: `classical`, `raft`, `moge+raft`,
/// `megasam`, `megasam+raft+depth-anything+unidepth`. What is not named is done without weights,
/// except that `megasam` alone takes the best of flow and depth whose weights are here, and says
/// which.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Frontend {
    parts: Vec<FrontendPart>,
}

/// Words that name no front end, or two parts for one task.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct UnknownFrontend(String);

impl Frontend {
    /// Of parts, which are put in order.
    pub fn of(mut parts: Vec<FrontendPart>) -> Result<Self, UnknownFrontend> {
        parts.sort_unstable();
        for (k, a) in parts.iter().enumerate() {
            if let Some(b) = parts[k + 1..].iter().find(|b| b.task() == a.task()) {
                let (first, second, task) = (a.name(), b.name(), a.task());
                return Err(UnknownFrontend(format!(
                    "`{first}` and `{second}` both give {task}; leave one out"
                )));
            }
        }
        Ok(Self { parts })
    }

    /// The parts, in order.
    pub(crate) fn parts(&self) -> &[FrontendPart] {
        &self.parts
    }

    /// True where the program is to choose.
    pub fn is_auto(&self) -> bool {
        self.parts.is_empty()
    }

    /// True if `part` was named.
    pub fn has(&self, part: FrontendPart) -> bool {
        self.parts.contains(&part)
    }
}

impl fmt::Display for Frontend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_auto() {
            return f.write_str("auto");
        }
        let names: Vec<&str> = self.parts.iter().map(|p| p.name()).collect();
        f.write_str(&names.join("+"))
    }
}

impl FromStr for Frontend {
    type Err = UnknownFrontend;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "auto" {
            return Ok(Self::default());
        }
        let part = |word: &str| {
            let part = FrontendPart::ALL.into_iter().find(|p| p.name() == word);
            part.ok_or_else(|| {
                let names = FrontendPart::ALL.map(FrontendPart::name).join(", ");
                UnknownFrontend(format!(
                    "there is no front end `{word}`; parts are auto (alone), {names}, joined by `+`"
                ))
            })
        };
        Self::of(text.split('+').map(part).collect::<Result<_, _>>()?)
    }
}

impl From<Frontend> for String {
    fn from(frontend: Frontend) -> Self {
        frontend.to_string()
    }
}

impl TryFrom<String> for Frontend {
    type Error = UnknownFrontend;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::{Frontend, FrontendPart};

    #[test]
    fn words_are_front_ends() {
        let named = |text: &str| text.parse::<Frontend>();
        assert!(named("auto").unwrap().is_auto());
        assert_eq!(
            named("raft+moge").unwrap(),
            Frontend::of(vec![FrontendPart::Moge, FrontendPart::Raft]).unwrap()
        );
        for text in [
            "auto",
            "classical",
            "raft+moge",
            "megasam",
            "megasam+raft+unidepth+depth-anything",
        ] {
            assert_eq!(named(text).unwrap().to_string(), text);
        }
        for wrong in ["", "megasan", "gmflow", "auto+moge", "moge+", "MOGE"] {
            let text = named(wrong).unwrap_err().to_string();
            assert!(text.contains("there is no front end"), "{wrong}: {text}");
        }
        for twice in ["classical+raft", "moge+unidepth", "moge+moge"] {
            let text = named(twice).unwrap_err().to_string();
            assert!(text.contains("both give"), "{twice}: {text}");
        }
    }
}
