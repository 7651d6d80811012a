//! Resolves a front end to the networks whose weights are installed.

use crate::Error;
use crate::device::DeviceChoice;
use crate::error::NetworkMethod;
use crate::networks::{UsedNetwork, is_installed, network};
use crate::settings::{Frontend, FrontendPart};
use std::path::PathBuf;

/// A front end whose weights were found.
#[derive(Debug)]
pub struct Plan {
    /// What was chosen, never `auto`.
    pub frontend: Frontend,
    /// The networks, in the order of the parts.
    pub used: Vec<UsedNetwork>,
    /// What the user should know about the choice.
    pub notes: Vec<String>,
    /// Whether it would take depth from a network whose weights are not installed.
    pub lacks_depth: bool,
    #[cfg_attr(not(feature = "nets"), expect(dead_code, reason = "nothing is loaded"))]
    pub(super) files: Vec<(FrontendPart, PathBuf)>,
}

impl Plan {
    /// Whether cameras come from MegaSaM's tracking network; else from tracked corners and bundle
    /// adjustment.
    pub fn is_megasam(&self) -> bool {
        self.frontend.has(FrontendPart::Megasam)
    }

    /// Hashes of the networks' weights.
    pub fn hashes(&self) -> Vec<&str> {
        self.used
            .iter()
            .map(|network| network.blake3.as_str())
            .collect()
    }

    /// The file of a part's weights.
    #[cfg(feature = "nets")]
    pub(super) fn file(&self, part: FrontendPart) -> Option<&std::path::Path> {
        let entry = self.files.iter().find(|(p, _)| *p == part);
        entry.map(|(_, path)| path.as_path())
    }
}

/// Names of the weights that serve a part, the best first.
fn names(part: FrontendPart) -> &'static [&'static str] {
    match part {
        FrontendPart::Megasam => &["megasam"],
        FrontendPart::Classical => &[],
        FrontendPart::Raft => &["raft-things"],
        FrontendPart::Moge => &[
            "moge-2-l-normal",
            "moge-2-l",
            "moge-2-b-normal",
            "moge-2-b",
            "moge-2-s-normal",
        ],
        FrontendPart::Unidepth => &["unidepth-v2-l"],
        FrontendPart::DepthAnything => &[
            "depth-anything-v1-l",
            "depth-anything-v1-b",
            "depth-anything-v1-s",
        ],
    }
}

/// The default flow methods for the tracking network, best first.
const FLOWS: [FrontendPart; 2] = [FrontendPart::Raft, FrontendPart::Classical];
/// The depth methods, best first.
const DEPTHS: [&[FrontendPart]; 5] = [
    &[FrontendPart::Moge],
    &[FrontendPart::Unidepth, FrontendPart::DepthAnything],
    &[FrontendPart::Unidepth],
    &[FrontendPart::DepthAnything],
    &[],
];

/// Finds what `asked` needs. `auto` is `classical` on the processor, by measurement
/// (docs/geometry-log.md, "Front ends"), with depth of `moge` where its weights are here; on a GPU
/// that was asked for it is `megasam` where the weights of all of its parts are here. Fails if
/// weights are missing, the build has no networks, or a requested GPU does not start.
pub fn plan(asked: &Frontend, device: DeviceChoice) -> Result<Plan, Error> {
    let here = |part: FrontendPart| part == FrontendPart::Classical || is_installed(names(part));
    let mut notes = Vec::new();
    let parts = if asked.is_auto() {
        automatic(&here, || device.is_gpu())?
    } else {
        complete(asked, &here, &mut notes)
    };
    let frontend = Frontend::of(parts.clone()).map_err(Error::internal)?;
    let (mut used, mut files) = (Vec::new(), Vec::new());
    for part in parts {
        if let Some((network, path)) = network(names(part), true, NetworkMethod::FrontEnd(part))? {
            used.push(network);
            files.push((part, path));
        }
    }
    for network in used.iter().filter(|network| !network.commercial) {
        notes.push(format!(
            "{} may not be used commercially ({}), and neither may what is made with it",
            network.weights, network.licence
        ));
    }
    let lacks_depth =
        cfg!(feature = "nets") && asked.is_auto() && frontend.parts() == [FrontendPart::Classical];
    Ok(Plan {
        frontend,
        used,
        notes,
        lacks_depth,
        files,
    })
}

/// The parts of `auto`.
fn automatic(
    here: &dyn Fn(FrontendPart) -> bool,
    on_gpu: impl FnOnce() -> Result<bool, Error>,
) -> Result<Vec<FrontendPart>, Error> {
    let best = [FrontendPart::Megasam, FrontendPart::Raft];
    let depth = DEPTHS
        .iter()
        .find(|d| !d.is_empty() && d.iter().all(|&p| here(p)));
    Ok(match depth {
        Some(depth) if best.iter().all(|&p| here(p)) && on_gpu()? => [&best, *depth].concat(),
        _ if here(FrontendPart::Moge) => vec![FrontendPart::Classical, FrontendPart::Moge],
        _ => vec![FrontendPart::Classical],
    })
}

