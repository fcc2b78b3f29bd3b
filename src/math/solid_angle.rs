//! Solid angles and form factors in closed form.
