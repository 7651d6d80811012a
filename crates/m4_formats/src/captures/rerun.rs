//! A capture as a recording of Rerun (`.rrd`), to look at: `rerun capture.rrd`.
//!
//! ```text
//! world                       right, down, forward
//! world/points                points of what rests
//! world/path                  the way of the camera
//! world/camera                pose a frame (timelines `frame`, and `time` in seconds where that is known)
//! world/camera/image          pinhole and picture (JPEG)
//!                   /depth    z-depth, 16-bit PNG; a metre is a world unit
//!                   /moves    what moves: 1
//!                   /things   which thing a pixel shows
//! world/tracks                followed points, in their colours; grey where hidden
//! world/held_out/N/...        views of other cameras, at their moments
//! ```
//!
//! Identifiers inside are made of the clock, so that two recordings of one capture differ in bytes. Nothing is sent anywhere.

use super::WriteCaptureAsError;
use super::check::check;
use super::points::of_what_rests;
use crate::{Loss, WriteFileError, Written};
use m4_io::capture::depth_unit;
use m4_io::image;
use m4_scene::{Capture, CaptureFrame, Plane, Progress, Tracks};
use re_sdk::external::re_log_encoding::Decoder;
use re_sdk::log::{Chunk, LogMsg};
use re_sdk::{AsComponents, RecordingStream, RecordingStreamBuilder};
use re_sdk_types::archetypes::{
    AnnotationContext, EncodedDepthImage, EncodedImage, LineStrips3D, Pinhole, Points3D, SegmentationImage,
    Transform3D, ViewCoordinates,
};
use re_sdk_types::components::MediaType;
use re_sdk_types::datatypes::{ChannelDatatype, ClassDescription, ImageFormat, Rgba32};
use std::fmt::Display;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;

const MAX_POINTS: usize = 100_000;
/// Of a point that something hides.
const HIDDEN: [u8; 3] = [128; 3];
/// The side of a picture in the view of the world, of the median depth.
const PICTURE_DISTANCE: f64 = 0.15;
const CAMERA: &str = "world/camera";

/// Writes a capture, and held-out views beside it, whole or not at all.
///
/// # Errors
///
/// [`WriteCaptureAsError`].
pub fn write(
    path: &Path,
    train: &Capture,
    test: Option<&Capture>,
    progress: &dyn Progress,
) -> Result<Written, WriteCaptureAsError> {
    check(path, train)?;
    if let Some(test) = test {
        check(path, test)?;
    }
    let parent = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let io = |e| WriteFileError::io(path, e);
    fs::create_dir_all(parent).map_err(io)?;
    let folder = tempfile::Builder::new()
        .prefix(".minute4d-")
        .tempdir_in(parent)
        .map_err(io)?;
    let recording = folder.path().join("capture.rrd");
    let name = path
        .file_stem()
        .map_or_else(|| "capture".to_owned(), |s| s.to_string_lossy().into_owned());
    let out = Recorder {
        path,
        scratch: folder.path(),
        unit: depth_unit(train),
        duration_s: train.duration_s,
        last: train.time_frames.max(2) as f64 - 1.0,
        stream: RecordingStreamBuilder::new("minute4d")
            .recording_name(name)
            // whatever the environment says of recordings of other programs
            .enabled(true)
            .save(&recording)
            .map_err(|e| said(path, &e))?,
    };
    out.world(train)?;
    let total = train.frames.len() + test.map_or(0, |t| t.frames.len());
    let distance = PICTURE_DISTANCE * median_depth(train);
    for (i, frame) in train.frames.iter().enumerate() {
        out.frame(CAMERA, frame, distance, i, total, progress)?;
        if let Some(tracks) = &train.tracks {
            out.tracks(tracks, i)?;
        }
    }
    for (i, view) in test.map_or(&[][..], |t| &t.frames).iter().enumerate() {
        let entity = format!("world/held_out/{i}");
        out.frame(&entity, view, distance, train.frames.len() + i, total, progress)?;
    }
    out.stream.flush_blocking().map_err(|e| said(path, &e))?;
    // closes the file
    out.stream.disconnect();
    let found = poses(&recording).map_err(|why| WriteFileError::verify(path, why))?;
    if found != train.frames.len() {
        let why = format!("it has {found} poses of {}", train.frames.len());
        return Err(WriteFileError::verify(path, why).into());
    }
    let bytes = fs::metadata(&recording).map_err(io)?.len();
    File::open(&recording).and_then(|f| f.sync_all()).map_err(io)?;
    fs::rename(&recording, path).map_err(io)?;
    let mut losses = vec![Loss::Quantised("pictures to JPEG, poses to 32 bits".to_owned())];
    if train.frames.iter().any(|f| f.depth.is_some()) {
        losses.push(Loss::Quantised(format!(
            "depth to steps of {:.3e} world units",
            out.unit
        )));
    }
    Ok(Written {
        path: path.to_path_buf(),
        bytes,
        splats: 0,
        losses,
    })
}

