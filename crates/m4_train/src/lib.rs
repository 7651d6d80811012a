//! The optimisation loop: schedule, loss, Adam, loss-guided density control, checkpoints.
