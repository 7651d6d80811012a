//! Encodes a clip as H.264, several pieces of it at a time.
//!
//! A piece begins with a frame at which a player can enter, and has an encoder and a thread of its
//! own: bytes do not depend on the number of threads.

use super::colour::{Planes420, YuvMatrix};
use m4_core::RgbImage;
use openh264::OpenH264API;
use openh264::encoder::{
    BitRate, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, Profile, QpRange,
    RateControlMode, VuiConfig,
};
use openh264::formats::YUVSlices;
use std::collections::VecDeque;
use std::panic::resume_unwind;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};

/// Bits per second that the encoder asks for. It steers nothing in the mode that is used here.
const NOMINAL_BITS_PER_S: u32 = 2_000_000;
/// Images that wait to be encoded, bytes. Two may always wait.
const WAITING_BYTES: usize = 128 << 20;

/// A coded frame.
pub(super) struct Coded {
    pub bytes: Vec<u8>,
    /// Whether a player can enter here.
    pub key: bool,
}

/// Why a clip cannot be encoded.
pub(super) enum Refused {
    /// The encoder says so.
    Encoder(openh264::Error),
    /// A frame was left out, or a thread could not be started.
    Other(String),
}

impl From<openh264::Error> for Refused {
    fn from(error: openh264::Error) -> Self {
        Self::Encoder(error)
    }
}

/// Encodes frames of one size. Coded frames come back in the order of the images, later.
pub(super) struct Pieces {
    fps: f64,
    matrix: YuvMatrix,
    /// Least and most quantisation.
    qp: (u8, u8),
    /// Frames of a piece.
    length: usize,
    /// Pieces at a time.
    most: usize,
    waiting: Arc<Waiting>,
    running: VecDeque<Piece>,
}

/// A piece that is being encoded.
struct Piece {
    /// `None` when it has all its images.
    images: Option<Sender<Image>>,
    n_images: usize,
    thread: JoinHandle<Result<Vec<Coded>, Refused>>,
}

impl Pieces {
    /// Prepares for images of `size` at `fps` frames a second. Every `length`th frame is coded by
    /// itself. `qp`: least and most quantisation.
    pub fn new(
        size: (usize, usize),
        fps: f64,
        matrix: YuvMatrix,
        qp: (u8, u8),
        length: usize,
    ) -> Self {
        let most = (WAITING_BYTES / (3 * size.0 * size.1).max(1)).max(2);
        Self {
            fps,
            matrix,
            qp,
            length,
            most: rayon::current_num_threads(),
            waiting: Arc::new(Waiting {
                left: Mutex::new(most),
                freed: Condvar::new(),
            }),
            running: VecDeque::new(),
        }
    }

    /// Takes the next image, when there is room for it. Returns the next frames that are coded.
    pub fn push(&mut self, image: RgbImage) -> Result<Vec<Coded>, Refused> {
        let mut out = Vec::new();
        if self
            .running
            .back()
            .is_none_or(|piece| piece.n_images == self.length)
        {
            self.close();
            while self.running.len() >= self.most {
                out.extend(self.oldest()?);
            }
            self.start()?;
        }
        let image = Image::new(image, &self.waiting);
        let Some(piece) = self.running.back_mut() else {
            return Ok(out);
        };
        piece.n_images += 1;
        let refused = piece
            .images
            .as_ref()
            .is_some_and(|images| images.send(image).is_err());
        // its thread has failed and says why
        while refused && !self.running.is_empty() {
            out.extend(self.oldest()?);
        }
        Ok(out)
    }

    /// Returns the rest of the frames.
    pub fn finish(mut self) -> Result<Vec<Coded>, Refused> {
        self.close();
        let mut out = Vec::new();
        while !self.running.is_empty() {
            out.extend(self.oldest()?);
        }
        Ok(out)
    }

    fn close(&mut self) {
        if let Some(piece) = self.running.back_mut() {
            piece.images = None;
        }
    }

    fn start(&mut self) -> Result<(), Refused> {
        let (sender, images) = channel();
        let (fps, matrix, qp) = (self.fps, self.matrix, self.qp);
        let thread = thread::Builder::new()
            .name("encoder".to_owned())
            .spawn(move || encode(images, fps, &matrix, qp));
        let thread = thread
            .map_err(|error| Refused::Other(format!("no thread for it can be started: {error}")))?;
        self.running.push_back(Piece {
            images: Some(sender),
            n_images: 0,
            thread,
        });
        Ok(())
    }

    /// Waits for the oldest piece.
    fn oldest(&mut self) -> Result<Vec<Coded>, Refused> {
        let Some(Piece { images, thread, .. }) = self.running.pop_front() else {
            return Ok(Vec::new());
        };
        drop(images);
        thread.join().unwrap_or_else(|panic| resume_unwind(panic))
    }
}

/// How many more images may wait.
struct Waiting {
    left: Mutex<usize>,
    freed: Condvar,
}

impl Waiting {
    fn lock(&self) -> MutexGuard<'_, usize> {
        self.left.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// An image that waits, until it is dropped.
struct Image {
    rgb: RgbImage,
    waiting: Arc<Waiting>,
}

impl Image {
    fn new(rgb: RgbImage, waiting: &Arc<Waiting>) -> Self {
        let mut left = waiting.lock();
        while *left == 0 {
            left = waiting
                .freed
                .wait(left)
                .unwrap_or_else(PoisonError::into_inner);
        }
        *left -= 1;
        Self {
            rgb,
            waiting: waiting.clone(),
        }
    }
}

impl Drop for Image {
    fn drop(&mut self) {
        *self.waiting.lock() += 1;
        self.waiting.freed.notify_one();
    }
}

/// Encodes one piece.
fn encode(
    images: Receiver<Image>,
    fps: f64,
    matrix: &YuvMatrix,
    qp: (u8, u8),
) -> Result<Vec<Coded>, Refused> {
    let config = EncoderConfig::new()
        .profile(Profile::High)
        .vui(VuiConfig::bt709())
        .max_frame_rate(FrameRate::from_hz(fps as f32))
        .bitrate(BitRate::from_bps(NOMINAL_BITS_PER_S))
        // Constant quality: of all modes the one that follows the range of QP and nothing else.
        .rate_control_mode(RateControlMode::Bufferbased)
        .qp(QpRange::new(qp.0, qp.1))
        // The first frame is the only one at which a player can enter.
        .intra_frame_period(IntraFramePeriod::from_num_frames(0))
        // Every frame counts, and one thread so that the bytes do not depend on the machine.
        .skip_frames(false)
        .background_detection(false)
        .num_threads(1);
    let mut encoder = Encoder::with_api_config(OpenH264API::from_source(), config)?;
    let mut out = Vec::new();
    for image in images {
        let planes = Planes420::new(&image.rgb, matrix);
        drop(image);
        let [cb, cr] = &planes.chroma;
        let half = planes.width / 2;
        let source = YUVSlices::new(
            (&planes.luma, cb, cr),
            (planes.width, planes.height),
            (planes.width, half, half),
        );
        let coded = encoder.encode(&source)?;
        let key = matches!(coded.frame_type(), FrameType::IDR | FrameType::I);
        let bytes = coded.to_vec();
        if bytes.is_empty() {
            return Err(Refused::Other("the encoder left out a frame".to_owned()));
        }
        out.push(Coded { bytes, key });
    }
    Ok(out)
}
