//! MoGe-2 by its official ONNX export, computed by ONNX Runtime.
//!
//! The export is the network alone: `image` `[1, 3, h, w]` from 0 to 1 and `num_tokens`, a whole number, go in; `points` `[1, h, w, 3]`
//! (already through the remap, right up to a scale and an offset of their depth), `mask` `[1, h, w]` (a probability), `metric_scale`
//! `[1]` and, of models with normals, `normal` `[1, h, w, 3]` come out. The focal length and the offset are found here, as for the
//! network in Burn.
//!
//! ONNX Runtime is a shared library of the user's, of version 1.17 or later, found when the first file is loaded: the path in the
//! environment variable `ORT_DYLIB_PATH`, or what the system's loader finds as `libonnxruntime.so` (`.dylib`, `onnxruntime.dll`). It
//! computes on the processor.

use super::MoGeError;
use super::map::{MoGeMap, MoGeOptions, Said};
use super::picture::MOST_TOKENS;
use crate::LoadError;
use crate::ops::planes;
use m4_scene::RgbImage;
use ort::environment::Environment;
use ort::session::{Session, SessionInputValue};
use ort::value::{Tensor, ValueType};
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

const NAME: &str = "MoGe-2";
/// Patches where nobody says, the most that the published networks were trained with.
const TOKENS: usize = 3600;
/// Outputs that every export has.
const OUTPUTS: [&str; 3] = ["points", "mask", "metric_scale"];
const NORMAL: &str = "normal";
const TOKEN_INPUT: &str = "num_tokens";

/// The library as the system's loader knows it.
#[cfg(target_os = "windows")]
const LIBRARY: &str = "onnxruntime.dll";
#[cfg(target_os = "macos")]
const LIBRARY: &str = "libonnxruntime.dylib";
#[cfg(not(any(target_os = "windows", target_os = "macos")))]
const LIBRARY: &str = "libonnxruntime.so";

/// The network of an ONNX file.
#[derive(Debug)]
pub struct MoGeOnnx {
    session: Mutex<Session>,
    normals: bool,
    takes_tokens: bool,
    /// Width and height that the file is for; any where there is none.
    size: Option<(usize, usize)>,
}

/// Where the shared library is.
fn library() -> PathBuf {
    let told = std::env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty());
    told.map_or_else(|| PathBuf::from(LIBRARY), PathBuf::from)
}

/// What sessions are made in: a process may have one only.
static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);

/// What `use_it` makes of ONNX Runtime, which is loaded if it is not yet.
fn with_environment<T>(use_it: impl FnOnce(&Environment) -> T) -> Result<T, LoadError> {
    let mut kept = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(environment) = kept.as_ref() {
        return Ok(use_it(environment));
    }
    let path = library();
    let failed = |reason: String| LoadError::Runtime {
        library: path.clone(),
        reason,
    };
    let builder = ort::init_from(&path).map_err(|error| failed(error.to_string()))?;
    let environment = builder.build().map_err(|error| failed(error.to_string()))?;
    Ok(use_it(kept.insert(environment)))
}

fn failed(error: ort::Error) -> MoGeError {
    MoGeError::Device(error.to_string())
}

impl MoGeOnnx {
    /// The network of the ONNX file at `path`, on the processor, with as many threads as Rayon's pool has.
    ///
    /// # Errors
    ///
    /// [`LoadError::Missing`] if there is no file, [`LoadError::Runtime`] if ONNX Runtime is not found, [`LoadError::Unreadable`] if it
    /// cannot read the file, [`LoadError::OtherNetwork`] if the file takes or gives other things.
    pub fn load(path: &Path) -> Result<Self, LoadError> {
        if !path.is_file() {
            return Err(LoadError::Missing { path: path.to_owned() });
        }
        let unreadable = |reason: String| LoadError::Unreadable {
            path: path.to_owned(),
            network: NAME,
            reason,
        };
        let threads = rayon::current_num_threads();
        let builder = with_environment(Session::builder)?;
        let builder = builder.map_err(|error| unreadable(error.to_string()))?;
        let mut builder = builder
            .with_intra_threads(threads)
            .map_err(|error| unreadable(error.to_string()))?;
        let session = builder
            .commit_from_file(path)
            .map_err(|error| unreadable(error.to_string()))?;
        let has = |name: &str| session.outputs().iter().any(|out| out.name() == name);
        let missing: Vec<String> = OUTPUTS
            .iter()
            .filter(|name| !has(name))
            .map(|&name| name.into())
            .collect();
        let inputs = || session.inputs().iter();
        let unused: Vec<String> = inputs()
            .map(|input| input.name().to_owned())
            .filter(|name| !["image", TOKEN_INPUT].contains(&name.as_str()))
            .collect();
        let image = inputs().find(|input| input.name() == "image");
        let size = image.and_then(|image| picture_size(image.dtype()));
        if !missing.is_empty() || !unused.is_empty() || size.is_none() {
            return Err(LoadError::OtherNetwork {
                path: path.to_owned(),
                network: NAME,
                missing,
                unused,
                wrong: size.is_none().then(|| "image".to_owned()).into_iter().collect(),
            });
        }
        Ok(Self {
            normals: has(NORMAL),
            takes_tokens: inputs().any(|input| input.name() == TOKEN_INPUT),
            size: size.flatten(),
            session: Mutex::new(session),
        })
    }

