//! What both doors deliver: composed prims with authored, value-resolved attributes. No schema knowledge here:
//! fallbacks, inheritance and meaning are the passes' business, once for both doors.

pub use super::attributes::{Attributes, Declaration, RawAttribute};
use super::{Composition, ReadSettings};
use glam::{DMat4, DQuat, DVec2, DVec3, DVec4, Vec2, Vec3, Vec4};
use std::collections::BTreeMap;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// What to load.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// Time code; `None` = default time (with the fallback to the first sample that USD's default time has: none).
    pub time: Option<f64>,
    /// Population mask paths; empty = everything.
    pub mask: Vec<String>,
    /// Payloads, variants, session and muted layers.
    pub composition: Composition,
    /// Attribute names wanted. A trailing `*` matches any rest.
    pub attributes: Vec<String>,
    /// Attributes whose names match one of these are listed (name, type, connections, metadata) but their values
    /// are not read: used for what must be *named* in warnings and `info` without reading arrays.
    pub values_not_needed: Vec<String>,
}

/// Attributes of skeletons, their animations and what they deform.
const SKELETAL: [&str; 14] = [
    "joints",
    "bindTransforms",
    "restTransforms",
    "translations",
    "rotations",
    "blendShapes",
    "blendShapeWeights",
    "offsets",
    "pointIndices",
    "inbetweens:*",
    "skel:*",
    "primvars:skel:*",
    "primvars:normals:indices",
    "normalOffsets",
];

/// Attributes of geometry, cameras and render settings, which every job needs.
const ALWAYS: [&str; 84] = [
    // Imageable, Xformable
    "visibility",
    "purpose",
    "xformOpOrder",
    "xformOp:*",
    "extent",
    // Mesh and other PointBased
    "points",
    "normals",
    "faceVertexCounts",
    "faceVertexIndices",
    "holeIndices",
    "orientation",
    "doubleSided",
    "subdivisionScheme",
    "interpolateBoundary",
    "faceVaryingLinearInterpolation",
    "triangleSubdivisionRule",
    "cornerIndices",
    "cornerSharpnesses",
    "creaseIndices",
    "creaseLengths",
    "creaseSharpnesses",
    "primvars:normals",
    // BasisCurves, HermiteCurves, NurbsCurves, NurbsPatch
    "order",
    "knots",
    "ranges",
    "tangents",
    "curveVertexCounts",
    "widths",
    "primvars:widths",
    "primvars:widths:indices",
    "type",
    "basis",
    "wrap",
    "pointWeights",
    "uVertexCount",
    "vVertexCount",
    "uOrder",
    "vOrder",
    "uKnots",
    "vKnots",
    "uRange",
    "vRange",
    "trimCurve:counts",
    // implicit gprims
    "size",
    "radius",
    "radiusTop",
    "radiusBottom",
    "height",
    "axis",
    "width",
    "length",
    // PointInstancer
    "protoIndices",
    "positions",
    "orientations",
    "orientationsf",
    "scales",
    "ids",
    "invisibleIds",
    // Camera
    "projection",
    "horizontalAperture",
    "verticalAperture",
    "horizontalApertureOffset",
    "verticalApertureOffset",
    "focalLength",
    "clippingRange",
    "exposure",
    // UsdRender
    "resolution",
    "pixelAspectRatio",
    "aspectRatioConformPolicy",
    "dataWindowNDC",
    "includedPurposes",
    "materialBindingPurposes",
    "productName",
    "productType",
    "sourceName",
    "sourceType",
    "dataType",
    "driver:parameters:aov:*",
    // GeomSubset
    "elementType",
    "familyName",
    "indices",
    "subsetFamily:*",
    // GeomModelAPI
    "model:drawMode",
    "model:applyDrawMode",
];

/// Inputs of UsdLux that files before USD 21 author without `inputs:` and that no other schema asks for.
const OLD_LIGHT_INPUTS: [&str; 10] = [
    "angle",
    "exposure",
    "diffuse",
    "specular",
    "normalize",
    "enableColorTemperature",
    "colorTemperature",
    "shaping:*",
    "shadow:*",
    "texture:*",
];

