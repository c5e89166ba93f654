//! Lamps whose light no method finds, and frames that met no light.
