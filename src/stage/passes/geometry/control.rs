//! A mesh's topology, creases, corners and options as `opensubdiv-rs` wants them described.

use super::super::super::raw::RawPrim;
use super::attributes::{floats, ints, token};
use super::authored::{AuthoredMesh, Scheme};
use super::primvars::Layout;
use super::subdivision::small;
use crate::diagnostics::Diagnostics;
use opensubdiv_rs::far::{
    FVarChannelDescriptor, TopologyDescriptor, TopologyRefiner, TopologyRefinerFactory,
};
use opensubdiv_rs::sdc::{
    FVarLinearInterpolation, Options, SchemeType, TriangleSubdivision, VtxBoundaryInterpolation,
};
use std::collections::HashSet;

/// The cage as `opensubdiv-rs` wants it described.
pub(super) struct Control {
    counts: Vec<usize>,
    indices: Vec<u32>,
    creases: Vec<[u32; 2]>,
    crease_sharpnesses: Vec<f32>,
    corners: Vec<u32>,
    corner_sharpnesses: Vec<f32>,
    /// Value indices of every face-varying primvar, and how many values it has.
    channels: Vec<(usize, Vec<u32>)>,
}

impl Control {
    /// `faces` of `mesh`; creases and corners that make no sense are left out with a warning.
    pub(super) fn of(mesh: &AuthoredMesh, faces: &[u32], diagnostics: &Diagnostics) -> Self {
        let topology = &mesh.topology;
        let corners_of = |face: &u32| topology.corners(*face as usize);
        let indices: Vec<u32> = faces
            .iter()
            .flat_map(|face| topology.points_of(*face as usize).iter().copied())
            .collect();
        let channels = mesh.primvars.iter();
        let channels = channels.filter(|primvar| primvar.layout == Layout::FaceVarying);
        let mut control = Self {
            counts: faces.iter().map(|face| corners_of(face).len()).collect(),
            creases: Vec::new(),
            crease_sharpnesses: Vec::new(),
            corners: Vec::new(),
            corner_sharpnesses: Vec::new(),
            channels: channels
                .map(|primvar| {
                    let elements = faces.iter().flat_map(corners_of);
                    let elements = elements.map(|corner| primvar.place_of(small(corner)));
                    (primvar.values.len(), elements.collect())
                })
                .collect(),
            indices,
        };
        let flaws = control.add_creases(mesh) + control.add_corners(mesh);
        if flaws > 0 {
            diagnostics.warn(
                "bad-crease",
                mesh.prim.path.clone(),
                format!("{flaws} creases or corners are ignored: they name no edge or point of the mesh, or have no sharpness"),
            );
        }
        control
    }

    /// Edges of the authored creases, one sharpness a crease or one an edge. Returns how many make no sense.
    fn add_creases(&mut self, mesh: &AuthoredMesh) -> usize {
        let lengths = ints(&mesh.prim, "creaseLengths");
        if lengths.is_empty() {
            return 0;
        }
        let edges = self.edges();
        let sharpnesses = floats(&mesh.prim, "creaseSharpnesses");
        let per_crease = sharpnesses.len() == lengths.len();
        let mut points = ints(&mesh.prim, "creaseIndices");
        let (mut edge_count, mut flaws) = (0, 0);
        for (crease, &length) in lengths.iter().enumerate() {
            let length = usize::try_from(length).unwrap_or(0).min(points.len());
            let (chain, rest) = points.split_at(length);
            points = rest;
            for pair in chain.windows(2) {
                let sharpness = sharpnesses.get(if per_crease { crease } else { edge_count });
                edge_count += 1;
                let [a, b] = [pair[0], pair[1]].map(|i| u32::try_from(i).unwrap_or(u32::MAX));
                match sharpness.filter(|sharpness| sharpness.is_finite()) {
                    Some(&sharpness) if edges.contains(&(a.min(b), a.max(b))) => {
                        self.creases.push([a, b]);
                        self.crease_sharpnesses.push(sharpness.max(0.0));
                    }
                    _ => flaws += 1,
                }
            }
        }
        flaws
    }

    fn edges(&self) -> HashSet<(u32, u32)> {
        let mut edges = HashSet::new();
        let mut first = 0;
        for &count in &self.counts {
            let face = &self.indices[first..first + count];
            for (i, &a) in face.iter().enumerate() {
                let b = face[(i + 1) % count];
                edges.insert((a.min(b), a.max(b)));
            }
            first += count;
        }
        edges
    }

    fn add_corners(&mut self, mesh: &AuthoredMesh) -> usize {
        let points = ints(&mesh.prim, "cornerIndices");
        let mut sharpnesses = floats(&mesh.prim, "cornerSharpnesses").iter();
        let mut flaws = 0;
        for &point in points {
            let sharpness = sharpnesses.next().filter(|sharpness| sharpness.is_finite());
            let point = u32::try_from(point).unwrap_or(u32::MAX);
            match sharpness {
                Some(sharpness) if (point as usize) < mesh.topology.point_count => {
                    self.corners.push(point);
                    self.corner_sharpnesses.push(sharpness.max(0.0));
                }
                _ => flaws += 1,
            }
        }
        flaws
    }

    /// Not refined yet.
    ///
    /// # Errors
    /// Topology that the scheme cannot subdivide.
    pub(super) fn refiner(&self, mesh: &AuthoredMesh) -> Result<TopologyRefiner, String> {
        let channels: Vec<FVarChannelDescriptor> = self
            .channels
            .iter()
            .map(|(count, indices)| FVarChannelDescriptor::new(*count, indices))
            .collect();
        let descriptor =
            TopologyDescriptor::new(mesh.topology.point_count, &self.counts, &self.indices)
                .with_creases(&self.creases, &self.crease_sharpnesses)
                .with_corners(&self.corners, &self.corner_sharpnesses)
                .with_fvar_channels(&channels);
        let scheme = match mesh.scheme {
            Scheme::Loop => SchemeType::Loop,
            Scheme::Bilinear => SchemeType::Bilinear,
            Scheme::CatmullClark | Scheme::None => SchemeType::Catmark,
        };
        TopologyRefinerFactory::create(descriptor, scheme, options(&mesh.prim))
            .map_err(|error| error.to_string())
    }
}

/// `interpolateBoundary`.
pub(super) fn boundary_rule(prim: &RawPrim) -> VtxBoundaryInterpolation {
    match token(prim, "interpolateBoundary", "edgeAndCorner") {
        "none" => VtxBoundaryInterpolation::None,
        "edgeOnly" => VtxBoundaryInterpolation::EdgeOnly,
        _ => VtxBoundaryInterpolation::EdgeAndCorner,
    }
}

fn options(prim: &RawPrim) -> Options {
    let face_varying = match token(prim, "faceVaryingLinearInterpolation", "cornersPlus1") {
        "all" => FVarLinearInterpolation::All,
        "none" => FVarLinearInterpolation::None,
        "cornersOnly" => FVarLinearInterpolation::CornersOnly,
        "cornersPlus2" => FVarLinearInterpolation::CornersPlus2,
        "boundaries" => FVarLinearInterpolation::Boundaries,
        _ => FVarLinearInterpolation::CornersPlus1,
    };
    let triangles = match token(prim, "triangleSubdivisionRule", "catmullClark") {
        "smooth" => TriangleSubdivision::Smooth,
        _ => TriangleSubdivision::Catmark,
    };
    Options::new()
        .with_vtx_boundary_interpolation(boundary_rule(prim))
        .with_fvar_linear_interpolation(face_varying)
        .with_triangle_subdivision(triangles)
}
