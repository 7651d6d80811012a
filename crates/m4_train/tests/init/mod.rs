//! Initialisation, through its public functions.

mod accuracy;
mod initialise;
mod tracked;
mod tracks;
