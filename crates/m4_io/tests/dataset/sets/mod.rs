//! Clips of data sets, phones and trackers, compared with what `oracles/import_formats_b.py` wrote them from.

mod davis;
mod dycheck;
mod nvidia;
mod record3d;
mod side;
mod truth;
