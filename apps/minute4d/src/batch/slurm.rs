//! A batch as an array of Slurm jobs.

use minute4d::{Category, Refusal};
use std::ffi::OsStr;
use std::fmt;
use std::path::Path;
use std::process::Command;

/// Seconds before the end of a task's time at which it is asked to save.
const WARNING_S: u32 = 120;
/// How often a task is put back into the queue by itself.
const RESTARTS: u32 = 20;

/// What the script needs to know.
#[derive(Debug)]
pub struct Script<'a> {
    /// The program.
    pub program: &'a Path,
    /// The manifest.
    pub manifest: &'a Path,
    /// Log file of each task.
    pub logs: &'a Path,
    /// Jobs of the manifest.
    pub jobs: usize,
    /// Most tasks that an array may have.
    pub largest: usize,
    /// Most tasks of an array at work at once.
    pub max_parallel: Option<u32>,
    /// The user's own options, as `sbatch` takes them.
    pub options: &'a [String],
}

impl Script<'_> {
    /// The arrays that all jobs take, one task a job: the first job of each, and its indices as
    /// Slurm writes them.
    pub fn arrays(&self) -> Vec<(usize, String)> {
        let largest = self.largest.max(1);
        let parallel = self
            .max_parallel
            .map_or_else(String::new, |n| format!("%{n}"));
        let array = |first: usize| {
            let last = largest.min(self.jobs - first) - 1;
            (first, format!("0-{last}{parallel}"))
        };
        (0..self.jobs).step_by(largest).map(array).collect()
    }

    /// The text of it. Its argument is the first job of its array, 0 where there is none.
    /// A value that cannot be written into a script is an error.
    pub fn text(&self) -> Result<String, Refusal> {
        let mut text = "#!/bin/bash\n# Written by `minute4d batch submit`.\n".to_owned();
        let mut directives = vec![
            "--job-name=minute4d".to_owned(),
            "--requeue".to_owned(),
            // to this shell alone, which passes it on and waits
            format!("--signal=B:TERM@{WARNING_S}"),
            "--open-mode=append".to_owned(),
            format!("--output={}/%A_%a.log", utf8(self.logs)?),
        ];
        directives.extend(
            self.arrays()
                .first()
                .map(|(_, tasks)| format!("--array={tasks}")),
        );
        directives.extend_from_slice(self.options);
        for directive in &directives {
            text += &format!("#SBATCH {}\n", directive_text(directive)?);
        }
        let job = [
            utf8(self.program)?,
            "batch",
            "run",
            "--manifest",
            utf8(self.manifest)?,
        ];
        let job: Vec<String> = job.into_iter().map(shell).collect::<Result<_, _>>()?;
        text += &BODY
            .replace("@JOB@", &job.join(" "))
            .replace("@RESTARTS@", &RESTARTS.to_string());
        Ok(text)
    }
}

/// `wait` returns early when the signal comes, so it is asked again until it tells the job's own
/// code. The task is named by array and index: the last of an array has the number of the whole. 75
/// is what should be tried again, 137 what was killed, as where memory ran out. A task that was
/// cancelled is not put back.
const BODY: &str = r#"
set -u
job= told= again=
stop() {
    told=1 again=1
    [ -z "$job" ] || kill -TERM "$job" 2>/dev/null
}
trap stop TERM

@JOB@ --index $((SLURM_ARRAY_TASK_ID + ${1:-0})) &
job=$!
[ -z "$told" ] || kill -TERM "$job"
while :; do
    again=
    wait "$job"
    answer=$?
    [ "$answer" -eq 127 ] && [ -n "${code-}" ] && break
    code=$answer
    [ -n "$again" ] || break
done

if [ "$code" -eq 75 ] || [ "$code" -eq 137 ]; then
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

/// The error for a value that no script can hold.
fn unusable(text: impl fmt::Debug, reason: &str) -> Refusal {
    Refusal::bad_input(format!("{text:?} cannot be used: {reason}"))
}

/// The error for a program of Slurm that refused.
fn refused(program: &str, message: &str, script: &Path) -> Refusal {
    let message = format!(
        "{program} refused: {message}; the script is {}",
        script.display()
    );
    Refusal::new(Category::Io, message)
}

fn utf8(path: &Path) -> Result<&str, Refusal> {
    path.to_str()
        .ok_or_else(|| unusable(path, "it is not UTF-8"))
}

