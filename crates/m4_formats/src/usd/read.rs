//! The splats of USD text at an instant.

use super::error::ReadUsdError;
use super::lexer::{Fault, Lexer};
use super::samples::Attribute;
use crate::row::{Row, collect, logit, unit};
use crate::rub::turn_splats;
use m4_scene::Splats;
use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::Path;

const SCHEMA: &str = "ParticleField3DGaussianSplat";
/// Deepest nesting of prims.
const MAX_DEPTH: usize = 32;
/// Bytes that are read at once.
const BLOCK: usize = 1 << 18;

/// The splats of the only `ParticleField3DGaussianSplat` at frame `t` (USD's time code), static, in our
/// axes: time samples are interpolated linearly, before the first and after the last they hold. Splats of
/// no opacity are left out. Reads the layout that [`super::write()`] writes, from a stream.
///
/// # Errors
///
/// [`ReadUsdError`] if the file is missing, damaged, or uses more of USD than that.
pub fn read(path: &Path, t: f64) -> Result<Splats, ReadUsdError> {
    let open = || {
        let file = File::open(path)?;
        if !file.metadata()?.is_file() {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "it is not a regular file"));
        }
        Ok(file)
    };
    let file = open().map_err(|source| ReadUsdError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    parse(path, BufReader::with_capacity(BLOCK, file), t)
}

/// The splats in a stream; `path` is for messages alone.
///
/// # Errors
///
/// As [`read`].
pub fn parse(path: &Path, from: impl BufRead, t: f64) -> Result<Splats, ReadUsdError> {
    let path = || path.to_path_buf();
    let fault = |fault| match fault {
        Fault::Io(source) => ReadUsdError::Io { path: path(), source },
        Fault::Bad(reason) => ReadUsdError::Damaged { path: path(), reason },
        Fault::Foreign(what) => ReadUsdError::Foreign { path: path(), what },
    };
    let mut lexer = Lexer::new(from, 0);
    for byte in b"#usda" {
        if !lexer.take(*byte).map_err(fault)? {
            return Err(ReadUsdError::NotUsda { path: path() });
        }
    }
    let mut stage = Stage {
        lexer,
        t,
        y_is_up: true,
        field: None,
    };
    stage.read().map_err(fault)?;
    let turned = stage.y_is_up;
    let Some(field) = stage.field else {
        return Err(fault(Fault::Foreign(format!("no {SCHEMA}"))));
    };
    let mut splats = field.splats(t).map_err(fault)?;
    if turned {
        turn_splats(&mut splats);
    }
    Ok(splats)
}

/// A file on its way.
struct Stage<R> {
    lexer: Lexer<R>,
    t: f64,
    y_is_up: bool,
    field: Option<Field>,
}

impl<R: BufRead> Stage<R> {
    fn read(&mut self) -> Result<(), Fault> {
        self.lexer.skip_line()?;
        self.lexer.blanks()?;
        if self.lexer.take(b'(')? {
            self.layer()?;
        }
        self.prim(0, false)?;
        Ok(())
    }

    /// The metadata of the file, of which one tells the axes.
    fn layer(&mut self) -> Result<(), Fault> {
        loop {
            self.lexer.blanks()?;
            if self.lexer.take(b')')? {
                return Ok(());
            }
            if matches!(self.lexer.peek()?, Some(b'"' | b'\'' | b';')) {
                if !self.lexer.take(b';')? {
                    self.lexer.skip_value()?;
                }
                continue;
            }
            let name = self.lexer.word()?;
            if name.is_empty() {
                return Err(self.lexer.unexpected("a name")?);
            }
            self.lexer.spaces()?;
            if !self.lexer.take(b'=')? {
                continue; // `prepend subLayers`
            }
            match name.as_str() {
                "upAxis" => {
                    let axis = self.lexer.quoted()?;
                    self.y_is_up = match axis.as_str() {
                        "Y" => true,
                        _ => return Err(Fault::Foreign(format!("the up axis {axis:?} where \"Y\" is read"))),
                    };
                }
                "subLayers" => return Err(Fault::Foreign("layers in other files".to_owned())),
                _ => self.lexer.skip_value()?,
            }
        }
    }

    /// What stands between the braces of a prim, up to the closing one; of the file itself (depth 0) up to the
    /// end. True if the splats were in it.
    fn prim(&mut self, depth: usize, is_field: bool) -> Result<bool, Fault> {
        if depth > MAX_DEPTH {
            return Err(self.lexer.bad(format!("prims nested more than {MAX_DEPTH} deep")));
        }
        let (mut holds_field, mut moved) = (is_field, false);
        loop {
            self.lexer.blanks()?;
            match self.lexer.peek()? {
                None if depth == 0 => return Ok(holds_field),
                None => return Err(self.lexer.bad("it ends within a prim")),
                Some(b'}') if depth > 0 => {
                    self.lexer.step();
                    if holds_field && moved {
                        return Err(Fault::Foreign("splats that are moved by a transform".to_owned()));
                    }
                    return Ok(holds_field);
                }
                Some(b';') => {
                    self.lexer.step();
                    continue;
                }
                Some(_) => {}
            }
            let words = self.words()?;
            let Some(last) = words.last() else {
                return Err(self.lexer.unexpected("an attribute or a prim")?);
            };
            match words[0].as_str() {
                "def" => holds_field |= self.child(depth, words.get(1).is_some_and(|w| w == SCHEMA))?,
                "over" | "class" => holds_field |= self.child(depth, false)?,
                "variantSet" => return Err(Fault::Foreign("variants".to_owned())),
                _ if self.lexer.take(b'=')? => {
                    moved |= last == "xformOpOrder";
                    if !(is_field && self.attribute(last)?) {
                        self.lexer.skip_value()?;
                    }
                    self.metadata()?;
                }
                _ => self.metadata()?,
            }
        }
    }

