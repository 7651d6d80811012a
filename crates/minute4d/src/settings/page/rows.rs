//! What each key does, in one sentence.

/// A key, its type or unit, and what it does.
pub type Row = (&'static str, &'static str, &'static str);

/// A heading, and the rows under it.
pub struct Section {
    pub title: &'static str,
    pub about: &'static str,
    pub rows: &'static [Row],
}

/// Every section of the page.
pub const SECTIONS: &[Section] = &[
    Section {
        title: "The profile",
        about: "The first layer: every other default depends on it.",
        rows: &[(
            "profile",
            "`fast`, `faithful`",
            "The built-in settings to start from; it also decides what has no key. As `--profile`.",
        )],
    },
    Section {
        title: "Reading",
        about: "Which part of a clip is read, and within which limits ([video.md](video.md)).",
        rows: &[
            (
                "video.max_frames",
                "frames",
                "Most frames to train on, evenly spread over the clip; geometry may use up to four times as many. As `--max-frames`.",
            ),
            (
                "video.size",
                "px",
                "Frames are shrunk so that their longest side is at most this. As `--size`.",
            ),
            (
                "video.start_s",
                "s",
                "Frames before this time are left out. As `--start`.",
            ),
            ("video.end_s", "s", "Frames after this time are left out. As `--end`."),
            (
                "video.strict",
                "bool",
                "Damaged frames are an error; else they are left out with a warning. As `--strict-video`.",
            ),
            (
                "video.max_memory_bytes",
                "bytes",
                "A clip whose frames (3 bytes per pixel) take more is refused.",
            ),
            (
                "video.folder_fps",
                "frames per s",
                "Rate of a folder of images, which has no times of its own.",
            ),
            (
                "video.ffmpeg",
                "path",
                "The program that decodes what minute4d does not decode itself.",
            ),
            (
                "video.decoder.memory_mb",
                "MiB",
                "Address space of a decoder process (Linux); 0 derives it from the size of the frames.",
            ),
            (
                "video.decoder.cpu_seconds",
                "s",
                "Processor time of a decoder process (Linux); 0 derives it from the length of the clip.",
            ),
            (
                "video.decoder.idle_seconds",
                "s",
                "A decoder that gives nothing for this long is ended.",
            ),
            (
                "capture.max_memory_bytes",
                "bytes",
                "A capture whose frames (8 bytes per pixel), or one array of whose tracks, take more is refused.",
            ),
        ],
    },
    Section {
        title: "Geometry",
        about: "Cameras, depth, masks and tracks ([geometry.md](geometry.md)).",
        rows: &[
            (
                "geometry.frontend",
                "text",
                "What finds cameras, flow and depth: `auto`, or parts joined by `+`. As `--frontend`.",
            ),
            (
                "geometry.segmenter",
                "`auto`, `none`, `mobilesam`, `sam2`",
                "What segments dynamic objects. As `--segmenter`.",
            ),
            (
                "geometry.tracker",
                "`auto`, `none`, `flow`, `tapip3d`",
                "What tracks points of dynamic objects. As `--tracker`.",
            ),
            (
                "geometry.intrinsics",
                "file or `fx,fy,cx,cy`",
                "The lens, where it is known. As `--intrinsics`.",
            ),
            (
                "geometry.poses",
                "file",
                "A pose for every frame, where they are known. As `--poses`.",
            ),
            (
                "geometry.masks",
                "folder",
                "A mask for every frame, where they are known. As `--masks`.",
            ),
            (
                "geometry.depth",
                "folder",
                "A depth map for every frame, where they are known. As `--depth`.",
            ),
            (
                "sparse.fov_deg",
                "degrees",
                "Horizontal field of view, where it is known. As `--fov`.",
            ),
            (
                "sparse.focal_px",
                "px of the frames",
                "Focal length, where it is known; it takes precedence over `sparse.fov_deg`.",
            ),
            (
                "sparse.static_camera",
                "bool",
                "The camera does not move: depth is made up. As `--static-camera`.",
            ),
            (
                "dense.working_side_px",
                "px",
                "Longest side of the images on which flow, depth and masks are computed.",
            ),
            (
                "dense.memory_mb",
                "MB",
                "Memory for the planes of all frames; longer clips are computed at a smaller size.",
            ),
            (
                "dense.tracks",
                "bool",
                "Points of dynamic objects are tracked along the flow.",
            ),
            (
                "megasam.flow_iterations",
                "count",
                "Iterations of the flow network (`--frontend megasam+raft`).",
            ),
            (
                "megasam.memory_budget_mb",
                "MB",
                "Features and states of MegaSaM's tracking network kept in memory; the rest is on disk.",
            ),
            (
                "megasam.flow_budget_mb",
                "MB",
                "Flow kept in memory; the rest is on disk.",
            ),
            (
                "megasam.default_fov_deg",
                "degrees",
                "Horizontal field of view where neither you nor the depth network gives one.",
            ),
            (
                "enhance.masks.side_px",
                "px",
                "Longest side of the masks while objects are followed through the clip.",
            ),
            (
                "enhance.masks.tau",
                "0 to 1",
                "Motion probability above which a pixel is dynamic (the paper's tau).",
            ),
            (
                "enhance.masks.every_frames",
                "frames",
                "Distance of the frames that are searched for new objects (the paper's B).",
            ),
            (
                "enhance.tapip3d.every",
                "frames",
                "Distance of the frames in which TAPIP3D's points start.",
            ),
            (
                "enhance.tapip3d.spacing_px",
                "px of 480",
                "Distance of TAPIP3D's points in such a frame.",
            ),
            (
                "enhance.tapip3d.most",
                "points",
                "Most points that TAPIP3D tracks; time grows with them.",
            ),
            (
                "enhance.tapip3d.iterations",
                "count",
                "How often TAPIP3D revises each window of 16 frames.",
            ),
            (
                "enhance.tapip3d.size",
                "share",
                "Size of the frames that TAPIP3D sees, as a share of the published one; less is faster.",
            ),
            (
                "enhance.tapip3d.memory_mb",
                "MB",
                "Memory for TAPIP3D: more lets it track more points together.",
            ),
        ],
    },
    Section {
        title: "First splats",
        about: "What training starts from.",
        rows: &[
            ("init.max_static", "splats", "Most static splats."),
            (
                "init.max_dynamic",
                "splats",
                "Most dynamic splats, all frames together; occluded points that are added from other frames not counted.",
            ),
            (
                "init.keyframe_gaps",
                "gaps between frames",
                "Lifetime of dynamic splats: standard deviation of their opacity in time. Not set: that of the paper.",
            ),
            (
                "init.tracks",
                "bool",
                "Occluded points are added from frames that see them, and tracks give initial velocities.",
            ),
        ],
    },
    Section {
        title: "Training",
        about: "",
        rows: &[
            (
                "train.iterations",
                "steps",
                "Length of the training where `train.budget_s` is 0. As `--iterations`.",
            ),
            (
                "train.batch",
                "frames per step",
                "Frames whose gradients are summed in a step.",
            ),
            (
                "train.budget_s",
                "s",
                "Time for the training; the number of steps is derived from it. `--preset` sets it; 0 for `train.iterations`.",
            ),
            (
                "train.seed",
                "number",
                "Seed of every random draw, those of geometry included. As `--seed`.",
            ),
            (
                "train.background",
                "`[r, g, b]`, 0 to 1",
                "Colour behind everything. Not set: the mean colour of pixels without depth.",
            ),
            (
                "train.metrics_every",
                "steps",
                "Distance of the lines of `metrics.jsonl`.",
            ),
            (
                "train.target_cache_mb",
                "MB",
                "Memory for prepared frames; the rest is prepared at each use.",
            ),
            (
                "train.colour_fit.rounds",
                "rounds",
                "Rounds of the least-squares fit of colours after the last step; 0 for none.",
            ),
            (
                "train.loss.lambda_ssim",
                "0 to 1",
                "Weight of 1 - SSIM in the loss, beside L1.",
            ),
            (
                "train.density.enabled",
                "bool",
                "Loss-guided density control (paper section 3.3).",
            ),
            (
                "train.density.frames",
                "frames",
                "Frames scored in a round (the paper's K).",
            ),
            (
                "train.density.error_threshold",
                "0 to 1",
                "Normalised error above which a pixel counts (the paper's tau of equation 8).",
            ),
            (
                "train.density.densify_threshold",
                "score",
                "Splats of a higher score are cloned or split (the paper's tau_den).",
            ),
            (
                "train.density.prune_threshold",
                "normalised score",
                "Splats of a higher score are pruned (the paper's tau_pru).",
            ),
            ("train.density.from", "step", "First step of density control."),
            (
                "train.density.every",
                "steps",
                "Distance of the rounds that clone and split.",
            ),
            (
                "train.density.prune_every",
                "steps",
                "Distance of the rounds that prune by score.",
            ),
            ("train.refine.poses", "bool", "Camera poses are refined."),
            ("train.refine.focal", "bool", "The focal length is refined."),
            (
                "train.refine.exposure",
                "bool",
                "The exposure of every frame is fitted.",
            ),
        ],
    },
    Section {
        title: "Time limit and checkpoints",
        about: "No part of the result ([interruptions.md](interruptions.md)).",
        rows: &[
            (
                "limit.time_s",
                "s",
                "Wall-clock time of the whole run, in which training is planned to end; 0 for no limit. As `--time-limit`.",
            ),
            ("checkpoint.every_s", "s", "Time between two checkpoints."),
            ("checkpoint.keep", "count", "Checkpoints that are kept."),
        ],
    },
    Section {
        title: "Preview and viewer",
        about: "`preview.mp4` and `viewer.html` ([viewer.md](viewer.md)).",
        rows: &[
            ("preview.panel_px", "px", "Longest side of each of the three panels."),
            ("preview.labels", "bool", "The panels are labelled."),
            (
                "preview.min_seconds",
                "s",
                "A shorter clip is repeated until it is this long.",
            ),
            (
                "preview.swing.side_deg",
                "degrees",
                "Largest turn of the swinging camera to either side.",
            ),
            ("preview.swing.up_deg", "degrees", "Largest turn up and down."),
            (
                "preview.swing.period_frames",
                "frames",
                "Length of a swing there and back.",
            ),
            (
                "viewer.write",
                "bool",
                "`viewer.html` is written at the end of a run; off as `--no-viewer`.",
            ),
            (
                "viewer.frames.side_px",
                "px",
                "Longest side of the input frames in the page.",
            ),
            (
                "viewer.frames.bytes",
                "bytes",
                "Size of all input frames in the page; quality and size are reduced to meet it.",
            ),
        ],
    },
];
