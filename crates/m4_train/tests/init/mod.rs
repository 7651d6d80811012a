//! Initialisation, through its public functions.

mod initialise;
mod tracked;
mod tracks;
