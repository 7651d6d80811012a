//! The rows of the table (paper, table 3).

use minute4d::Settings;
use minute4d::enhance::{Before, Plan};
use minute4d::settings::{Enhancement, Segmenter, Tracker, UnknownName, by_name};
use minute4d_eval::Error;
use serde::{Deserialize, Serialize};

/// One row: everything, or everything but a part (paper, table 3).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Row {
    /// Everything. Always there: the others are compared with it.
    #[default]
    Full,
    /// Masks are what motion and colours say.
    NoSeg,
    /// No points are followed or carried from one frame to another.
    NoTrack,
    /// Splats are added by gradients and pruned by opacity, as in 3DGS.
    NoLossGuided,
    /// Splats are neither added nor pruned.
    NoDensity,
}

impl Row {
    /// In the order of tables.
    pub const ALL: [Self; 5] = [
        Self::Full,
        Self::NoSeg,
        Self::NoTrack,
        Self::NoLossGuided,
        Self::NoDensity,
    ];

    /// As options and folders call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::NoSeg => "no-seg",
            Self::NoTrack => "no-track",
            Self::NoLossGuided => "no-loss-guided",
            Self::NoDensity => "no-density",
        }
    }

    /// Returns the name in tables.
    pub fn title(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::NoSeg => "without segmentation",
            Self::NoTrack => "without tracking",
            Self::NoLossGuided => "without loss-guided (as 3DGS)",
            Self::NoDensity => "no density control",
        }
    }

    /// What it goes without.
    pub fn without(self) -> Option<Enhancement> {
        match self {
            Self::Full => None,
            Self::NoSeg => Some(Enhancement::Segmentation),
            Self::NoTrack => Some(Enhancement::Tracking),
            Self::NoLossGuided => Some(Enhancement::LossGuided),
            Self::NoDensity => Some(Enhancement::Density),
        }
    }

    /// Why the row would be the full one again, where the settings say so.
    pub(super) fn not_applicable(
        self,
        is_capture: bool,
        settings: &Settings,
    ) -> Result<Option<&'static str>, Error> {
        let Some(part) = self.without() else {
            return Ok(None);
        };
        let (geometry, density) = (&settings.geometry, &settings.train.density);
        let mut without = settings.clone();
        without.switch_off(part);
        Ok(match self {
            // then it depends on the capture
            Self::NoSeg if is_capture => None,
            Self::NoSeg if geometry.masks.is_some() => {
                Some("the masks are given (--masks), so nothing is segmented")
            }
            Self::NoLossGuided if !density.enabled => {
                Some("the settings are without density control")
            }
            _ if without == *settings => Some("the settings are without it"),
            Self::NoSeg => {
                let plan = Plan::of(geometry.segmenter, Tracker::None, Before::Motion)?;
                (plan.segmenter() == Segmenter::None.name()).then_some(
                    "no segmentation network is installed, so the full row is without one, too",
                )
            }
            _ => None,
        })
    }
}

impl std::str::FromStr for Row {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        by_name("row", text, &Self::ALL, Self::name)
    }
}

#[cfg(test)]
mod tests {
    use super::Row;
    use minute4d::Settings;
    use minute4d::settings::Enhancement;

    #[test]
    fn rows_that_repeat_the_full_one_do_not_apply() {
        let mut settings = Settings::fast();
        settings.train.density.enabled = true;
        let why = |row: Row, settings: &Settings| {
            row.not_applicable(false, settings)
                .unwrap()
                .unwrap_or_default()
        };
        assert_eq!(why(Row::Full, &settings), "");
        for row in [Row::NoTrack, Row::NoLossGuided, Row::NoDensity] {
            assert_eq!(why(row, &settings), "");
        }
        settings.geometry.masks = Some("masks".into());
        assert!(why(Row::NoSeg, &settings).contains("given"));
        settings.switch_off(Enhancement::Density);
        settings.switch_off(Enhancement::Tracking);
        for row in [Row::NoTrack, Row::NoLossGuided, Row::NoDensity] {
            assert!(
                why(row, &settings).contains("the settings are without"),
                "{row:?}"
            );
        }
    }
}
