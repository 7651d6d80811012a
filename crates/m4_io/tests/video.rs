//! Clips: both decoders, times, sizes, orientation, colours.

use crate::common::{
    ffmpeg, have_encoder, pinwheel, psnr, temporary, times, without_ffmpeg as all,
};
use m4_core::{Plane, RgbImage, Silent, Video};
use m4_io::ErrorKind;
use m4_io::video::{VideoOptions, read};
use std::path::Path;

fn with_ffmpeg() -> VideoOptions {
    VideoOptions {
        size: None,
        ..VideoOptions::default()
    }
}

fn clip(path: &Path, options: &VideoOptions) -> Video {
    read(path, options, &Silent).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn example_clip_is_read_in_order() {
    let video = clip(&pinwheel(), &all());
    assert_eq!(video.frames.len(), 96);
    assert_eq!(video.frames[0].rgb.size(), (480, 360));
    assert!(video.warnings.is_empty(), "{:?}", video.warnings);
    for (i, t) in times(&video).iter().enumerate() {
        assert!((t - i as f64 / 24.0).abs() < 1e-6, "frame {i} at {t}");
    }
}

#[test]
fn thinning_and_shrinking() {
    let options = VideoOptions {
        max_frames: Some(10),
        size: Some(240),
        ..all()
    };
    let video = clip(&pinwheel(), &options);
    assert_eq!(
        (video.frames.len(), video.frames[0].rgb.size()),
        (10, (240, 180))
    );
    assert!((times(&video)[9] - 95.0 / 24.0).abs() < 1e-6);
    assert!(
        video.warnings.iter().any(|w| w.contains("10 of 96")),
        "{:?}",
        video.warnings
    );
    let original = clip(&pinwheel(), &all());
    let small = m4_core::resize_rgb(
        &original.frames[95].rgb,
        240,
        180,
        m4_core::ResizeFilter::Triangle,
    )
    .unwrap();
    assert_eq!(video.frames[9].rgb, small);

    let part = VideoOptions {
        start_s: Some(1.0),
        end_s: Some(2.0),
        ..all()
    };
    let video = clip(&pinwheel(), &part);
    assert_eq!((video.frames.len(), times(&video)[0]), (25, 1.0));
    assert_eq!(video.frames[0].rgb, original.frames[24].rgb);
}

/// The same frames at the same times: chroma is interpolated with other filters, luma is the same.
fn assert_same(own: &Video, theirs: &Video, least_db: f64, what: &str) {
    assert_eq!(own.frames.len(), theirs.frames.len(), "{what}");
    for (a, b) in own.frames.iter().zip(&theirs.frames) {
        let off_s = (a.time_s - b.time_s).abs();
        let db = psnr(&a.rgb, &b.rgb);
        assert!(
            off_s < 2e-3 && db > least_db,
            "{what}: {db} dB, off by {off_s} s at {}",
            a.time_s
        );
    }
}

#[test]
fn streams_of_many_encoders_settings_decode_like_in_ffmpeg() {
    if !have_encoder("libx264") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let input = format!("-i {} -frames:v 40 -vf scale=240:-2", pinwheel().display());
    let settings = [
        "-c:v libx264 -profile:v baseline",
        "-c:v libx264 -profile:v main -bf 3 -x264-params b-pyramid=normal:open-gop=1:keyint=12",
        "-c:v libx264 -preset veryslow -bf 8 -refs 5 -x264-params b-adapt=2:weightp=2:8x8dct=1",
        "-c:v libx264 -tune zerolatency -x264-params slices=4:intra-refresh=1",
        "-c:v libx264 -bf 2 -x264-params cabac=0:keyint=7 -movflags +faststart -bsf:v dump_extra",
    ];
    for (i, setting) in settings.iter().enumerate() {
        let mp4 = dir.path().join(format!("{i}.mp4"));
        let mkv = dir.path().join(format!("{i}.mkv"));
        assert!(ffmpeg(&format!("{input} {setting}"), &mp4), "{setting}");
        assert!(
            ffmpeg(&format!("-i {} -c copy", mp4.display()), &mkv),
            "{setting}"
        );
        let (own, theirs) = (clip(&mp4, &all()), clip(&mkv, &with_ffmpeg()));
        assert!(own.warnings.is_empty(), "{setting}: {:?}", own.warnings);
        assert_eq!(
            (own.frames.len(), theirs.frames.len()),
            (40, 40),
            "{setting}"
        );
        assert_same(&own, &theirs, 38.0, setting);
    }
}

/// The clip `from` with another display matrix (the first of the track header's nine numbers is at
/// the byte after 40 bytes of version, times and volume).
fn with_matrix(from: &Path, matrix: [i32; 4], path: &Path) {
    let mut bytes = std::fs::read(from).unwrap();
    let at = bytes.windows(4).position(|w| w == b"tkhd").unwrap() + 4 + 40;
    let [a, b, c, d] = matrix.map(|v| v * 65536);
    for (i, v) in [a, b, 0, c, d, 0, 0, 0, 1 << 30].into_iter().enumerate() {
        bytes[at + 4 * i..at + 4 * i + 4].copy_from_slice(&v.to_be_bytes());
    }
    std::fs::write(path, bytes).unwrap();
}

/// An image mapped by `x' = a x + c y`, `y' = b x + d y` around its middle: written apart from the
/// reader's own code.
fn mapped(image: &RgbImage, [a, b, c, d]: [i32; 4]) -> RgbImage {
    let (w, h) = (image.width() as i32, image.height() as i32);
    let (width, height) = ((a * w + c * h).abs(), (b * w + d * h).abs());
    let mut out = Plane::filled(width as usize, height as usize, [0u8; 3]);
    for y in 0..h {
        for x in 0..w {
            // Twice the distance from the middle, so that it is a whole number.
            let (u, v) = (2 * x - w + 1, 2 * y - h + 1);
            let (u, v) = (a * u + c * v, b * u + d * v);
            let (u, v) = ((u + width - 1) / 2, (v + height - 1) / 2);
            out[(u as usize, v as usize)] = image[(x as usize, y as usize)];
        }
    }
    out
}

const EIGHT: [[i32; 4]; 8] = [
    [1, 0, 0, 1],
    [0, 1, -1, 0],
    [-1, 0, 0, -1],
    [0, -1, 1, 0],
    [-1, 0, 0, 1],
    [1, 0, 0, -1],
    [0, 1, 1, 0],
    [0, -1, -1, 0],
];

#[test]
fn all_eight_display_matrices_are_applied() {
    let dir = tempfile::tempdir().unwrap();
    let one = VideoOptions {
        max_frames: Some(1),
        ..all()
    };
    let plain = clip(&pinwheel(), &one);
    for matrix in EIGHT {
        let path = dir.path().join("turned.mp4");
        with_matrix(&pinwheel(), matrix, &path);
        let got = clip(&path, &one);
        assert!(
            got.frames[0].rgb == mapped(&plain.frames[0].rgb, matrix),
            "{matrix:?}"
        );
    }
}

#[test]
fn ffmpeg_turns_and_mirrors_alike() {
    if !have_encoder("libx265") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let one = VideoOptions {
        max_frames: Some(1),
        ..with_ffmpeg()
    };
    // 10-bit HEVC, as phones write it, with the matrix of the container.
    let hevc = dir.path().join("hevc.mp4");
    let arguments = format!(
        "-i {} -frames:v 3 -c:v libx265 -pix_fmt yuv420p10le -tag:v hvc1 -x265-params log-level=error:crf=10",
        pinwheel().display()
    );
    assert!(ffmpeg(&arguments, &hevc));
    let plain = clip(&hevc, &one);
    for matrix in EIGHT {
        let path = dir.path().join("turned.mp4");
        with_matrix(&hevc, matrix, &path);
        let got = clip(&path, &one);
        // Turned before chroma is interpolated, so not bit by bit.
        let alike = psnr(&got.frames[0].rgb, &mapped(&plain.frames[0].rgb, matrix));
        assert!(alike > 38.0, "{matrix:?}: {alike} dB");
    }
}

#[test]
fn without_ffmpeg_the_message_names_the_codec_and_the_way_out() {
    if !have_encoder("libx264") {
        return;
    }
    let (_dir, path) = temporary("clip.mp4");
    let input = format!("-i {} -frames:v 2", pinwheel().display());
    let mut cases = vec![
        ("-c:v libx264 -pix_fmt yuv420p10le", "10-bit H.264"),
        ("-c:v libx264 -pix_fmt yuv422p", "4:2:2"),
        (
            "-c:v libx264 -flags +ildct+ilme -x264-params interlaced=1",
            "interlaced H.264",
        ),
    ];
    if have_encoder("libx265") {
        cases.push((
            "-c:v libx265 -tag:v hvc1 -x265-params log-level=error",
            "HEVC",
        ));
    }
    for (setting, name) in cases {
        assert!(ffmpeg(&format!("{input} {setting}"), &path), "{name}");
        let error = read(&path, &all(), &Silent).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Unavailable, "{error}");
        let text = error.to_string();
        assert!(
            text.contains(name) && text.contains("install ffmpeg") && text.contains("libx264"),
            "{text}"
        );
        assert_eq!(clip(&path, &with_ffmpeg()).frames.len(), 2, "{name}");
    }
}