/// What moves the points of a PointInstancer between time samples, if it has one of [`MOVERS`].
pub const MOVED: [&str; 7] = [
    "positions",
    "velocities",
    "accelerations",
    "orientations",
    "orientationsf",
    "angularVelocities",
    "scales",
];

/// See [`MOVED`].
pub const MOVERS: [&str; 2] = ["velocities", "angularVelocities"];

impl Request {
    /// The attributes that `settings` can make use of.
    pub fn for_settings(settings: &ReadSettings) -> Self {
        let mut attributes: Vec<&str> = [&ALWAYS[..], &SKELETAL].concat();
        if settings.materials {
            attributes.extend([
                "inputs:*",
                "outputs:*",
                "info:*",
                "primvars:*",
                "collection:*",
            ]);
        }
        if settings.solidity {
            attributes.extend(super::opacity::ATTRIBUTES);
            attributes.push(super::displacement::ATTRIBUTE);
        }
        if settings.all_primvars {
            attributes.push("primvars:*");
        }
        if settings.lights {
            attributes.extend([
                "inputs:*",
                "intensity",
                "color",
                "collection:*",
                "treatAsPoint",
                "treatAsLine",
                "poleAxis",
                "light:materialSyncMode",
            ]);
            attributes.extend(OLD_LIGHT_INPUTS);
        }
        Self {
            time: settings.time,
            mask: settings.mask.clone(),
            composition: settings.composition.clone(),
            attributes: attributes.into_iter().map(str::to_owned).collect(),
            values_not_needed: Vec::new(),
        }
    }

    /// True if attribute `name` is wanted.
    pub fn wants(&self, name: &str) -> bool {
        self.attributes.iter().any(|pattern| matches(pattern, name))
    }
}

fn matches(pattern: &str, name: &str) -> bool {
    match pattern.strip_suffix('*') {
        Some(start) => name.starts_with(start),
        None => pattern == name,
    }
}

/// Stage metadata as authored.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RawMeta {
    /// Root layer as given by the user.
    pub path: std::path::PathBuf,
    /// `upAxis`.
    pub up_axis: Option<String>,
    /// `metersPerUnit`.
    pub meters_per_unit: Option<f64>,
    /// `defaultPrim`.
    pub default_prim: Option<String>,
    /// `startTimeCode`.
    pub start_time_code: Option<f64>,
    /// `endTimeCode`.
    pub end_time_code: Option<f64>,
    /// `timeCodesPerSecond` (or `framesPerSecond` where only that is authored).
    pub time_codes_per_second: Option<f64>,
    /// `renderSettingsPrimPath`.
    pub render_settings_prim_path: Option<String>,
    /// Identifiers of all layers used, sorted.
    pub layers: Vec<String>,
    /// Prims whose payloads are not loaded; neither they nor what is below them is among the stage's prims.
    pub unloaded: Vec<String>,
    /// What was read for it.
    pub read: ReadCounts,
    /// `native` or `usd-core`.
    pub reader: &'static str,
}

/// How much a load read; what an earlier load of the same source has read is not counted again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ReadCounts {
    /// Attributes whose values were resolved.
    pub attributes: usize,
    /// Bytes of their values (of arrays alone through usd-core).
    pub bytes: usize,
}

impl ReadCounts {
    /// Count an attribute that has `value`.
    pub fn add(&mut self, value: Option<&Value>) {
        if let Some(value) = value {
            self.attributes += 1;
            self.bytes += value.bytes();
        }
    }
}

/// A composed stage: active, loaded, defined, non-abstract prims in depth-first order, parents before children.
/// Prims below native instances appear once, below their prototype.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RawStage {
    /// Metadata.
    pub meta: RawMeta,
    /// The pseudo-root's children and all below, then every prototype root and all below it.
    pub prims: Vec<RawPrim>,
    /// Number of prims in `prims` that belong to the stage proper; prototypes follow.
    pub prototype_start: usize,
}

