//! Pixels from files: textures with mip levels, and latlong environments.