#[test]
fn variable_rate_and_edit_lists_keep_their_times() {
    if !have_encoder("libx264") || !have_encoder("ffv1") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("vfr.mp4");
    // Every frame whose number is not 3, 4 or 7 modulo 10; times are those of the frames that stay.
    let filter = "select=not(eq(mod(n\\,10)\\,3)+eq(mod(n\\,10)\\,4)+eq(mod(n\\,10)\\,7))";
    let arguments = format!(
        "-i {} -vf {filter} -fps_mode passthrough -c:v libx264 -bf 2",
        pinwheel().display()
    );
    assert!(ffmpeg(&arguments, &path));
    let video = clip(&path, &all());
    let want: Vec<f64> = (0..96)
        .filter(|n| ![3, 4, 7].contains(&(n % 10)))
        .map(|n| f64::from(n) / 24.0)
        .collect();
    assert_eq!(video.frames.len(), want.len());
    for (got, want) in times(&video).iter().zip(&want) {
        assert!((got - want).abs() < 1e-3, "{got} {want}");
    }
    // Cut without coding again: the file holds frames before the start, which the edit list hides.
    let cut = dir.path().join("cut.mp4");
    assert!(ffmpeg(
        &format!("-ss 1.0 -i {} -t 1.5 -c copy", pinwheel().display()),
        &cut
    ));
    let (own, original) = (clip(&cut, &all()), clip(&pinwheel(), &all()));
    let mkv = dir.path().join("cut.mkv");
    assert!(ffmpeg(&format!("-i {} -c:v ffv1", cut.display()), &mkv));
    let theirs = clip(&mkv, &with_ffmpeg());
    // 36 frames of 1.5 seconds, one more or less at each end
    assert!(
        (34..=38).contains(&own.frames.len()),
        "{} frames",
        own.frames.len()
    );
    assert_eq!(own.frames.len(), theirs.frames.len());
    assert_eq!(own.frames[0].rgb, original.frames[24].rgb);
    for (a, b) in own.frames.iter().zip(&theirs.frames) {
        assert!((a.time_s - b.time_s).abs() < 2e-3);
    }
}

