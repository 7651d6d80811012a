//! How long training may take.

use super::Settings;

/// A trade of time against quality, laid over a profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// A first impression in ten seconds of optimisation, with a third of the splats.
    Draft,
    /// The best scene within sixty seconds of optimisation on this machine, whatever the clip.
    #[default]
    Default,
}

impl Preset {
    /// Changes `settings` accordingly.
    pub fn apply(self, settings: &mut Settings) {
        let (init, train) = (&mut settings.init, &mut settings.train);
        train.budget_s = match self {
            Self::Draft => 10.0,
            Self::Default => 60.0,
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
    fn a_preset_sets_its_time_and_draft_a_third_of_the_splats_and_nothing_else() {
        let fast = Settings::fast();
        for (preset, budget_s, share) in [(Preset::Draft, 10.0, 3), (Preset::Default, 60.0, 1)] {
            let (mut settings, mut want) = (fast.clone(), fast.clone());
            preset.apply(&mut settings);
            want.train.budget_s = budget_s;
            want.init.max_static = fast.init.max_static / share;
            want.init.max_dynamic = fast.init.max_dynamic / share;
            assert_eq!(settings, want, "{preset:?}");
            settings.check().unwrap();
        }
        assert_eq!(Preset::default(), Preset::Default);
    }
}
