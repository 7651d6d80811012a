//! The files that a data set may refer to: a data set from an untrusted source must not bring
//! private files into the result.

use crate::OutsideError;
use std::path::{Path, PathBuf};

/// Which files are read that a data set names.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Reach {
    /// Those in its own folder.
    #[default]
    Inside,
    /// All that the user may read.
    Anywhere,
}

/// The folders whose files may be read, links followed.
#[derive(Debug, Clone)]
pub struct Bounds {
    reach: Reach,
    folder: PathBuf,
    real: Vec<PathBuf>,
}

impl Bounds {
    /// All that is in `folder`, the folder of the data set, or in one of `others`, which the user
    /// named.
    #[must_use]
    pub fn new<'a>(
        reach: Reach,
        folder: &'a Path,
        others: impl IntoIterator<Item = &'a Path>,
    ) -> Self {
        // The parent of a bare file name.
        let folder = if folder.as_os_str().is_empty() {
            Path::new(".")
        } else {
            folder
        };
        let all = std::iter::once(folder).chain(others);
        Self {
            reach,
            folder: folder.to_path_buf(),
            // In one that is missing no file is.
            real: all
                .filter_map(|folder| folder.canonicalize().ok())
                .collect(),
        }
    }

    /// Refuses a file that lies elsewhere, by its name or by links; what does not exist may be
    /// read, which says why it fails.
    pub fn check(&self, file: &Path) -> Result<(), Box<OutsideError>> {
        if self.reach == Reach::Anywhere {
            return Ok(());
        }
        let Ok(real) = file.canonicalize() else {
            return Ok(());
        };
        if self.real.iter().any(|folder| real.starts_with(folder)) {
            return Ok(());
        }
        Err(Box::new(OutsideError {
            path: file.to_path_buf(),
            real,
            folder: self.folder.clone(),
        }))
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::{Bounds, Reach};
    use m4_core::advice::OUTSIDE;
    use std::fs;
    use std::os::unix::fs::symlink;
    use std::path::Path;

    #[test]
    fn bounds_follow_links_and_parents() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::create_dir_all(at("set/images")).unwrap();
        fs::create_dir_all(at("set-2")).unwrap();
        for file in ["set/images/a.png", "set-2/private.png", "private.png"] {
            fs::write(at(file), "x").unwrap();
        }
        symlink(at("private.png"), at("set/link.png")).unwrap();
        symlink(at("set-2"), at("set/folder")).unwrap();
        symlink("images/a.png", at("set/inner.png")).unwrap();
        symlink(at("set"), at("alias")).unwrap();
        let inside = Bounds::new(Reach::Inside, &at("set"), []);
        for good in [
            "set/images/a.png",
            "set/./images/../images/a.png",
            "set/inner.png",
            "set-2/../set/images/a.png",
            "alias/images/a.png",
            "set/none.png",
            "none.png",
        ] {
            inside.check(&at(good)).unwrap();
        }
        let outside = [
            "private.png",
            "set/../private.png",
            "set/link.png",
            "set/folder/private.png",
            "set-2/private.png",
        ];
        for bad in outside {
            let message = inside.check(&at(bad)).unwrap_err().to_string();
            assert!(
                message.contains(bad) && message.contains(OUTSIDE),
                "{message}"
            );
        }
        // what a link points to is reported
        let message = inside
            .check(&at("set/folder/private.png"))
            .unwrap_err()
            .to_string();
        assert!(message.contains("set-2/private.png"), "{message}");
        for bad in outside {
            Bounds::new(Reach::Anywhere, &at("set"), [])
                .check(&at(bad))
                .unwrap();
        }
        let two = Bounds::new(Reach::Inside, &at("set"), [at("set-2").as_path()]);
        two.check(&at("set/folder/private.png")).unwrap();
        assert!(two.check(&at("private.png")).is_err());
        // by any name of the folder
        let alias = Bounds::new(Reach::Inside, &at("alias"), []);
        alias.check(&at("set/images/a.png")).unwrap();
        // a name longer than the system takes
        let message = alias
            .check(Path::new(&"../".repeat(100_000)))
            .unwrap_err()
            .to_string();
        assert!(message.len() < 3000, "{}", message.len());
        let nowhere = Bounds::new(Reach::Inside, &at("nowhere"), []);
        assert!(nowhere.check(&at("private.png")).is_err());
        assert!(
            Bounds::new(Reach::Inside, Path::new(""), [])
                .check(Path::new("Cargo.toml"))
                .is_ok()
        );
    }
}
