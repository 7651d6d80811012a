//! What helps against a failure or a weak result, as phrases in messages. A program names its
//! option behind each.

/// The field of view is not known well enough.
pub const FIELD_OF_VIEW: &str = "give the true field of view";
/// A static camera is mistaken for a moving one.
pub const STATIC_CAMERA: &str = "declare the camera static";
/// Dynamic regions are not found, or too many are.
pub const MASKS: &str = "give masks of what moves";
/// Depth cannot be measured.
pub const DEPTH: &str = "give depth maps";
/// The lens is not known well enough.
pub const INTRINSICS: &str = "give the intrinsics of the lens";
/// A data set names files that lie elsewhere.
pub const OUTSIDE: &str = "allow files outside of it";
/// A GPU is missing, fails or has too little memory.
pub const CPU: &str = "use the CPU";
/// The limit of GPU memory is too low.
pub const GPU_MEMORY: &str = "raise the limit of GPU memory";
/// A port is taken.
pub const PORT: &str = "choose another port";
/// Earlier work can be continued.
pub const RESUME: &str = "continue it";
/// Earlier results can be replaced.
pub const REPLACE: &str = "replace it";
/// The time limit is too short.
pub const TIME_LIMIT: &str = "allow more time";
/// A network of the front end is missing.
pub const CLASSICAL: &str = "use the front end classical";
/// A network for masks is missing.
pub const NO_SEGMENTER: &str = "use no segmenter";
/// A network for tracks is missing.
pub const FLOW_TRACKER: &str = "use the tracker flow";
/// A licence forbids commercial use.
pub const LICENCE: &str = "accept the licence";
/// A network would give depth that parallax does not give.
pub const DEPTH_WEIGHTS: &str = "get the weights of MoGe-2 S (0.14 GB, MIT) for its depth";
/// A network would give better masks.
pub const MASK_WEIGHTS: &str = "get the weights of MobileSAM (0.04 GB, Apache-2.0) for its masks";
/// A clip has several shots.
pub const SHOT: &str = "choose another shot";
/// Too many or too few frames of a clip are used.
pub const FRAMES: &str = "set the number of frames";

/// Every phrase.
pub const ALL: [&str; 20] = [
    FIELD_OF_VIEW,
    STATIC_CAMERA,
    MASKS,
    DEPTH,
    INTRINSICS,
    OUTSIDE,
    CPU,
    GPU_MEMORY,
    PORT,
    RESUME,
    REPLACE,
    TIME_LIMIT,
    CLASSICAL,
    NO_SEGMENTER,
    FLOW_TRACKER,
    LICENCE,
    DEPTH_WEIGHTS,
    MASK_WEIGHTS,
    SHOT,
    FRAMES,
];