#[test]
fn matrix_and_range_are_those_of_the_stream() {
    if !have_encoder("libx264") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    // Flat patches of known colours, coded almost without loss.
    let colours = [
        [250, 20, 30],
        [20, 240, 40],
        [30, 20, 230],
        [128, 128, 128],
        [255, 255, 255],
        [0, 0, 0],
    ];
    let image = Plane::from_fn(192, 64, |x, _| colours[x / 32]);
    let png = dir.path().join("patches.png");
    m4_io::image::write_rgb(&png, &image).unwrap();
    for (name, matrix, range, tags) in [
        (
            "601-tv",
            "bt601",
            "tv",
            "-colorspace smpte170m -color_range tv",
        ),
        ("709-tv", "bt709", "tv", "-colorspace bt709 -color_range tv"),
        ("709-pc", "bt709", "pc", "-colorspace bt709 -color_range pc"),
        (
            "601-pc",
            "bt601",
            "pc",
            "-colorspace smpte170m -color_range pc",
        ),
    ] {
        let path = dir.path().join(format!("{name}.mp4"));
        let arguments = format!(
            "-loop 1 -i {} -frames:v 2 -vf scale=out_color_matrix={matrix}:out_range={range},format=yuv420p -c:v libx264 -qp 1 {tags}",
            png.display()
        );
        assert!(ffmpeg(&arguments, &path), "{name}");
        let got = clip(&path, &all());
        for (i, want) in colours.iter().enumerate() {
            let pixel = got.frames[0].rgb[(32 * i + 16, 32)];
            let off = pixel.iter().zip(want).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(
                off <= Some(4),
                "{name}: {pixel:?} where {want:?} was expected"
            );
        }
    }
}