impl RawStage {
    /// Index of the prim at `path`.
    pub fn find(&self, path: &str) -> Option<usize> {
        self.prims.iter().position(|prim| prim.path == path)
    }
}

/// One composed prim: its path and attributes, and what it may share with others (a [`PrimCommon`], which it stands for:
/// `prim.type_name`). A prim that is changed shares no more.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RawPrim {
    /// Stage path (`/__Prototype_1/…` below prototypes).
    pub path: String,
    /// Authored attributes that the request wants, by full name (`primvars:st`, `primvars:st:indices`, `xformOp:translate`).
    pub attributes: Attributes,
    common: Arc<PrimCommon>,
}

/// What prims may have in common: of a hundred thousand instances beside each other only paths and transforms differ.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PrimCommon {
    /// `typeName`, empty if none.
    pub type_name: String,
    /// Index of the parent; `None` for children of the pseudo-root and for prototype roots.
    pub parent: Option<usize>,
    /// Applied API schemas, instance names included (`CollectionAPI:lightLink`).
    pub api_schemas: Vec<String>,
    /// Index of the prototype root if this prim is a native instance.
    pub prototype: Option<usize>,
    /// `kind` metadata.
    pub kind: Option<String>,
    /// Authored relationships by name with composed, absolute targets (mapped to stage paths; below prototypes:
    /// into the prototype where the target is inside it).
    pub relationships: BTreeMap<String, RawRelationship>,
    /// Names of further authored attributes that the request did not want.
    pub unread: Vec<String>,
    /// `inactiveIds` metadata of a PointInstancer, composed: points that are not drawn.
    pub inactive_ids: Vec<i64>,
    /// Points and normals were deformed by their skeleton; the doors leave it `false`.
    pub is_posed: bool,
    /// MaterialX documents that the prim references, strongest first.
    pub materialx: Vec<MaterialxReference>,
}

impl RawPrim {
    /// The prim at `path` with what it has in `common` with others, without attributes.
    pub fn new(path: impl Into<String>, common: impl Into<Arc<PrimCommon>>) -> Self {
        Self {
            path: path.into(),
            attributes: Attributes::default(),
            common: common.into(),
        }
    }

    /// The prim at `path` of a type, below prim `parent`, without anything else.
    pub fn typed(path: impl Into<String>, type_name: &str, parent: Option<usize>) -> Self {
        let common = PrimCommon {
            type_name: type_name.to_owned(),
            parent,
            ..PrimCommon::default()
        };
        Self::new(path, common)
    }

    /// The same with `attributes`.
    pub fn with(self, attributes: Attributes) -> Self {
        Self { attributes, ..self }
    }

    /// What others may share.
    pub fn common(&self) -> &Arc<PrimCommon> {
        &self.common
    }

    /// Share `common` from now on.
    pub(super) fn set_common(&mut self, common: Arc<PrimCommon>) {
        self.common = common;
    }
}

impl Deref for RawPrim {
    type Target = PrimCommon;

    fn deref(&self) -> &PrimCommon {
        &self.common
    }
}

impl DerefMut for RawPrim {
    fn deref_mut(&mut self) -> &mut PrimCommon {
        Arc::make_mut(&mut self.common)
    }
}

/// A reference to a MaterialX document, which takes a plug-in to compose.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct MaterialxReference {
    /// The document, absolute where it was found.
    pub file: std::path::PathBuf,
    /// Prim path that USD's plug-in gives what is referenced (`/MaterialX/Materials/Wood`); empty = the whole.
    pub target: String,
}

/// A relationship.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RawRelationship {
    /// Absolute target paths.
    pub targets: Vec<String>,
    /// `bindMaterialAs` metadata (`weakerThanDescendants` by default).
    pub bind_material_as: Option<String>,
}

/// A time sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Time code of the stage.
    pub time: f64,
    /// Its value.
    pub value: Value,
}

