//! The commands: its options, the call of the library, and the result that is printed.

pub mod batch;
pub mod doctor;
pub mod eval;
pub mod gallery;
pub mod geometry;
pub mod interchange;
pub mod manual;
pub mod render;
pub mod run;
pub mod view;
#[cfg(feature = "nets")]
pub mod weights;
/// In a build without networks the command accepts any arguments, so that the error can say how to
/// build with them.
#[cfg(not(feature = "nets"))]
pub mod weights {
    use crate::BUILD_FULL;
    use crate::failure::Failure;
    use minute4d::Category;

    #[derive(Debug, clap::Args)]
    pub struct Weights {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        _rest: Vec<String>,
    }

    pub fn run(_: &Weights, _: &crate::output::Output) -> Result<(), Failure> {
        let reason = format!(
            "this program was built without networks, so it uses no weights; `{BUILD_FULL}` builds it with networks"
        );
        Err(Failure {
            code: Category::NoDevice.exit_code(),
            reason,
        })
    }
}