    /// The words of a line up to a sign.
    fn words(&mut self) -> Result<Vec<String>, Fault> {
        const MOST: usize = 8;
        let mut words = Vec::new();
        while words.len() < MOST {
            let word = self.lexer.word()?;
            if word.is_empty() {
                break;
            }
            words.push(word);
            self.lexer.spaces()?;
        }
        Ok(words)
    }

    /// Passes over `( ... )` in this line.
    fn metadata(&mut self) -> Result<(), Fault> {
        self.lexer.spaces()?;
        if self.lexer.peek()? == Some(b'(') {
            self.lexer.skip_value()?;
        }
        Ok(())
    }

    fn child(&mut self, depth: usize, is_field: bool) -> Result<bool, Fault> {
        self.lexer.quoted()?;
        self.lexer.blanks()?;
        self.metadata()?;
        self.lexer.expect(b'{')?;
        if is_field && self.field.replace(Field::default()).is_some() {
            return Err(Fault::Foreign(format!("more than one {SCHEMA}")));
        }
        self.prim(depth + 1, is_field)
    }

    /// Reads the value of an attribute of the splats; false for one that does not matter.
    fn attribute(&mut self, name: &str) -> Result<bool, Fault> {
        let (name, sampled) = match name.strip_suffix(".timeSamples") {
            Some(name) => (name, true),
            None => (name, false),
        };
        let (lexer, Some(field)) = (&mut self.lexer, &mut self.field) else {
            return Ok(false);
        };
        if name == "radiance:sphericalHarmonicsDegree" && !sampled {
            let degree: f64 = lexer.number()?;
            field.degree = (0..=3)
                .find(|&d| d as f64 == degree)
                .ok_or_else(|| Fault::Foreign(format!("harmonics of degree {degree} where 0 to 3 are read")))?;
            return Ok(true);
        }
        let Some(k) = LISTS.iter().position(|(known, _)| *known == name) else {
            return Ok(false);
        };
        let (_, width) = LISTS[k];
        let attribute = &mut field.lists[k];
        if !sampled {
            attribute.read_still(lexer, width)?;
        } else if k == ORIENTATIONS {
            return Err(Fault::Foreign("splats that turn".to_owned()));
        } else {
            attribute.read_samples(lexer, self.t)?;
        }
        Ok(true)
    }
}

/// Attributes of the schema that hold a list, and the numbers of an item.
const LISTS: [(&str, usize); 5] = [
    ("positions", 3),
    ("orientations", 4),
    ("scales", 3),
    ("opacities", 1),
    ("radiance:sphericalHarmonicsCoefficients", 3),
];
const ORIENTATIONS: usize = 1;

/// The prim with the splats.
#[derive(Default)]
struct Field {
    degree: usize,
    lists: [Attribute; LISTS.len()],
}

impl Field {
    fn splats(self, t: f64) -> Result<Splats, Fault> {
        let terms = (self.degree + 1).pow(2);
        let mut lists: [Vec<f32>; LISTS.len()] = Default::default();
        for ((attribute, (name, width)), list) in self.lists.into_iter().zip(LISTS).zip(&mut lists) {
            *list = attribute
                .at(t, width)?
                .ok_or_else(|| Fault::Foreign(format!("splats without {name}")))?;
        }
        let n = lists[0].len() / 3;
        let items = [1, 1, 1, 1, terms];
        for ((list, (name, width)), items) in lists.iter().zip(LISTS).zip(items) {
            if list.len() != n * width * items {
                return Err(Fault::Bad(format!(
                    "{} {name} where the {n} positions ask for {}",
                    list.len() / width,
                    n * items
                )));
            }
        }
        let [means, quats, scales, opacities, colours] = &lists;
        let seen: Vec<usize> = (0..n).filter(|&i| opacities[i] > 0.0).collect();
        let row = |&i: &usize| Row {
            mean: std::array::from_fn(|k| means[3 * i + k]),
            log_scale: std::array::from_fn(|k| scales[3 * i + k].abs().max(f32::MIN_POSITIVE).ln()),
            quat: unit(std::array::from_fn(|k| quats[4 * i + k])),
            opacity: logit(f64::from(opacities[i])),
        };
        let rows: Vec<_> = seen.iter().map(|i| (row(i), None)).collect();
        let width = 3 * terms;
        Ok(collect(self.degree, &rows, |k, out| {
            out.copy_from_slice(&colours[seen[k] * width..][..width]);
        }))
    }
}