struct Recorder<'a> {
    path: &'a Path,
    scratch: &'a Path,
    stream: RecordingStream,
    /// World units a step of depth.
    unit: f64,
    duration_s: Option<f64>,
    last: f64,
}

impl Recorder<'_> {
    fn log(&self, entity: &str, what: &dyn AsComponents) -> Result<(), WriteCaptureAsError> {
        self.stream.log(entity, what).map_err(|e| said(self.path, &e))
    }

    fn always(&self, entity: &str, what: &dyn AsComponents) -> Result<(), WriteCaptureAsError> {
        self.stream.log_static(entity, what).map_err(|e| said(self.path, &e))
    }

    fn at(&self, t: f64) {
        self.stream.set_time_sequence("frame", t.round() as i64);
        if let Some(duration_s) = self.duration_s {
            self.stream.set_duration_secs("time", t / self.last * duration_s);
        }
    }

    /// What does not change.
    fn world(&self, train: &Capture) -> Result<(), WriteCaptureAsError> {
        self.always("world", &ViewCoordinates::RDF())?;
        let kinds = [(0, "rests", [0, 0, 0, 0]), (1, "moves", [255, 96, 0, 160])];
        let kinds = kinds.map(|(id, name, [r, g, b, a])| {
            ClassDescription::from((id, name, Rgba32::from_unmultiplied_rgba(r, g, b, a)))
        });
        // of all below
        self.always("world", &AnnotationContext::new(kinds))?;
        let points = of_what_rests(train, MAX_POINTS);
        if !points.is_empty() {
            let places = points.iter().map(|p| p.position);
            let colours = points.iter().map(|p| Rgba32::from(p.colour));
            self.always("world/points", &Points3D::new(places).with_colors(colours))?;
        }
        let path: Vec<[f64; 3]> = train.frames.iter().map(|f| f.camera.centre().into()).collect();
        self.always("world/path", &LineStrips3D::new([path]))
    }

    fn frame(
        &self,
        entity: &str,
        frame: &CaptureFrame,
        distance: f64,
        done: usize,
        total: usize,
        progress: &dyn Progress,
    ) -> Result<(), WriteCaptureAsError> {
        if progress.cancelled() {
            return Err(WriteCaptureAsError::Cancelled {
                path: self.path.to_path_buf(),
            });
        }
        self.at(frame.t);
        let (c2w, k) = (frame.camera.c2w, frame.camera.intrinsics);
        // both types have their matrices by columns
        let columns = |m: [[f64; 3]; 3]| m.map(|column| column.map(|v| v as f32));
        let rotation: [[f64; 3]; 3] = c2w.rotation.into();
        let place: [f64; 3] = c2w.translation.into();
        let pose = Transform3D::from_mat3x3(columns(rotation)).with_translation(place);
        self.log(entity, &pose)?;
        let image = format!("{entity}/image");
        let lens = Pinhole::new(columns([[k.fx, 0.0, 0.0], [0.0, k.fy, 0.0], [k.cx, k.cy, 1.0]]))
            .with_resolution([k.width as f32, k.height as f32])
            .with_image_plane_distance(distance as f32);
        self.log(&image, &lens)?;
        let file = self.scratch.join("frame.jpg");
        image::write_rgb(&file, &frame.rgb)?;
        let picture = EncodedImage::new(self.bytes(&file)?).with_media_type(MediaType::jpeg());
        self.log(&image, &picture)?;
        if let Some(depth) = &frame.depth {
            let file = self.scratch.join("depth.png");
            image::write_depth(&file, &depth.to_map(), self.unit)?;
            let depth = EncodedDepthImage::new(self.bytes(&file)?)
                .with_media_type(MediaType::png())
                .with_meter((1.0 / self.unit) as f32);
            self.log(&format!("{image}/depth"), &depth)?;
        }
        if let Some(mask) = &frame.mask {
            let (w, h) = mask.size();
            let moves = Plane::from_fn(w, h, |x, y| u8::from(mask.at(x, y)));
            let format = ImageFormat::segmentation([w as u32, h as u32], ChannelDatatype::U8);
            self.log(
                &format!("{image}/moves"),
                &SegmentationImage::new(moves.data().to_vec(), format),
            )?;
        }
        if let Some(ids) = &frame.instances {
            let (w, h) = ids.size();
            let bytes: Vec<u8> = ids.to_plane().data().iter().flat_map(|id| id.to_le_bytes()).collect();
            let format = ImageFormat::segmentation([w as u32, h as u32], ChannelDatatype::U16);
            self.log(&format!("{image}/things"), &SegmentationImage::new(bytes, format))?;
        }
        progress.update("write frames", done + 1, total, "");
        Ok(())
    }

    /// The followed points of frame `i`.
    fn tracks(&self, tracks: &Tracks, i: usize) -> Result<(), WriteCaptureAsError> {
        let known: Vec<usize> = (0..tracks.count()).filter(|&k| tracks.place(i, k).is_some()).collect();
        let places = known.iter().filter_map(|&k| tracks.place(i, k));
        let colour = |&k: &usize| {
            let seen = tracks.visible()[i * tracks.count() + k];
            let own = tracks.colours().map_or([255, 96, 0], |c| c[k]);
            Rgba32::from(if seen { own } else { HIDDEN })
        };
        self.log(
            "world/tracks",
            &Points3D::new(places).with_colors(known.iter().map(colour)),
        )
    }

    fn bytes(&self, file: &Path) -> Result<Vec<u8>, WriteFileError> {
        fs::read(file).map_err(|e| WriteFileError::io(self.path, e))
    }
}

