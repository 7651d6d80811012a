//! What the tensors of a checkpoint cannot tell.
//!
//! The published file is a pickle of PyTorch with an OmegaConf object `cfg` beside the weights: the
//! configuration is its section `model`, with `image_size` (rows, columns) from the section
//! `train_dataset`. In a safetensors file it is a JSON object in the metadata entry `config`. What
//! it leaves out has the default of upstream's constructors.

use super::encoding::width;
use super::pickle::Pickle;
use crate::load::Shapes;
use serde_json::Value;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// What a checkpoint says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Columns and rows of training.
    pub size: (usize, usize),
    /// Frames of a window; even.
    pub window: usize,
    pub levels: usize,
    pub norm_scale: f32,
    /// Nearest points of a map.
    pub neighbours: usize,
    /// Heads of the attention between neighbourhoods.
    pub heads: usize,
    pub updater_heads: usize,
}

/// Fewer and more of anything is no network that was ever made.
const MOST: u64 = 4096;

impl Config {
    /// That of the checkpoint at `path`: the published one, or safetensors.
    pub fn of_checkpoint(path: &Path) -> Result<Self, String> {
        let said = match metadata(path) {
            Some(said) => serde_json::from_str(&said)
                .map_err(|error| format!("its configuration is no JSON: {error}"))?,
            None => published(path)?,
        };
        Self::read(&said).map_err(|reason| format!("of its configuration, {reason}"))
    }

    /// That of a JSON object.
    pub fn read(said: &Value) -> Result<Self, String> {
        for (path, only) in ONLY {
            let got = at(said, path);
            if let Some(got) = got.map(Value::to_string).filter(|got| got != only) {
                return Err(format!("{path} = {got} is not known here"));
            }
        }
        let updater = text(said, "point_updater.name")
            .unwrap_or_default()
            .to_lowercase();
        if updater.contains("svd") || updater.contains("refine") {
            return Err(format!("point_updater.name = {updater} is not known here"));
        }
        let window = count(said, "seq_len", None)?;
        if window % 2 != 0 {
            return Err(format!("seq_len = {window} is odd"));
        }
        let size = at(said, "image_size").and_then(Value::as_array);
        let side = |i: usize| {
            let side = size.and_then(|size| size.get(i)).and_then(Value::as_u64);
            side.filter(|side| (1..=MOST).contains(side))
                .map(|side| side as usize)
                .ok_or("image_size is not rows and columns")
        };
        let norm_mode = text(said, "norm_mode").unwrap_or("none").to_lowercase();
        if norm_mode != "isotropic" {
            return Err(format!("norm_mode = {norm_mode} is not known here"));
        }
        let norm_scale =
            at(said, "norm_scale").map_or(1.0, |scale| scale.as_f64().unwrap_or(f64::NAN));
        if !(norm_scale.is_finite() && norm_scale > 0.0) {
            return Err("norm_scale is no positive number".into());
        }
        Ok(Self {
            size: (side(1)?, side(0)?),
            window,
            levels: count(said, "corr_levels", Some(4))?,
            norm_scale: norm_scale as f32,
            neighbours: count(said, "corr_feature.k_neighbors", None)?,
            heads: count(said, "corr_feature.transformer_num_heads", None)?,
            updater_heads: count(said, "point_updater.num_heads", Some(8))?,
        })
    }
}

/// Options of upstream that the published network does not use, and that are not known here.
const ONLY: [(&str, &str); 11] = [
    ("center_rgb", "false"),
    ("use_local_pos_input", "false"),
    ("use_uv_input", "false"),
    ("relative", "false"),
    ("encoder.stride", "4"),
    ("corr_feature.share_weights_across_levels", "false"),
    ("corr_feature.use_features", "false"),
    ("corr_feature.use_absolute_pos", "false"),
    ("corr_feature.better_depth_downsample", "true"),
    ("point_updater.add_space_attn", "true"),
    ("point_updater.linear_layer_for_vis_conf", "false"),
];

fn at<'a>(said: &'a Value, path: &str) -> Option<&'a Value> {
    path.split('.')
        .try_fold(said, |value, key| value.get(key))
        .filter(|value| !value.is_null())
}

