//! The script that Slurm starts once for each task of the array.

use super::SubmitError;
use std::path::{Path, PathBuf};

/// Seconds before the end of a task's time at which it is told to save.
const WARNING_S: u32 = 120;
/// How often a task is put back into the queue by itself.
const RESTARTS: u32 = 20;

/// What the user asks of Slurm.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// GPUs a task.
    pub gpus: Option<u32>,
    /// Most tasks at work at once.
    pub max_parallel: Option<u32>,
    /// Time of a task, as Slurm writes it.
    pub time: Option<String>,
    /// The partition.
    pub partition: Option<String>,
    /// Cores a task.
    pub cpus: Option<u32>,
    /// Memory of a task, as Slurm writes it.
    pub memory: Option<String>,
    /// Where scenes are made.
    pub scratch: Option<PathBuf>,
    /// Anything else, as `sbatch` takes it.
    pub more: Vec<String>,
}

/// What the script needs to know.
#[derive(Debug)]
pub struct Script<'a> {
    /// The program.
    pub program: &'a Path,
    /// The manifest.
    pub manifest: &'a Path,
    /// Where each task writes what it says.
    pub logs: &'a Path,
    /// Jobs of the manifest.
    pub jobs: usize,
    /// Most tasks that an array may have.
    pub largest: usize,
    /// The user's wishes.
    pub options: &'a Options,
    /// Further arguments of the worker.
    pub worker: &'a [String],
}

impl Script<'_> {
    /// Tasks of the array; each does every so many of the jobs.
    #[must_use]
    pub fn tasks(&self) -> usize {
        self.jobs.min(self.largest).max(1)
    }

    /// The text of it.
    ///
    /// # Errors
    ///
    /// [`SubmitError::Text`] for a value that cannot be written into a script.
    pub fn text(&self) -> Result<String, SubmitError> {
        let (tasks, o) = (self.tasks(), self.options);
        let parallel = o.max_parallel.map_or_else(String::new, |n| format!("%{}", n.max(1)));
        let mut text = "#!/bin/bash\n# Written by `minute4d batch submit`.\n".to_owned();
        let mut directives = vec![
            "--job-name=minute4d".to_owned(),
            format!("--array=0-{}{parallel}", tasks - 1),
            "--requeue".to_owned(),
            // to this shell alone, which passes it on and waits
            format!("--signal=B:TERM@{WARNING_S}"),
            "--open-mode=append".to_owned(),
            format!("--output={}/%A_%a.log", utf8(self.logs)?),
        ];
        let named = [
            ("--gres=gpu:", o.gpus.map(|n| n.to_string())),
            ("--time=", o.time.clone()),
            ("--partition=", o.partition.clone()),
            ("--cpus-per-task=", o.cpus.map(|n| n.to_string())),
            ("--mem=", o.memory.clone()),
        ];
        directives.extend(
            named
                .into_iter()
                .filter_map(|(name, value)| Some(format!("{name}{}", value?))),
        );
        directives.extend(o.more.iter().cloned());
        for directive in &directives {
            text += &format!("#SBATCH {}\n", directive_text(directive)?);
        }
        let mut worker = vec![
            utf8(self.program)?.to_owned(),
            "batch".to_owned(),
            "run".to_owned(),
            "--manifest".to_owned(),
            utf8(self.manifest)?.to_owned(),
            "--stride".to_owned(),
            tasks.to_string(),
        ];
        if let Some(scratch) = &o.scratch {
            worker.extend(["--scratch".to_owned(), utf8(scratch)?.to_owned()]);
        }
        worker.extend(self.worker.iter().cloned());
        let worker: Vec<String> = worker.iter().map(|word| shell(word)).collect::<Result<_, _>>()?;
        text += &BODY
            .replace("@WORKER@", &worker.join(" "))
            .replace("@RESTARTS@", &RESTARTS.to_string());
        Ok(text)
    }
}

