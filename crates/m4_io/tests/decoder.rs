//! Decoders in processes of their own: the same images, and errors of the clip where they fail.

#[cfg(unix)]
use crate::common::{PROBED, fake_ffmpeg, script, sent};
use crate::common::{ffmpeg, have_ffmpeg, pinwheel, says, temporary, without_ffmpeg};
use m4_core::{CounterRng, Progress, Silent, Video};
use m4_io::video::{DecoderLimits, DecoderProgram, VideoOptions, read, read_with};
use m4_io::{DecoderEnd, ErrorKind, Fault, ReadError};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

fn program() -> DecoderProgram {
    DecoderProgram::new(env!("CARGO_BIN_EXE_m4_decode_h264"), "decode")
}

fn options(limits: DecoderLimits) -> VideoOptions {
    VideoOptions {
        decoder: limits,
        ..without_ffmpeg()
    }
}

fn limits(set: impl FnOnce(&mut DecoderLimits)) -> DecoderLimits {
    let mut limits = DecoderLimits::default();
    set(&mut limits);
    limits
}

/// How the decoder failed; checks that nothing is held against the clip and that the message says
/// all that it must.
fn failure(result: Result<Video, ReadError>, words: &[&str]) -> DecoderEnd {
    let Err(error) = result else {
        panic!("it was decoded")
    };
    let text = error.to_string();
    assert_eq!(error.kind(), ErrorKind::Unavailable, "{text}");
    says(&text, words);
    match error.fault {
        Fault::Decoder { how, .. } => how,
        other => panic!("{other:?}"),
    }
}

/// The same images at the same times.
fn same(a: &Video, b: &Video) -> bool {
    let pairs = || a.frames.iter().zip(&b.frames);
    a.frames.len() == b.frames.len() && pairs().all(|(a, b)| a.time_s == b.time_s && a.rgb == b.rgb)
}

#[test]
fn child_process_decodes_identical_frames() {
    let options = options(DecoderLimits::default());
    let local = read_with(None, &pinwheel(), &options, &Silent).unwrap();
    let isolated = read_with(Some(&program()), &pinwheel(), &options, &Silent).unwrap();
    assert_eq!(
        (local.frames.len(), &local.warnings),
        (96, &isolated.warnings)
    );
    assert!(same(&local, &isolated));
    let part = VideoOptions {
        max_frames: Some(7),
        start_s: Some(1.0),
        size: Some(200),
        ..options
    };
    let local = read_with(None, &pinwheel(), &part, &Silent).unwrap();
    let isolated = read_with(Some(&program()), &pinwheel(), &part, &Silent).unwrap();
    assert!(same(&local, &isolated) && local.frames.len() == 7);
}

/// The example with some bytes of its coded images, and now and then of its index, replaced.
fn damaged(case: u32, original: &[u8], mdat: usize) -> Vec<u8> {
    let mut rng = CounterRng::new(17, 0, u64::from(case));
    let mut bytes = original.to_vec();
    for _ in 0..1 + case % 7 {
        let (start, end) = match case % 8 {
            0 => (0, mdat),
            // The first image has 53,848 bytes, and all others need it.
            1 => (mdat + 8, mdat + 53_000),
            _ => (mdat + 54_000, mdat + 280_000),
        };
        let at = start + rng.below(end.min(bytes.len()) - start);
        bytes[at] = rng.below(256) as u8;
    }
    bytes
}

#[test]
fn damaged_clips_never_crash_the_parent() {
    let original = std::fs::read(pinwheel()).unwrap();
    let mdat = original.windows(4).position(|w| w == b"mdat").unwrap();
    let (_dir, path) = temporary("clip.mp4");
    let part = VideoOptions {
        end_s: Some(0.7),
        size: Some(64),
        ..options(DecoderLimits::default())
    };
    let (mut whole_clips, mut with_warnings, mut refused) = (0, 0, 0);
    for case in 0..160 {
        std::fs::write(&path, damaged(case, &original, mdat)).unwrap();
        let isolated = read_with(Some(&program()), &path, &part, &Silent);
        match &isolated {
            Ok(video) if video.warnings.is_empty() => whole_clips += 1,
            Ok(_) => with_warnings += 1,
            // A crash of OpenH264 would be one of these.
            Err(error) => {
                assert!(
                    matches!(
                        error.kind(),
                        ErrorKind::BadData | ErrorKind::Unsupported | ErrorKind::Unavailable
                    ),
                    "case {case}: {error}"
                );
                refused += 1;
            }
        }
        // What the child survived, this process does too.
        if let Err(e) = &isolated
            && matches!(e.fault, Fault::Decoder { .. })
        {
            eprintln!("case {case}: {e}");
            continue;
        }
        match (isolated, read_with(None, &path, &part, &Silent)) {
            (Ok(isolated), Ok(local)) => {
                assert!(
                    same(&isolated, &local) && isolated.warnings == local.warnings,
                    "case {case}"
                );
            }
            (Err(isolated), Err(local)) => {
                assert_eq!(isolated.to_string(), local.to_string(), "case {case}")
            }
            (isolated, local) => panic!(
                "case {case}: {:?} there, {:?} here",
                isolated.err(),
                local.err()
            ),
        }
    }
    eprintln!("{whole_clips} whole, {with_warnings} with warnings, {refused} refused");
    // The damage reaches the decoder.
    assert!(
        with_warnings > 10 && refused > 0,
        "{with_warnings} {refused}"
    );
}

