//! Materials that must not return more light than they receive.