/// `wait` returns early when the signal comes, so it is asked again until it tells the worker's own code. The task is
/// named by array and index: the last of an array has the number of the whole. A task that was cancelled is not put back.
const BODY: &str = r#"
set -u
worker= told= again=
stop() {
    told=1 again=1
    [ -z "$worker" ] || kill -TERM "$worker" 2>/dev/null
}
trap stop TERM

@WORKER@ &
worker=$!
[ -z "$told" ] || kill -TERM "$worker"
while :; do
    again=
    wait "$worker"
    answer=$?
    [ "$answer" -eq 127 ] && [ -n "${code-}" ] && break
    code=$answer
    [ -n "$again" ] || break
done

if [ "$code" -eq 75 ]; then
    task="${SLURM_ARRAY_JOB_ID}_${SLURM_ARRAY_TASK_ID}"
    if [ "${SLURM_RESTART_COUNT:-0}" -ge @RESTARTS@ ]; then
        echo "minute4d: @RESTARTS@ restarts are enough; submit again to go on" >&2
    elif [ "$(squeue -h -j "$task" -o %T)" != RUNNING ]; then
        echo "minute4d: Slurm ends the task itself" >&2
    else
        echo "minute4d: to be tried again (restart ${SLURM_RESTART_COUNT:-0})" >&2
        scontrol requeue "$task" && exit 0
        echo "minute4d: Slurm did not take the task back" >&2
    fi
fi
exit "$code"
"#;

fn utf8(path: &Path) -> Result<&str, SubmitError> {
    path.to_str().ok_or_else(|| SubmitError::Text {
        text: path.display().to_string(),
        reason: "it is not UTF-8",
    })
}

/// A word of a directive, in quotes where it needs them.
fn directive_text(text: &str) -> Result<String, SubmitError> {
    if text.contains(['\n', '\r', '"', '\\']) {
        return Err(SubmitError::Text {
            text: text.to_owned(),
            reason: "a line of #SBATCH cannot hold quotes, backslashes or a line end",
        });
    }
    Ok(if text.contains([' ', '\t', '#']) {
        format!("\"{text}\"")
    } else {
        text.to_owned()
    })
}

/// A word that the shell takes as it is.
fn shell(word: &str) -> Result<String, SubmitError> {
    if word.contains('\0') {
        return Err(SubmitError::Text {
            text: word.to_owned(),
            reason: "no argument can hold a zero byte",
        });
    }
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-=+:,@%".contains(c);
    Ok(if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    })
}

#[cfg(test)]
mod tests {
    use super::{Options, Script};
    use std::fs;
    use std::path::Path;
    use std::process::Command;

