//! The page that shows a scene: one self-contained HTML file, or the same page from a local server.
#![forbid(unsafe_code)]