fn text<'a>(said: &'a Value, path: &str) -> Option<&'a str> {
    at(said, path).and_then(Value::as_str)
}

fn count(said: &Value, path: &str, otherwise: Option<usize>) -> Result<usize, String> {
    let Some(value) = at(said, path) else {
        return otherwise.ok_or_else(|| format!("{path} is missing"));
    };
    let count = value.as_u64().filter(|n| (1..=MOST).contains(n));
    count
        .map(|n| n as usize)
        .ok_or_else(|| format!("{path} = {value} is no number from 1 to {MOST}"))
}

/// Most bytes of the pickle of a checkpoint, without its tensors.
const MOST_PICKLED: u64 = 1 << 26;
/// Most references in a row.
const MOST_REFERENCES: usize = 10;

/// The configuration in the published checkpoint, a zip archive with a pickle.
fn published(path: &Path) -> Result<Value, String> {
    let failed = |error: zip::result::ZipError| {
        format!(
            "it is neither the published checkpoint nor safetensors with a configuration: {error}"
        )
    };
    let file = File::open(path).map_err(|error| error.to_string())?;
    let mut archive = zip::ZipArchive::new(BufReader::new(file)).map_err(failed)?;
    let name = archive
        .file_names()
        .filter_map(|name| Some(name.ok()?.into_owned()))
        .find(|name| name == "data.pkl" || name.ends_with("/data.pkl"))
        .ok_or("it is an archive without data.pkl, and no checkpoint of PyTorch")?;
    let mut bytes = Vec::new();
    let entry = archive.by_name(&name).map_err(failed)?;
    let read = entry.take(MOST_PICKLED + 1).read_to_end(&mut bytes);
    let n = read.map_err(|error| format!("its data.pkl cannot be read: {error}"))?;
    if n as u64 > MOST_PICKLED {
        return Err("its data.pkl is too large".to_owned());
    }
    let root = Pickle::read(&bytes)
        .and_then(|pickle| pickle.entry("cfg"))
        .map_err(|reason| format!("of its pickle, {reason}"))?;
    let model = at(&root, "model").filter(|model| model.is_object());
    let model = model.ok_or("its `cfg` has no section `model`")?;
    let mut config = resolved(model, &root)?;
    if at(&config, "image_size").is_none() {
        let size = at(&root, "train_dataset.resolution");
        let size = size.ok_or("its `cfg` does not say train_dataset.resolution")?;
        config["image_size"] = resolved(size, &root)?;
    }
    Ok(config)
}

/// `value` with references such as `${train_dataset.resolution}` replaced by what they name in
/// `root`.
fn resolved(value: &Value, root: &Value) -> Result<Value, String> {
    let mut value = value;
    for _ in 0..=MOST_REFERENCES {
        match value {
            Value::String(text) if text.contains("${") => {
                let path = text
                    .strip_prefix("${")
                    .and_then(|rest| rest.strip_suffix('}'));
                let target = path.and_then(|path| at(root, path));
                value = target
                    .ok_or_else(|| format!("its `cfg` refers to {text}, which is not there"))?;
            }
            Value::Object(entries) => {
                let entry =
                    |(key, value): (&String, &Value)| Ok((key.clone(), resolved(value, root)?));
                return entries.iter().map(entry).collect();
            }
            other => return Ok(other.clone()),
        }
    }
    Err("its `cfg` refers to itself".to_owned())
}

/// The entry `config` of the metadata of a safetensors file; `None` for anything else.
fn metadata(path: &Path) -> Option<String> {
    let mut file = File::open(path).ok()?;
    let mut length = [0; 8];
    file.read_exact(&mut length).ok()?;
    let length = u64::from_le_bytes(length);
    if length > 100_000_000 {
        return None;
    }
    let mut header = String::new();
    file.take(length).read_to_string(&mut header).ok()?;
    let header: Value = serde_json::from_str(&header).ok()?;
    text(&header, "__metadata__.config").map(ToOwned::to_owned)
}