#[test]
fn high_dynamic_range_is_tone_mapped_with_a_warning() {
    if !have_encoder("libx264") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let grey = Plane::from_fn(256, 64, |x, _| [x as u8; 3]);
    let png = dir.path().join("ramp.png");
    m4_io::image::write_rgb(&png, &grey).unwrap();
    let mut codecs = vec![("libx264", "yuv420p")];
    if have_encoder("libx265") {
        codecs.push(("libx265 -x265-params log-level=error", "yuv420p10le"));
    }
    for (name, transfer) in [("PQ", "smpte2084"), ("HLG", "arib-std-b67")] {
        for &(codec, format) in &codecs {
            let path = dir.path().join(format!("{name}-{format}.mp4"));
            let arguments = format!(
                "-loop 1 -i {} -frames:v 2 -vf scale=out_color_matrix=bt2020:out_range=tv,format={format} -c:v {codec} \
                 -crf 4 -color_primaries bt2020 -color_trc {transfer} -colorspace bt2020nc -color_range tv",
                png.display()
            );
            assert!(ffmpeg(&arguments, &path), "{name} {format}");
            let video = clip(&path, &with_ffmpeg());
            assert!(
                video.warnings.iter().any(|w| w.contains(name)),
                "{name} {format}: {:?}",
                video.warnings
            );
            let row = video.frames[0].rgb.row(32);
            let white = if name == "PQ" { 148 } else { 191 };
            assert!(
                (205..=245).contains(&row[white][1]),
                "{name} {format}: {:?}",
                row[white]
            );
            for pair in row.windows(2) {
                assert!(
                    i32::from(pair[1][1]) - i32::from(pair[0][1]) > -6,
                    "{name} {format}"
                );
            }
        }
    }
}

/// As phones film: upright, in 4K, at a variable rate near 60 frames per second, in HEVC of 10 bits
/// and HLG.
#[test]
fn portrait_4k_hdr_of_variable_rate_is_read_upright() {
    if !have_encoder("libx265") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let (lying, upright) = (dir.path().join("lying.mov"), dir.path().join("upright.mov"));
    // Frames 2 and 3 were not taken.
    let arguments = format!(
        "-i {} -frames:v 5 -vf setpts=N/60/TB,select=not(eq(n\\,2)+eq(n\\,3)),scale=3840:2160:out_color_matrix=bt2020:\
         out_range=tv,setsar=1,format=yuv420p10le -fps_mode passthrough -enc_time_base 1/600 -c:v libx265 -preset ultrafast -tag:v \
         hvc1 -x265-params log-level=error:crf=12 -color_primaries bt2020 -color_trc arib-std-b67 -colorspace bt2020nc \
         -color_range tv",
        pinwheel().display()
    );
    assert!(ffmpeg(&arguments, &lying));
    with_matrix(&lying, [0, 1, -1, 0], &upright);
    let options = VideoOptions::default();
    let one = VideoOptions {
        max_frames: Some(1),
        ..options.clone()
    };
    let (plain, video) = (clip(&lying, &one), clip(&upright, &options));
    let ticks = [0.0, 1.0, 4.0, 5.0, 6.0];
    assert_eq!(video.frames.len(), ticks.len());
    for (time_s, tick) in times(&video).iter().zip(ticks) {
        assert!((time_s - tick / 60.0).abs() < 2e-3, "{time_s} {tick}");
    }
    assert!(
        video.warnings.iter().any(|w| w.contains("HLG")),
        "{:?}",
        video.warnings
    );
    assert_eq!(video.frames[0].rgb.size(), (360, 640));
    let alike = psnr(
        &video.frames[0].rgb,
        &mapped(&plain.frames[0].rgb, [0, 1, -1, 0]),
    );
    assert!(alike > 36.0, "{alike} dB");
}