    fn script<'a>(options: &'a Options, program: &'a Path, jobs: usize, worker: &'a [String]) -> Script<'a> {
        Script {
            program,
            manifest: Path::new("/data/my jobs/it's.jsonl"),
            logs: Path::new("/data/my jobs/logs"),
            jobs,
            largest: 1001,
            options,
            worker,
        }
    }

    #[test]
    fn directives_are_as_asked_and_the_array_fits() {
        let options = Options {
            gpus: Some(1),
            max_parallel: Some(64),
            time: Some("02:00:00".to_owned()),
            more: vec!["--account=me".to_owned()],
            ..Options::default()
        };
        let program = Path::new("/opt/minute4d");
        let text = script(&options, program, 5000, &[]).text().unwrap();
        for line in [
            "#SBATCH --array=0-1000%64",
            "#SBATCH --requeue",
            "#SBATCH --signal=B:TERM@120",
            "#SBATCH --open-mode=append",
            "#SBATCH --gres=gpu:1",
            "#SBATCH --time=02:00:00",
            "#SBATCH --account=me",
            "#SBATCH \"--output=/data/my jobs/logs/%A_%a.log\"",
        ] {
            assert!(text.lines().any(|l| l == line), "{line}\n{text}");
        }
        assert!(
            text.contains(r"--manifest '/data/my jobs/it'\''s.jsonl' --stride 1001"),
            "{text}"
        );
        let small = script(&options, program, 3, &[]).text().unwrap();
        assert!(small.contains("--array=0-2%64") && small.contains("--stride 3"));
        let bad = Options {
            partition: Some("a\n#SBATCH --uid=0".to_owned()),
            ..Options::default()
        };
        assert!(script(&bad, program, 3, &[]).text().is_err());
    }

    /// The script with a stand-in for the worker and for `scontrol`; gives its exit code and what they wrote.
    #[cfg(unix)]
    fn drive(worker: &str, restarts: &str, term: bool) -> (Option<i32>, String) {
        drive_in("RUNNING", worker, restarts, term)
    }

    #[cfg(unix)]
    fn drive_in(state: &str, worker: &str, restarts: &str, term: bool) -> (Option<i32>, String) {
        let dir = tempfile::tempdir().unwrap();
        // Made by another process: one that is forked here meanwhile would hold it open for writing.
        let write = |name: &str, text: &str| {
            let (text_file, path) = (dir.path().join(format!("{name}.txt")), dir.path().join(name));
            fs::write(&text_file, format!("#!/bin/bash\n{text}\n")).unwrap();
            let status = Command::new("install")
                .args(["-m", "755"])
                .args([&text_file, &path])
                .status();
            assert!(status.unwrap().success());
            path
        };
        let heard = dir.path().join("heard");
        let program = write("worker", &worker.replace("HEARD", heard.to_str().unwrap()));
        write("scontrol", &format!("echo \"$@\" >> {}", heard.display()));
        write("squeue", &format!("echo {state}"));
        let options = Options::default();
        let text = script(&options, &program, 3, &[]).text().unwrap();
        let file = write("job", &text);
        let path = format!("{}:{}", dir.path().display(), std::env::var("PATH").unwrap());
        let mut child = Command::new("bash")
            .arg(&file)
            .env("PATH", path)
            .envs([
                ("SLURM_ARRAY_JOB_ID", "42"),
                ("SLURM_ARRAY_TASK_ID", "7"),
                ("SLURM_RESTART_COUNT", restarts),
            ])
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        if term {
            while !fs::read_to_string(&heard).is_ok_and(|t| t.contains("ready")) {
                assert!(child.try_wait().unwrap().is_none(), "it ended too soon");
                std::thread::sleep(std::time::Duration::from_millis(10));
            }
            assert!(
                Command::new("kill")
                    .args(["-TERM", &child.id().to_string()])
                    .status()
                    .unwrap()
                    .success()
            );
        }
        let code = child.wait().unwrap().code();
        (code, fs::read_to_string(&heard).unwrap_or_default())
    }

    #[cfg(unix)]
    #[test]
    fn the_script_ends_as_its_worker_does() {
        assert_eq!(drive("exit 0", "0", false), (Some(0), String::new()));
        assert_eq!(drive("exit 65", "0", false), (Some(65), String::new()));
        let (code, heard) = drive("exit 75", "3", false);
        assert_eq!((code, heard.trim()), (Some(0), "requeue 42_7"));
        assert_eq!(
            drive("exit 75", "20", false),
            (Some(75), String::new()),
            "enough is enough"
        );
        let cancelled = drive_in("CANCELLED", "exit 75", "0", false);
        assert_eq!(cancelled, (Some(75), String::new()), "who cancels means it");
    }

    #[cfg(unix)]
    #[test]
    fn a_signal_is_passed_on_and_the_worker_waited_for() {
        let worker =
            "trap 'sleep 0.5; echo saved >> HEARD; exit 75' TERM; echo ready >> HEARD; while :; do sleep 0.05; done";
        let (code, heard) = drive(worker, "0", true);
        assert_eq!(code, Some(0));
        assert_eq!(heard.lines().collect::<Vec<_>>(), ["ready", "saved", "requeue 42_7"]);
    }
}
