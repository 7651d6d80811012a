//! Many clips on many machines: what to do, who does it, what came of it.