    /// Whether [`MoGeMap::normal`] is there.
    #[must_use]
    pub fn has_normals(&self) -> bool {
        self.normals
    }

    /// The geometry of `image`. `options.tokens` is of no meaning for files that are for one number of patches.
    ///
    /// # Errors
    ///
    /// [`MoGeError`] if the picture has no pixels or is of another size than the file is for, an option is out of range, the network
    /// finds no depth, or ONNX Runtime fails.
    pub fn infer(&self, image: &RgbImage, options: &MoGeOptions) -> Result<MoGeMap, MoGeError> {
        self.said(image, options.tokens.unwrap_or(TOKENS))?
            .geometry(options.known_focal_px)
    }

    fn said(&self, image: &RgbImage, tokens: usize) -> Result<Said, MoGeError> {
        let (width, height) = image.size();
        if width == 0 || height == 0 {
            return Err(MoGeError::Empty);
        }
        if !(1..=MOST_TOKENS).contains(&tokens) {
            return Err(MoGeError::Tokens(tokens));
        }
        if let Some(size) = self.size.filter(|&size| size != (width, height)) {
            let (w, h) = size;
            return Err(MoGeError::Device(format!(
                "the file is for pictures of {w} x {h} pixels, not {width} x {height}: the export with a dynamic shape takes any"
            )));
        }
        let picture = planes(image, [0.0; 3], [1.0; 3]);
        let picture = Tensor::from_array(([1, 3, height, width], picture)).map_err(failed)?;
        let mut inputs: Vec<(Cow<'_, str>, SessionInputValue<'_>)> = vec![("image".into(), picture.into())];
        if self.takes_tokens {
            let scalar: [usize; 0] = [];
            let tokens = Tensor::from_array((scalar, vec![tokens as i64])).map_err(failed)?;
            inputs.push((TOKEN_INPUT.into(), tokens.into()));
        }
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        let out = session.run(inputs).map_err(failed)?;
        let numbers = |name: &str, count: usize| {
            let value = out.get(name).ok_or_else(|| {
                MoGeError::Device(format!(
                    "ONNX Runtime gives no `{name}`, which the file names as an output"
                ))
            })?;
            let (shape, values) = value.try_extract_tensor::<f32>().map_err(failed)?;
            if values.len() == count {
                Ok(values.to_vec())
            } else {
                Err(MoGeError::Device(format!(
                    "`{name}` has the shape {shape:?} for a picture of {width} x {height} pixels"
                )))
            }
        };
        let triples = |values: Vec<f32>| values.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect();
        let pixels = width * height;
        Ok(Said {
            width,
            height,
            points: numbers("points", 3 * pixels).map(triples)?,
            mask: numbers("mask", pixels)?,
            normal: self
                .normals
                .then(|| numbers(NORMAL, 3 * pixels).map(triples))
                .transpose()?,
            metric_scale: numbers("metric_scale", 1)?[0],
        })
    }
}

/// Width and height of pictures of the type `image`; `Some(None)` if they may be of any size, `None` if it is no picture's.
fn picture_size(image: &ValueType) -> Option<Option<(usize, usize)>> {
    let ValueType::Tensor { shape, .. } = image else {
        return None;
    };
    let [_, 3 | -1, height, width] = shape[..] else {
        return None;
    };
    let side = |n: i64| usize::try_from(n).ok();
    Some(side(width).zip(side(height)))
}