#[test]
fn pixels_that_are_not_square_become_square() {
    if !have_encoder("libx264") || !have_encoder("ffv1") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let input = format!(
        "-i {} -frames:v 2 -vf scale=360:360,setsar=4/3",
        pinwheel().display()
    );
    for (name, setting) in [("own.mp4", "-c:v libx264"), ("other.mkv", "-c:v ffv1")] {
        let path = dir.path().join(name);
        assert!(ffmpeg(&format!("{input} {setting}"), &path), "{name}");
        assert_eq!(
            clip(&path, &with_ffmpeg()).frames[0].rgb.size(),
            (480, 360),
            "{name}"
        );
    }
}

#[test]
fn a_folder_of_images_is_a_clip() {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..12u8 {
        let image = Plane::filled(32, 24, [i * 20, 0, 0]);
        m4_io::image::write_rgb(&dir.path().join(format!("f{i}.png")), &image).unwrap();
    }
    std::fs::write(dir.path().join("notes.txt"), "not an image").unwrap();
    let options = VideoOptions {
        folder_fps: 10.0,
        ..all()
    };
    let video = clip(dir.path(), &options);
    assert_eq!(video.frames.len(), 12);
    for (i, frame) in video.frames.iter().enumerate() {
        assert_eq!(
            (frame.rgb[(0, 0)][0], frame.time_s),
            (i as u8 * 20, i as f64 / 10.0)
        );
    }
}

#[test]
fn exif_orientation_and_focal_length_are_applied() {
    // Orientation 6 (turn 90 degrees clockwise) and 26 mm on 35 mm film, as phones write them.
    let mut tiff = b"II*\0\x08\0\0\0".to_vec();
    tiff.extend([2, 0]);
    tiff.extend([0x12, 0x01, 3, 0, 1, 0, 0, 0, 6, 0, 0, 0]);
    tiff.extend([0x69, 0x87, 4, 0, 1, 0, 0, 0, 38, 0, 0, 0, 0, 0, 0, 0]);
    tiff.extend([1, 0, 0x05, 0xa4, 3, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0, 0, 0, 0]);
    let dir = tempfile::tempdir().unwrap();
    for i in 0..2 {
        let path = dir.path().join(format!("IMG_{i}.JPG"));
        // Dark on the left: after the turn, dark at the top.
        let image = Plane::from_fn(400, 300, |x, _| [if x < 200 { 20 } else { 220 }; 3]);
        m4_io::image::write_rgb(&path, &image).unwrap();
        let jpeg = std::fs::read(&path).unwrap();
        let mut with_exif = jpeg[..2].to_vec();
        with_exif.extend([0xff, 0xe1]);
        with_exif.extend((tiff.len() as u16 + 8).to_be_bytes());
        with_exif.extend(b"Exif\0\0");
        with_exif.extend(&tiff);
        with_exif.extend(&jpeg[2..]);
        std::fs::write(&path, with_exif).unwrap();
    }
    let half = VideoOptions {
        size: Some(200),
        ..all()
    };
    for (options, scale) in [(all(), 1.0), (half, 0.5)] {
        let video = clip(dir.path(), &options);
        let rgb = &video.frames[0].rgb;
        let (w, h) = rgb.size();
        assert_eq!((w, h), ((300.0 * scale) as usize, (400.0 * scale) as usize));
        assert!(rgb[(w / 2, 5)][0] < 60 && rgb[(w / 2, h - 5)][0] > 180);
        // The diagonal is 500 pixels.
        let want = 26.0 / 43.266_615 * 500.0 * scale;
        assert!(
            (video.focal_px.unwrap() - want).abs() < 1e-6,
            "{:?} {want}",
            video.focal_px
        );
    }
}