/// The parts of `asked` with a flow, and with a depth where the tracking network wants one.
fn complete(
    asked: &Frontend,
    here: &dyn Fn(FrontendPart) -> bool,
    notes: &mut Vec<String>,
) -> Vec<FrontendPart> {
    let mut parts = asked.parts().to_vec();
    let tracked = asked.has(FrontendPart::Megasam);
    if !FLOWS.iter().any(|&flow| asked.has(flow)) {
        let flow = FLOWS.into_iter().find(|&flow| tracked && here(flow));
        parts.push(flow.unwrap_or(FrontendPart::Classical));
    }
    let has_depth = DEPTHS
        .iter()
        .flat_map(|depth| depth.iter())
        .any(|&depth| asked.has(depth));
    if tracked && !has_depth {
        let depth = DEPTHS
            .iter()
            .find(|depth| depth.iter().all(|&part| here(part)));
        parts.extend(depth.into_iter().flat_map(|depth| depth.iter()));
    }
    if tracked && parts.len() != asked.parts().len() {
        let chosen: Vec<&str> = parts[asked.parts().len()..]
            .iter()
            .map(|p| p.name())
            .collect();
        let depth = parts
            .iter()
            .any(|p| matches!(p.task(), "metric depth" | "relative depth"));
        let without = if depth {
            ""
        } else {
            ", and no depth from one image (the weights moge-2-l give one)"
        };
        notes.push(format!(
            "megasam takes {}{without}: that is what is here",
            chosen.join(", ")
        ));
    }
    parts
}

#[cfg(test)]
mod tests {
    #[cfg(feature = "nets")]
    use super::names;
    use super::{automatic, complete};
    use crate::settings::{Frontend, FrontendPart};

    fn parts(asked: &str, here: &[FrontendPart]) -> (String, Vec<String>) {
        let asked: Frontend = asked.parse().unwrap();
        let mut notes = Vec::new();
        let present = |part| part == FrontendPart::Classical || here.contains(&part);
        let parts = complete(&asked, &present, &mut notes);
        (Frontend::of(parts).unwrap().to_string(), notes)
    }

    #[cfg(feature = "nets")]
    #[test]
    fn every_part_has_weights_that_are_known() {
        for part in FrontendPart::ALL {
            assert_eq!(names(part).is_empty(), part == FrontendPart::Classical);
            assert!(
                names(part)
                    .iter()
                    .all(|name| crate::weights::find(name).is_ok()),
                "{part:?}"
            );
        }
    }

    #[test]
    fn auto_takes_what_is_installed() {
        use FrontendPart::{Classical, Megasam, Moge, Raft, Unidepth};
        for (here, on_gpu, expected) in [
            (&[][..], true, &[Classical][..]),
            (&[Moge], false, &[Classical, Moge]),
            (&[Moge, Raft, Megasam], false, &[Classical, Moge]),
            (&[Moge, Raft, Megasam], true, &[Megasam, Raft, Moge]),
            (&[Moge, Megasam], true, &[Classical, Moge]),
            // without the user's choice nothing that may not be used commercially
            (&[Unidepth], false, &[Classical]),
        ] {
            let parts = automatic(&|part| here.contains(&part), || Ok(on_gpu)).unwrap();
            assert_eq!(parts, expected, "{here:?} {on_gpu}");
        }
    }

    #[test]
    fn parts_not_named_use_methods_without_weights() {
        assert_eq!(
            parts("moge", &[FrontendPart::Raft, FrontendPart::Moge]).0,
            "classical+moge"
        );
        assert_eq!(parts("raft", &[]), ("raft".to_owned(), vec![]));
    }

    #[test]
    fn the_tracking_network_takes_the_best_that_is_here_and_says_so() {
        use FrontendPart::{DepthAnything, Moge, Raft, Unidepth};
        let (all, notes) = parts("megasam", &[Raft, Moge, Unidepth, DepthAnything]);
        assert_eq!(all, "megasam+raft+moge");
        assert!(notes[0].contains("raft, moge"), "{notes:?}");
        assert_eq!(
            parts("megasam", &[Unidepth, DepthAnything]).0,
            "megasam+classical+unidepth+depth-anything"
        );
        let (few, notes) = parts("megasam", &[]);
        assert_eq!(few, "megasam+classical");
        assert!(notes[0].contains("no depth"), "{notes:?}");
        let (named, notes) = parts("megasam+classical+moge", &[Raft]);
        assert_eq!((named.as_str(), notes.len()), ("megasam+classical+moge", 0));
    }
}