/// Widths and numbers of layers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sizes {
    pub features: usize,
    /// Channels of tokens of neighbourhoods.
    pub tokens: usize,
    /// Channels of all their heads together.
    pub token_heads: usize,
    /// Hidden channels of the layers that encode offsets.
    pub offsets_hidden: usize,
    /// Hidden channels of the feed-forward layers of neighbourhoods.
    pub tokens_hidden: usize,
    /// Sets of weights for neighbourhoods, one a level.
    pub sets: usize,
    /// Channels of what the updater is given.
    pub input: usize,
    pub hidden: usize,
    /// Hidden channels of its feed-forward layers.
    pub hidden_hidden: usize,
    /// Channels of its answer; 4 are used.
    pub output: usize,
    pub virtual_tracks: usize,
    pub time_depth: usize,
    pub space_depth: usize,
    /// Frames of the table of times.
    pub times: usize,
}

impl Sizes {
    /// Of the checkpoint whose tensors (by the fields' names) are `shapes`.
    pub fn in_checkpoint(shapes: &Shapes, config: &Config) -> Result<Self, String> {
        let of = |name: &str, axis: usize| {
            let size = shapes.get(name).and_then(|shape| shape.get(axis).copied());
            size.filter(|&n| n > 0)
                .ok_or_else(|| format!("{name} is missing or has no axis {axis}"))
        };
        let layers = |prefix: &str, rest: &str| {
            let exists = |i: &usize| shapes.contains_key(&format!("{prefix}.{i}.{rest}"));
            (0..).take_while(exists).count()
        };
        let first = "corr_processor.transformers.0";
        let sizes = Self {
            features: of("corr_processor.in_norm.weight", 0)?,
            tokens: of(&format!("{first}.output_token_1"), 1)?,
            token_heads: of(&format!("{first}.aggr1.to_q.weight"), 0)?,
            offsets_hidden: of("corr_processor.posenc_mlps.0.hidden.weight", 0)?,
            tokens_hidden: of(&format!("{first}.xblock1_2.mlp.fc1.weight"), 0)?,
            sets: layers("corr_processor.posenc_mlps", "hidden.weight"),
            input: of("point_updater.input_transform.weight", 1)?,
            hidden: of("point_updater.input_transform.weight", 0)?,
            hidden_hidden: of("point_updater.time_blocks.0.mlp.fc1.weight", 0)?,
            output: of("point_updater.flow_head.weight", 0)?,
            virtual_tracks: of("point_updater.virtual_tracks", 1)?,
            time_depth: layers("point_updater.time_blocks", "mlp.fc1.weight"),
            space_depth: layers("point_updater.space_virtual_blocks", "mlp.fc1.weight"),
            times: of("time_emb", 1)?,
        };
        sizes.check(
            config,
            of("corr_processor.posenc_mlps.0.norm_in.weight", 0)?,
        )?;
        Ok(sizes)
    }

    fn check(&self, config: &Config, offsets: usize) -> Result<(), String> {
        let fits = |ok: bool, what: String| if ok { Ok(()) } else { Err(what) };
        fits(
            offsets == width(3),
            format!("offsets of {offsets} numbers are those of options that are not known here"),
        )?;
        let (sets, levels) = (self.sets, config.levels);
        fits(
            sets == levels,
            format!("{sets} levels of neighbourhoods where the configuration has {levels}"),
        )?;
        let input = 1 + config.levels * self.tokens + width(6);
        fits(
            self.input == input,
            format!("the updater takes {} numbers, not {input}", self.input),
        )?;
        fits(
            self.output >= 4,
            format!("the updater says {} numbers, not 4", self.output),
        )?;
        let heads = [
            (self.token_heads, config.heads),
            (self.hidden, config.updater_heads),
        ];
        for (width, heads) in heads {
            fits(
                width % heads == 0,
                format!("{width} channels cannot be those of {heads} heads"),
            )?;
        }
        fits(
            self.space_depth > 0 && self.time_depth >= self.space_depth,
            format!(
                "{} layers over time and {} over space",
                self.time_depth, self.space_depth
            ),
        )?;
        fits(
            self.times == config.window,
            format!(
                "times of {} frames for windows of {}",
                self.times, config.window
            ),
        )
    }
}
