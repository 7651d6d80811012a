//! How long a person is willing to wait.

use super::Settings;

/// A trade of time against quality, laid over a profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// A look in ten seconds of optimisation, with a third of the splats.
    Draft,
    /// The best scene within sixty seconds of optimisation on this machine, whatever the clip.
    #[default]
    Default,
    /// Five minutes of optimisation.
    Quality,
}

impl Preset {
    /// Changes `settings` accordingly.
    pub fn apply(self, settings: &mut Settings) {
        let (init, train) = (&mut settings.init, &mut settings.train);
        train.budget_s = match self {
            Self::Draft => 10.0,
            Self::Default => 60.0,
            Self::Quality => 300.0,
        };
        if self == Self::Draft {
            init.max_static /= 3;
            init.max_dynamic /= 3;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Preset, Settings};

    #[test]
    fn more_patience_is_more_time() {
        let budget = |preset: Preset| {
            let mut settings = Settings::fast();
            preset.apply(&mut settings);
            settings.train.check().unwrap();
            settings.init.check().unwrap();
            settings.train.budget_s
        };
        assert!(budget(Preset::Draft) < budget(Preset::Default) && budget(Preset::Default) < budget(Preset::Quality));
        assert_eq!(budget(Preset::default()), 60.0);
    }
}