#[test]
fn a_decoder_that_is_not_there() {
    let nowhere = DecoderProgram::new("/nowhere/decoder", "decode");
    let error = read_with(
        Some(&nowhere),
        &pinwheel(),
        &options(DecoderLimits::default()),
        &Silent,
    )
    .unwrap_err();
    assert!(error.to_string().contains("/nowhere/decoder"), "{error}");
    // This is no clip's fault.
    assert_eq!(error.kind(), ErrorKind::Io);
}

/// Reads the example with a script as its decoder.
#[cfg(unix)]
fn with_fake(
    body: &str,
    limits: DecoderLimits,
    progress: &dyn Progress,
) -> Result<Video, ReadError> {
    let dir = tempfile::tempdir().unwrap();
    let fake = DecoderProgram::new(script(dir.path(), "fake", body), "decode");
    read_with(Some(&fake), &pinwheel(), &options(limits), progress)
}

/// How a decoder must have failed.
#[cfg(unix)]
#[track_caller]
fn assert_end(how: &DecoderEnd, want: &str, case: &str) {
    let actual = format!("{how:?}");
    assert!(
        actual.starts_with(want),
        "{actual} where {want} was expected: {case}"
    );
}

#[cfg(unix)]
#[test]
fn decoders_that_crash_hang_or_talk_without_end() {
    let (usual, patience) = (DecoderLimits::default(), limits(|l| l.idle_seconds = 1));
    let ready = "printf 'm4h264\\000\\001\\001'";
    let idle = "Idle { seconds: 1 }";
    let waits = &["nothing came from it for 1 s", "idle_seconds"][..];
    let cases: [(&str, &str, &[&str]); 13] = [
        (
            "kill -KILL $$",
            "Signal { signal: 9 }",
            &["H.264 decoder", "SIGKILL"],
        ),
        ("kill -SEGV $$", "Signal { signal: 11 }", &["SIGSEGV"]),
        (
            "head -c 20 >/dev/null; kill -ABRT $$",
            "Signal { signal: 6 }",
            &[],
        ),
        (
            "echo it is broken >&2; exit 3",
            "Answer",
            &["it is broken", "3"],
        ),
        // As loud as a decoder, and no decoder.
        (
            "echo hello, hello; cat >/dev/null",
            "Answer",
            &["does not answer"],
        ),
        // Agreed, and then gone: no shorter answer passes for an image.
        ("READY; exit 0", "Answer", &["ended early"]),
        (
            "READY; printf '\\002abc'; exit 0",
            "Answer",
            &["ended early"],
        ),
        (
            "READY; printf '\\011'; cat >/dev/null",
            "Answer",
            &["answer 9"],
        ),
        ("sleep 600", idle, waits),
        // Takes everything and says nothing; or talks, and decodes nothing.
        ("cat >/dev/null; sleep 600", idle, waits),
        (
            "READY; while :; do echo working >&2; sleep 0.2; done",
            idle,
            waits,
        ),
        // Lets go of its output, and stays.
        ("exec >&- ; sleep 600", idle, waits),
        (
            "exec yes >&2",
            "Messages { read_mb: 1 }",
            &["MiB of messages"],
        ),
    ];
    for (body, want, words) in cases {
        let limits = if want == idle { patience } else { usual };
        let start = Instant::now();
        let how = failure(
            with_fake(&body.replace("READY", ready), limits, &Silent),
            words,
        );
        assert_end(&how, want, body);
        assert!(start.elapsed() < Duration::from_secs(30), "{body}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn decoders_that_take_too_much() {
    // `tail` keeps a line until it ends.
    let (tail, memory) = ("exec tail -n 1 /dev/zero", limits(|l| l.memory_mb = 200));
    let how = failure(with_fake(tail, memory, &Silent), &["200 MiB", "memory_mb"]);
    assert_eq!(how, DecoderEnd::Memory { limit_mb: 200 });
    let (spin, cpu) = ("while :; do :; done", limits(|l| l.cpu_seconds = 1));
    let how = failure(
        with_fake(spin, cpu, &Silent),
        &["longer than the 1 s", "cpu_seconds"],
    );
    assert_eq!(how, DecoderEnd::Cpu { limit_s: 1 });
    // Files: 1 MiB, no core dump. A bare child runs before it is limited: it waits until it is.
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("filled");
    let limited = "until [ \"$(ulimit -f)\" != unlimited ]; do sleep 0.01; done";
    let body = format!(
        "{limited}; exec head -c 9000000 /dev/zero >{}",
        file.display()
    );
    failure(
        with_fake(&body, DecoderLimits::default(), &Silent),
        &["pinwheel.mp4"],
    );
    assert_eq!(std::fs::metadata(&file).unwrap().len(), 1 << 20);
}

/// Stops when a file is there.
struct StopAt<'a>(&'a Path, AtomicUsize);

impl Progress for StopAt<'_> {
    fn update(&self, _: &str, _: usize, _: usize, _: &str) {}
    fn warn(&self, _: &str) {}
    fn cancelled(&self) -> bool {
        let stop = self.0.is_file();
        self.1.fetch_add(usize::from(stop), Ordering::Relaxed);
        stop
    }
}