/// A word of a directive, in quotes where it needs them.
fn directive_text(text: &str) -> Result<String, Refusal> {
    if text.contains(['\n', '\r', '"', '\\']) {
        return Err(unusable(
            text,
            "a line of #SBATCH cannot hold quotes, backslashes or a line end",
        ));
    }
    Ok(if text.contains([' ', '\t', '#']) {
        format!("\"{text}\"")
    } else {
        text.to_owned()
    })
}

/// A word that the shell takes as it is.
fn shell(word: &str) -> Result<String, Refusal> {
    if word.contains('\0') {
        return Err(unusable(word, "no argument can hold a zero byte"));
    }
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-=+:,@%".contains(c);
    Ok(if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    })
}

/// What Slurm allows where it does not say.
const DEFAULT_ARRAY: usize = 1001;

/// Returns the maximum number of tasks of an array: Slurm's setting, or its default.
pub fn largest_array() -> usize {
    let told = Command::new("scontrol").args(["show", "config"]).output();
    let text = told
        .ok()
        .filter(|o| o.status.success())
        .and_then(|o| String::from_utf8(o.stdout).ok());
    text.as_deref()
        .and_then(max_array_size)
        .unwrap_or(DEFAULT_ARRAY)
}

/// `MaxArraySize`, which is one more than the highest index: as many tasks as it says fit.
fn max_array_size(config: &str) -> Option<usize> {
    let line = config
        .lines()
        .find_map(|l| l.trim().strip_prefix("MaxArraySize"))?;
    line.trim_start()
        .strip_prefix('=')?
        .trim()
        .parse()
        .ok()
        .filter(|&n| n > 0)
}

/// Submits the script as the array `tasks` of the jobs from `first` on, asks Slurm for it again,
/// and gives its number.
pub fn submit(script: &Path, first: usize, tasks: &str) -> Result<String, Refusal> {
    let (array, index) = (format!("--array={tasks}"), first.to_string());
    let mut arguments: Vec<&OsStr> = vec!["--parsable".as_ref()];
    // The script itself has the first array.
    if first > 0 {
        arguments.push(array.as_ref());
    }
    arguments.extend([script.as_os_str(), index.as_ref()]);
    let answer = call("sbatch", &arguments, script)?;
    // The cluster's name follows where there are several.
    let id = answer
        .trim()
        .split(';')
        .next()
        .unwrap_or_default()
        .to_owned();
    if id.is_empty() || !id.chars().all(|c| c.is_ascii_digit()) {
        let message = format!("it answered {answer:?}, which is not a job id");
        return Err(refused("sbatch", &message, script));
    }
    let reply = call(
        "scontrol",
        &["show".as_ref(), "job".as_ref(), id.as_ref()],
        script,
    )?;
    if !reply.contains(&format!("={id}")) {
        let message = format!("it does not know job {id} although sbatch took it");
        return Err(refused("scontrol", &message, script));
    }
    Ok(id)
}

