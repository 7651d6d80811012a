//! For tests only: synthetic scenes, tolerances, finite differences, fixture loading.