/// A value. All widths of a kind are unified; arrays keep single precision where USD has single or half, and
/// `double` arrays are converted (positions of meshes are `float` in USD).
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// bool.
    Bool(bool),
    /// Any integer.
    Int(i64),
    /// half, float, double, timecode.
    Float(f64),
    /// token, string, path expression.
    Token(String),
    /// asset.
    Asset {
        /// As authored.
        authored: String,
        /// Absolute path, `package.usdz[inside.png]` in packages; empty if it cannot be resolved. `<UDIM>` stays.
        resolved: String,
    },
    /// Any 2-vector.
    Vec2(DVec2),
    /// Any 3-vector.
    Vec3(DVec3),
    /// Any 4-vector.
    Vec4(DVec4),
    /// Any quaternion.
    Quat(DQuat),
    /// matrix4d, **column vectors convention** (USD's row-vector matrix transposed).
    Matrix(Box<DMat4>),
    /// bool[], uchar[], int[], uint[].
    IntArray(Vec<i32>),
    /// int64[], uint64[].
    Int64Array(Vec<i64>),
    /// half[], float[], double[].
    FloatArray(Vec<f32>),
    /// Any 2-vector array.
    Vec2Array(Vec<Vec2>),
    /// Any 3-vector array.
    Vec3Array(Vec<Vec3>),
    /// Any 4-vector array.
    Vec4Array(Vec<Vec4>),
    /// quath[], quatf[], quatd[] as (x, y, z, w).
    QuatArray(Vec<Vec4>),
    /// matrix4d[], column vectors convention.
    MatrixArray(Vec<DMat4>),
    /// token[], string[].
    TokenArray(Vec<String>),
}

impl Value {
    /// Number of values of an array; `None` for what is no array.
    pub fn array_len(&self) -> Option<usize> {
        Some(match self {
            Self::IntArray(v) => v.len(),
            Self::Int64Array(v) => v.len(),
            Self::FloatArray(v) => v.len(),
            Self::Vec2Array(v) => v.len(),
            Self::Vec3Array(v) => v.len(),
            Self::Vec4Array(v) | Self::QuatArray(v) => v.len(),
            Self::MatrixArray(v) => v.len(),
            Self::TokenArray(v) => v.len(),
            _ => return None,
        })
    }

    /// Bytes that the value takes, without the enum around it and what the allocator adds.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Bool(_) => 1,
            Self::Int(_) | Self::Float(_) => 8,
            Self::Token(text) => text.len(),
            Self::Asset { authored, resolved } => authored.len() + resolved.len(),
            Self::Vec2(_) => size_of::<DVec2>(),
            Self::Vec3(_) => size_of::<DVec3>(),
            Self::Vec4(_) => size_of::<DVec4>(),
            Self::Quat(_) => size_of::<DQuat>(),
            Self::Matrix(_) => size_of::<DMat4>(),
            Self::IntArray(v) => size_of_val(&v[..]),
            Self::Int64Array(v) => size_of_val(&v[..]),
            Self::FloatArray(v) => size_of_val(&v[..]),
            Self::Vec2Array(v) => size_of_val(&v[..]),
            Self::Vec3Array(v) => size_of_val(&v[..]),
            Self::Vec4Array(v) | Self::QuatArray(v) => size_of_val(&v[..]),
            Self::MatrixArray(v) => size_of_val(&v[..]),
            Self::TokenArray(v) => v.iter().map(String::len).sum(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_names_of_light_inputs_are_asked_for_with_lights_only() {
        let names = [
            "poleAxis",
            "angle",
            "colorTemperature",
            "shaping:cone:angle",
            "texture:file",
        ];
        let with = Request::for_settings(&ReadSettings::default());
        let without = Request::for_settings(&ReadSettings {
            lights: false,
            ..ReadSettings::default()
        });
        for name in names {
            assert!(with.wants(name), "{name}");
            assert!(!without.wants(name), "{name}");
        }
    }
}
