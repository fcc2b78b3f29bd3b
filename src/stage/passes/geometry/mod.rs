//! Meshes, implicit gprims and instancers → shared meshes and prims.