#[cfg(target_os = "linux")]
#[test]
fn stopping_ends_the_child_and_what_it_started() {
    let dir = tempfile::tempdir().unwrap();
    let note = dir.path().join("pids");
    // The grandchild holds the pipes open.
    let body = format!(
        "sleep 600 & echo $$ $! >{0}.new; mv {0}.new {0}; wait",
        note.display()
    );
    let stop = StopAt(&note, AtomicUsize::new(0));
    let start = Instant::now();
    let error = with_fake(&body, DecoderLimits::default(), &stop).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Cancelled, "{error}");
    assert!(stop.1.load(Ordering::Relaxed) > 0 && start.elapsed() < Duration::from_secs(30));
    for pid in std::fs::read_to_string(&note).unwrap().split_whitespace() {
        let gone = || {
            let status = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
            // Another process reaps the grandchild: it is in state Z until then.
            status.is_empty() || status.contains(") Z ") || status.contains(") X ")
        };
        let deadline = Instant::now() + Duration::from_secs(20);
        while !gone() {
            assert!(Instant::now() < deadline, "process {pid} is still there");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

/// A clip for ffmpeg, and a folder with programs under its names.
#[cfg(unix)]
fn with_fake_ffmpeg(
    launcher: Option<&DecoderProgram>,
    probe: &str,
    decode: &str,
    limits: DecoderLimits,
) -> Result<Video, ReadError> {
    let dir = tempfile::tempdir().unwrap();
    let (clip, options) = fake_ffmpeg(dir.path(), probe, decode);
    read_with(
        launcher,
        &clip,
        &VideoOptions {
            decoder: limits,
            ..options
        },
        &Silent,
    )
}

/// ffmpeg started by this process, and by a program that limits itself first.
#[cfg(unix)]
#[test]
fn hanging_crashing_or_verbose_ffmpeg_is_stopped() {
    let (usual, patience) = (DecoderLimits::default(), limits(|l| l.idle_seconds = 1));
    let memory = limits(|l| l.memory_mb = 300);
    let (idle, crash) = ("Idle { seconds: 1 }", "Signal { signal: 11 }");
    let talk = "exec yes '[h264 @ 0x1] [error] broken' >&2";
    let endless = "!exec tr '\\0' x </dev/zero >&2";
    let no_memory = "echo '[h264 @ 0x1] [error] Cannot allocate memory' >&2; exit 1";
    let unread = "echo '[error] clip.mkv: Input/output error' >&2; exit 1";
    // What ffprobe does, and ffmpeg after the first image, or in its place (`!`).
    let not_read = format!("!{unread}");
    let cases: [(&str, &str, &str, &[&str]); 11] = [
        (
            PROBED,
            "sleep 600",
            idle,
            &["ffmpeg failed", "idle_seconds"],
        ),
        (
            PROBED,
            "kill -SEGV $$",
            crash,
            &["ffmpeg failed", "SIGSEGV"],
        ),
        (PROBED, talk, "Messages", &["MiB of messages"]),
        // No line end ever.
        (PROBED, endless, "Messages", &["MiB of messages"]),
        (PROBED, no_memory, "Memory { limit_mb: 300 }", &["300 MiB"]),
        ("sleep 600", "!", idle, &["ffprobe failed", "idle_seconds"]),
        ("kill -SEGV $$", "!", crash, &["ffprobe failed", "SIGSEGV"]),
        ("exec yes >&2", "!", "Messages", &["ffprobe failed"]),
        // Bytes are bad where a decoder says so, and nowhere else.
        (unread, "!", "Answer", &["failed", "clip.mkv"]),
        (PROBED, &not_read, "Answer", &["failed"]),
        (PROBED, "!exit 1", "Answer", &["failed", "clip.mkv"]),
    ];
    let bad = "echo '[error] clip.mkv: Invalid data found when processing input' >&2; exit 1";
    for launcher in [None, Some(program())] {
        let read = |probe: &str, decode: &str, limits| {
            with_fake_ffmpeg(launcher.as_ref(), probe, decode, limits)
        };
        let video = read(PROBED, &sent(0..3), usual).unwrap();
        let counts = (video.frames.len(), video.warnings.len());
        assert_eq!(counts, (3, 0), "{:?}", video.warnings);
        for (probe, decode, want, words) in cases {
            let limits = match want {
                _ if want == idle => patience,
                _ if want.starts_with("Memory") => memory,
                _ => usual,
            };
            let body = match decode.strip_prefix('!') {
                Some(alone) => alone.to_owned(),
                None => sent(0..1) + decode,
            };
            let how = failure(read(probe, &body, limits), words);
            assert_end(&how, want, &body);
        }
        // An end by its own decision leaves what was decoded.
        let video = read(PROBED, &(sent(0..1) + "exit 1"), usual).unwrap();
        assert_eq!(video.frames.len(), 1);
        assert!(
            video.warnings[0].contains("only 1 of 3 frames"),
            "{:?}",
            video.warnings
        );
        for (probe, decode) in [(bad, ""), (PROBED, bad)] {
            let error = read(probe, decode, usual).err().unwrap();
            assert_eq!(error.kind(), ErrorKind::BadData, "{error}");
        }
    }
}

#[cfg(target_os = "linux")]
#[test]
fn the_real_ffmpeg_obeys_limits() {
    if !have_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let clip = dir.path().join("clip.mkv");
    if !ffmpeg(
        "-f lavfi -i testsrc2=size=3840x2160:rate=24 -frames:v 12 -c:v ffv1",
        &clip,
    ) {
        return;
    }
    let with = |limits| VideoOptions {
        size: Some(64),
        decoder: limits,
        ..VideoOptions::default()
    };
    let usual = with(DecoderLimits::default());
    let few = with(limits(|l| l.memory_mb = 64));
    for launcher in [None, Some(program())] {
        let read = |options| read_with(launcher.as_ref(), &clip, options, &Silent);
        assert_eq!(read(&usual).unwrap().frames.len(), 12);
        let how = failure(read(&few), &["clip.mkv", "64 MiB"]);
        assert_eq!(how, DecoderEnd::Memory { limit_mb: 64 });
    }
}

#[test]
fn a_clip_cannot_name_other_files() {
    if !have_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let other = dir.path().join("secret.ts");
    assert!(ffmpeg(
        &format!("-i {} -c copy -frames:v 8", pinwheel().display()),
        &other
    ));
    let options = VideoOptions {
        size: Some(64),
        ..VideoOptions::default()
    };
    assert_eq!(read(&other, &options, &Silent).unwrap().frames.len(), 8);
    let lists = [
        ("concat.txt", "ffconcat version 1.0\nfile secret.ts\n"),
        (
            "list.m3u8",
            "#EXTM3U\n#EXT-X-TARGETDURATION:4\n#EXTINF:4,\nsecret.ts\n#EXT-X-ENDLIST\n",
        ),
        (
            "clip.mp4",
            "#EXTM3U\n#EXT-X-TARGETDURATION:4\n#EXTINF:4,\nsecret.ts\n#EXT-X-ENDLIST\n",
        ),
        (
            "remote.sdp",
            "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n",
        ),
    ];
    for (name, text) in lists {
        let list = dir.path().join(name);
        std::fs::write(&list, text).unwrap();
        let error = read(&list, &options, &Silent).unwrap_err();
        let text = error.to_string();
        assert!(
            error.kind() == ErrorKind::BadData && text.contains("not a video"),
            "{name}: {text}"
        );
    }
}