fn said(path: &Path, error: &dyn Display) -> WriteCaptureAsError {
    WriteCaptureAsError::Recorder {
        path: path.to_path_buf(),
        what: error.to_string(),
    }
}

/// Poses of the camera in a recording.
fn poses(recording: &Path) -> Result<usize, String> {
    let file = File::open(recording).map_err(|e| e.to_string())?;
    let messages = Decoder::<LogMsg>::decode_eager(BufReader::new(file)).map_err(|e| e.to_string())?;
    let mut rows = 0;
    for message in messages {
        if let LogMsg::ArrowMsg(_, message) = message.map_err(|e| e.to_string())? {
            let chunk = Chunk::from_arrow_msg(&message).map_err(|e| e.to_string())?;
            if chunk.entity_path() == &CAMERA.into() {
                rows += chunk.num_rows();
            }
        }
    }
    Ok(rows)
}

fn median_depth(capture: &Capture) -> f64 {
    let depths = capture.frames.iter().filter_map(|f| f.depth.as_ref());
    let mut known: Vec<f32> = depths
        .flat_map(|d| d.every(64))
        .filter(|z| z.is_finite() && *z > 0.0)
        .collect();
    known.sort_by(f32::total_cmp);
    known.get(known.len() / 2).map_or(1.0, |&z| f64::from(z))
}
