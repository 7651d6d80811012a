//! The environment of child processes: what a run needs is passed on, and nothing else. Keys and
//! tokens of who started the program are not for the decoders of a stranger's clip.

use std::process::Command;

/// Variables that are passed on by their whole names: where things are, languages and devices.
const NAMES: [&str; 32] = [
    "PATH",
    "HOME",
    "USER",
    "LANG",
    "LANGUAGE",
    "TZ",
    "TERM",
    "NO_COLOR",
    "TMPDIR",
    "TMP",
    "TEMP",
    "LD_LIBRARY_PATH",
    "DYLD_LIBRARY_PATH",
    "RUST_BACKTRACE",
    "NODEVICE_SELECT",
    "NVIDIA_VISIBLE_DEVICES",
    "NVIDIA_DRIVER_CAPABILITIES",
    "GPU_DEVICE_ORDINAL",
    "DISPLAY",
    "WAYLAND_DISPLAY",
    // Windows
    "SYSTEMROOT",
    "SYSTEMDRIVE",
    "WINDIR",
    "COMSPEC",
    "PATHEXT",
    "USERPROFILE",
    "APPDATA",
    "LOCALAPPDATA",
    "PROGRAMDATA",
    "PROGRAMFILES",
    "NUMBER_OF_PROCESSORS",
    "PROCESSOR_ARCHITECTURE",
];

/// Starts of the names of variables that are passed on: settings of ours, of threads, and of
/// drivers of graphics cards.
const STARTS: [&str; 15] = [
    "LC_",
    "XDG_",
    "MINUTE4D_",
    "RAYON_",
    "MALLOC_",
    "CUDA_",
    "CUDARC_",
    "CUBECL_",
    "VK_",
    "MESA_",
    "LIBGL_",
    "LP_",
    "RADV_",
    "HIP_",
    "ROCR_",
];

/// Gives `command` of this process's environment what a run needs, and nothing else.
pub fn pass_on(command: &mut Command) {
    command.env_clear();
    command.envs(std::env::vars_os().filter(|(name, _)| name.to_str().is_some_and(is_needed)));
}

/// Whether a run needs the variable. Windows does not tell small letters from capital ones.
fn is_needed(name: &str) -> bool {
    let name = if cfg!(windows) {
        name.to_ascii_uppercase()
    } else {
        name.to_owned()
    };
    NAMES.contains(&name.as_str()) || STARTS.iter().any(|start| name.starts_with(start))
}

#[cfg(test)]
mod tests {
    use super::is_needed;

    #[test]
    fn places_languages_and_devices_are_passed_on_and_keys_are_not() {
        for name in [
            "PATH",
            "HOME",
            "LC_ALL",
            "XDG_CACHE_HOME",
            "MINUTE4D_WEIGHTS",
            "CUDA_VISIBLE_DEVICES",
            "VK_ICD_FILENAMES",
        ] {
            assert!(is_needed(name), "{name}");
        }
        for name in [
            "AWS_SECRET_ACCESS_KEY",
            "AWS_SESSION_TOKEN",
            "GITHUB_TOKEN",
            "HF_TOKEN",
            "NVIDIA_API_KEY",
            "SSH_AUTH_SOCK",
            "HTTPS_PROXY",
            "PATH2",
            "SLURM_JOB_ID",
        ] {
            assert!(!is_needed(name), "{name}");
        }
    }
}
