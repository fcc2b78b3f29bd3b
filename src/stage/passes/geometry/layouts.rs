//! What curves and points, which have no faces, have alike: attributes, primvars, and how many values of these each
//! interpolation asks for.

use super::super::super::raw::{RawAttribute, RawPrim};
use super::attributes::boolean;
use super::authored::local_origin;
use super::primvars::{AuthoredPrimvar, read_attribute};
use super::topology::Topology;
use crate::diagnostics::Diagnostics;
use crate::math::Bounds3;
use glam::{DVec3, Vec3};

/// Width of curves and points without any: what Hydra draws.
pub(super) const DEFAULT_WIDTH: f32 = 1.0;

/// What a prim of curves or points has.
#[derive(Debug)]
pub(super) struct Body<'a> {
    pub(super) points: &'a [Vec3],
    pub(super) widths: Option<AuthoredPrimvar>,
    pub(super) normals: Option<AuthoredPrimvar>,
    pub(super) primvars: Vec<AuthoredPrimvar>,
    pub(super) double_sided: bool,
    pub(super) type_name: String,
    /// Positions are relative to this.
    pub(super) center: DVec3,
}

impl<'a> Body<'a> {
    /// What `prim` has of `points`, which are finite, with those of the primvars called `names` that it or (constant)
    /// `inherited` prims author. Warnings call what it is made of `things`.
    pub(super) fn read(
        (prim, points, things): (&RawPrim, &'a [Vec3], &str),
        (inherited, names): (&[(String, &RawPrim)], &[String]),
        layouts: &Layouts,
        diagnostics: &Diagnostics,
    ) -> Self {
        let bounds = Bounds3::around(points.iter().copied());
        let normals = layouts.read(prim, "normals", diagnostics);
        Self {
            points,
            widths: layouts.widths(prim, things, diagnostics),
            primvars: layouts.primvars(prim, inherited, names, diagnostics),
            double_sided: boolean(prim, "doubleSided", normals.is_some()),
            normals,
            type_name: prim.type_name.clone(),
            center: local_origin(bounds.min.as_dvec3(), bounds.max.as_dvec3()),
        }
    }
}

/// What interpolations count over.
pub(super) struct Layouts {
    /// Uniform and vertex.
    vertex: Topology<'static>,
    /// Varying and face-varying, which is the same here.
    varying: Topology<'static>,
}

impl Layouts {
    /// Of so many curves (or whatever has one uniform value), points and values of varying interpolation.
    pub(super) fn of(uniform_count: usize, point_count: usize, varying_count: usize) -> Self {
        let topology = |elements: usize| Topology {
            point_count: elements,
            counts: vec![1; uniform_count].into(),
            indices: vec![0; elements].into(),
            offsets: Vec::new(),
            is_drawn: Vec::new(),
        };
        Self {
            vertex: topology(point_count),
            varying: topology(varying_count),
        }
    }

    fn topology(&self, interpolation: Option<&str>) -> &Topology<'static> {
        match interpolation {
            Some("varying" | "faceVarying") => &self.varying,
            _ => &self.vertex,
        }
    }

    /// `primvars:NAME`, else the attribute NAME, which is of vertex interpolation unless it says otherwise.
    fn read(
        &self,
        prim: &RawPrim,
        name: &str,
        diagnostics: &Diagnostics,
    ) -> Option<AuthoredPrimvar> {
        let primvar = format!("primvars:{name}");
        let is_authored = |name: &str| {
            let attribute = prim.attributes.get(name);
            attribute.filter(|attribute| attribute.value.is_some())
        };
        if let Some(attribute) = is_authored(&primvar) {
            let topology = self.topology(attribute.interpolation.as_deref());
            return AuthoredPrimvar::read(prim, name, topology, diagnostics);
        }
        let attribute = is_authored(name)?;
        let interpolation = attribute.interpolation.as_deref().or(Some("vertex"));
        let read = self.attribute(attribute, interpolation);
        let read = read.map_err(|flaw| {
            let message = format!("{name} is ignored: {flaw}");
            diagnostics.warn("bad-primvar", prim.path.clone(), message);
        });
        read.ok()
    }

    fn attribute(
        &self,
        attribute: &RawAttribute,
        interpolation: Option<&str>,
    ) -> Result<AuthoredPrimvar, String> {
        let mut read =
            read_attribute(attribute, None, interpolation, self.topology(interpolation))?;
        match read.values.iter().find(|value| !value.is_finite()) {
            Some(value) => Err(format!("{value} is not finite")),
            None => {
                read.values.shrink_to_fit();
                Ok(read)
            }
        }
    }

    /// Widths of the `things` of `prim`; without any, with a warning, they are [`DEFAULT_WIDTH`] wide.
    fn widths(
        &self,
        prim: &RawPrim,
        things: &str,
        diagnostics: &Diagnostics,
    ) -> Option<AuthoredPrimvar> {
        let widths = self.read(prim, "widths", diagnostics);
        if widths.is_none() {
            let message = format!(
                "there are no widths that could be used: the {things} are {DEFAULT_WIDTH} wide"
            );
            diagnostics.warn("default-widths", prim.path.clone(), message);
        }
        widths
    }

    /// Those of the primvars called `names` that `prim` or (constant) `inherited` prims author.
    fn primvars(
        &self,
        prim: &RawPrim,
        inherited: &[(String, &RawPrim)],
        names: &[String],
        diagnostics: &Diagnostics,
    ) -> Vec<AuthoredPrimvar> {
        let read = |owner: &RawPrim, name: &String| {
            let attribute = owner.attributes.get(&format!("primvars:{name}"))?;
            let topology = self.topology(attribute.interpolation.as_deref());
            AuthoredPrimvar::read(owner, name, topology, diagnostics)
        };
        let found = names.iter().filter_map(|name| {
            read(prim, name).or_else(|| {
                let (_, owner) = inherited.iter().find(|(inherited, _)| inherited == name)?;
                read(owner, name)
            })
        });
        found.collect()
    }
}