fn call(program: &str, args: &[&OsStr], script: &Path) -> Result<String, Refusal> {
    let output = Command::new(program).args(args).output();
    let output = output.map_err(|source| {
        let hint = "submit on a machine that has Slurm, or use --dry-run to write only the script";
        Refusal::new(
            Category::NoInput,
            format!("cannot start {program}: {source}; {hint}"),
        )
    })?;
    if !output.status.success() {
        return Err(refused(
            program,
            String::from_utf8_lossy(&output.stderr).trim(),
            script,
        ));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::{Script, max_array_size};
    use std::fs;
    use std::path::Path;
    use std::process::Command;

    fn script<'a>(options: &'a [String], program: &'a Path, jobs: usize) -> Script<'a> {
        Script {
            program,
            manifest: Path::new("/data/my jobs/it's.jsonl"),
            logs: Path::new("/data/my jobs/logs"),
            jobs,
            largest: 1001,
            max_parallel: Some(64),
            options,
        }
    }

    #[test]
    fn directives_match_options_and_each_job_is_in_one_array() {
        let options = ["--gres=gpu:1", "--time=02:00:00"].map(str::to_owned);
        let program = Path::new("/opt/minute4d");
        let large = script(&options, program, 2003);
        let text = large.text().unwrap();
        for line in [
            "#SBATCH --array=0-1000%64",
            "#SBATCH --requeue",
            "#SBATCH --signal=B:TERM@120",
            "#SBATCH --open-mode=append",
            "#SBATCH --gres=gpu:1",
            "#SBATCH --time=02:00:00",
            "#SBATCH \"--output=/data/my jobs/logs/%A_%a.log\"",
        ] {
            assert!(text.lines().any(|l| l == line), "{line}\n{text}");
        }
        assert!(
            text.contains(r"--manifest '/data/my jobs/it'\''s.jsonl' --index "),
            "{text}"
        );
        let arrays = |jobs: usize| script(&options, program, jobs).arrays();
        let array = |first: usize, tasks: &str| (first, format!("{tasks}%64"));
        assert_eq!(
            large.arrays(),
            [
                array(0, "0-1000"),
                array(1001, "0-1000"),
                array(2002, "0-0")
            ]
        );
        assert_eq!(arrays(3), [array(0, "0-2")]);
        assert!(arrays(0).is_empty());
        let bad = ["--partition=a\n#SBATCH --uid=0".to_owned()];
        assert!(script(&bad, program, 3).text().is_err());
    }

    /// The script with a stand-in for the job and for `scontrol`; gives its exit code and what they
    /// wrote.
    #[cfg(unix)]
    fn drive(job: &str, restarts: &str, term: bool) -> (Option<i32>, String) {
        drive_in("RUNNING", job, restarts, term)
    }

    #[cfg(unix)]
    fn drive_in(state: &str, job: &str, restarts: &str, term: bool) -> (Option<i32>, String) {
        let dir = tempfile::tempdir().unwrap();
        // Made by another process: one that is forked here meanwhile would hold it open for
        // writing.
        let write = |name: &str, text: &str| {
            let (text_file, path) = (
                dir.path().join(format!("{name}.txt")),
                dir.path().join(name),
            );
            fs::write(&text_file, format!("#!/bin/bash\n{text}\n")).unwrap();
            let status = Command::new("install")
                .args(["-m", "755"])
                .args([&text_file, &path])
                .status();
            assert!(status.unwrap().success());
            path
        };
        let heard = dir.path().join("heard");
        let program = write("minute4d", &job.replace("HEARD", heard.to_str().unwrap()));
        write("scontrol", &format!("echo \"$@\" >> {}", heard.display()));
        write("squeue", &format!("echo {state}"));
        let text = script(&[], &program, 3).text().unwrap();
        let file = write("script", &text);
        let path = format!(
            "{}:{}",
            dir.path().display(),
            std::env::var("PATH").unwrap()
        );
        let mut child = Command::new("bash")
            .arg(&file)
            .arg("1001")
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
    fn the_script_ends_as_its_job_does() {
        assert_eq!(drive("exit 0", "0", false), (Some(0), String::new()));
        assert_eq!(drive("exit 65", "0", false), (Some(65), String::new()));
        for retryable in [
            "exit 75",
            "kill -KILL $$",
            "case \"$*\" in *' --index 1008') exit 75;; esac",
        ] {
            let (code, heard) = drive(retryable, "3", false);
            assert_eq!(
                (code, heard.trim()),
                (Some(0), "requeue 42_7"),
                "{retryable}"
            );
        }
        assert_eq!(
            drive("exit 75", "20", false),
            (Some(75), String::new()),
            "enough is enough"
        );
        let cancelled = drive_in("CANCELLED", "exit 75", "0", false);
        assert_eq!(
            cancelled,
            (Some(75), String::new()),
            "a cancelled job is not requeued"
        );
    }

    #[cfg(unix)]
    #[test]
    fn a_signal_is_passed_on_and_the_job_waited_for() {
        let job = "trap 'sleep 0.5; echo saved >> HEARD; exit 75' TERM; echo ready >> HEARD; while :; do sleep 0.05; done";
        let (code, heard) = drive(job, "0", true);
        assert_eq!(code, Some(0));
        assert_eq!(
            heard.lines().collect::<Vec<_>>(),
            ["ready", "saved", "requeue 42_7"]
        );
    }

    #[test]
    fn the_limit_is_read_from_the_configuration() {
        let config = "MailProg                = /bin/mail\nMaxArraySize            = 501\nMaxDBDMsgs = 20010\n";
        assert_eq!(max_array_size(config), Some(501));
        assert_eq!(max_array_size("MaxArraySize = none"), None);
        assert_eq!(max_array_size(""), None);
    }
}
