//! Names of images in lists of cameras.

use m4_core::Scene;

/// A list of names that does not fit a scene.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BadName {
    /// Another number than that of the cameras.
    #[error("there are {found} names of images and {expected} cameras")]
    Count {
        /// Cameras of the scene.
        expected: usize,
        /// Names that were given.
        found: usize,
    },
    /// A name that the lists cannot hold.
    #[error("image {index} is called {name:?}; names are not empty and have no spaces and no control characters")]
    Name {
        /// Index of the camera.
        index: usize,
        /// The name.
        name: String,
    },
}

/// The names given, or `00000.png`, `00001.png`, ... as the images of a capture are called.
pub(super) fn names(scene: &Scene, given: Option<&[String]>) -> Result<Vec<String>, BadName> {
    let expected = scene.source.len();
    let Some(given) = given else {
        return Ok((0..expected).map(|i| format!("{i:05}.png")).collect());
    };
    if given.len() != expected {
        return Err(BadName::Count {
            expected,
            found: given.len(),
        });
    }
    let unfit = |name: &String| name.is_empty() || name.chars().any(|c| c.is_whitespace() || c.is_control());
    if let Some(index) = given.iter().position(unfit) {
        return Err(BadName::Name {
            index,
            name: given[index].clone(),
        });
    }
    Ok(given.to_vec())
}
