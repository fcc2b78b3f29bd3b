//! Real spherical harmonics, the first 9 (bands 0 to 2).
