//! NURBS patches → triangles with vertices and normals on the true surface.
//!
//! Every span between knots is cut into 2ⁿ strips each way, until no facet is deeper than asked. Trim curves are not
//! applied, with a warning.

use super::super::super::raw::{RawPrim, Value};
use super::attributes::{boolean, floats, ints, token, vectors};
use super::authored::local_origin;
use super::nurbs::{Blend, Knots};
use super::primvars::{AuthoredPrimvar, Layout};
use super::topology::Topology;
use crate::diagnostics::Diagnostics;
use crate::math::Bounds3;
use crate::scene::{Interpolation, Mesh, Normals, Primvar};
use glam::{DVec3, Vec3, Vec4};

/// Strips of one span, at most.
const MAX_STRIPS: usize = 64;

/// Vertices of one patch, at most; coarser from there on.
const VERTEX_BUDGET: usize = 1_000_000;

/// Facets are no deeper and no shallower than these parts of the patch's own diagonal: coarser would show in its
/// outline, finer would not show even when it fills the image.
const DEPTH_BOUNDS: (f64, f64) = (2e-4, 2e-3);

/// Points closer than this part of the diagonal are one: seams and poles of closed patches.
const SAME_POINT: f64 = 1e-6;

/// A normal shorter than this part of the longest comes from a derivative that is nothing but rounding.
const VANISHING: f64 = 1e-9;

/// A patch whose arrays agree.
#[derive(Debug)]
pub(super) struct Patch<'a> {
    points: &'a [Vec3],
    /// Of the points, or empty.
    weights: &'a [f32],
    across: [Direction; 2],
    primvars: Vec<AuthoredPrimvar>,
    double_sided: bool,
    left_handed: bool,
    center: DVec3,
    size: f64,
}

/// u or v.
#[derive(Debug)]
struct Direction {
    knots: Knots,
    count: usize,
    /// Where the surface is drawn.
    range: (f64, f64),
}

/// A point of the surface.
#[derive(Debug, Clone, Copy)]
struct Sample {
    position: DVec3,
    along: [DVec3; 2],
}

impl<'a> Patch<'a> {
    /// `prim` with those of the primvars called `names` that it or (constant) `inherited` prims author. `None`, with a
    /// warning, where it is no patch.
    pub(super) fn read(
        prim: &'a RawPrim,
        inherited: &[(String, &RawPrim)],
        names: &[String],
        diagnostics: &Diagnostics,
    ) -> Option<Self> {
        let points = vectors(prim, "points");
        let weights = floats(prim, "pointWeights");
        let across = checked(prim, points, weights);
        let across = across.map_err(|flaw| {
            let message = format!("the patch is left out: {flaw}");
            diagnostics.warn("bad-patch", prim.path.clone(), message);
        });
        let across = across.ok()?;
        warn_of_trim_curves(prim, diagnostics);
        let bounds = Bounds3::around(points.iter().copied());
        let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        Some(Self {
            points,
            weights,
            across,
            primvars: read_primvars(prim, inherited, names, (points.len(), diagnostics)),
            double_sided: boolean(prim, "doubleSided", false),
            left_handed: token(prim, "orientation", "rightHanded") == "leftHanded",
            center: local_origin(min, max),
            size: (max - min).length(),
        })
    }

    /// The surface in object space relative to the second value, with facets no deeper than `depth`.
    pub(super) fn tessellate(self, depth: f64) -> (Mesh, DVec3) {
        let (finest, coarsest) = DEPTH_BOUNDS;
        let depth = depth.max(finest * self.size).min(coarsest * self.size);
        let parameters = self.parameters(depth);
        let blends = [0, 1].map(|axis| {
            let knots = &self.across[axis].knots;
            let blends = parameters[axis].iter().map(|&at| knots.blend(at));
            blends.collect::<Vec<_>>()
        });
        let grid = Grid::of(&self, &blends);
        let primvars = self.primvars.iter();
        let primvars = primvars.map(|primvar| self.laid_out(primvar, &blends, &grid));
        let primvars = primvars.collect();
        let mesh = Mesh {
            positions: grid.positions,
            triangle_faces: vec![0; grid.triangles.len()],
            normals: Normals::Corner {
                corners: grid.corners,
                values: grid.normals,
            },
            triangles: grid.triangles,
            primvars,
            double_sided: self.double_sided,
            closed: grid.is_closed,
            cage: None,
            scheme: "NurbsPatch".to_owned(),
        };
        (mesh, self.center)
    }

    /// Parameters of the grid's lines in both directions.
    fn parameters(&self, depth: f64) -> [Vec<f64>; 2] {
        let breaks = [0, 1].map(|axis| {
            let direction = &self.across[axis];
            direction.knots.breaks(direction.range.0, direction.range.1)
        });
        let mut strips = [0, 1].map(|axis| self.strips(axis, &breaks, depth));
        let lines = |axis: usize, strips: usize| (breaks[axis].len() - 1) * strips + 1;
        while lines(0, strips[0]) * lines(1, strips[1]) > VERTEX_BUDGET && strips != [1, 1] {
            strips = strips.map(|count| (count / 2).max(1));
        }
        [0, 1].map(|axis| divided(&breaks[axis], strips[axis]))
    }

    /// Strips of every span along `axis`: twice as many until the middle of each, on a few lines across, lies within
    /// `depth` of its chord.
    fn strips(&self, axis: usize, breaks: &[Vec<f64>; 2], depth: f64) -> usize {
        let lines = divided(&breaks[1 - axis], 2);
        let mut strips = 1;
        while strips < MAX_STRIPS {
            let ends = divided(&breaks[axis], strips);
            let is_flat = lines.iter().all(|&line| {
                let point = |at: f64| {
                    self.at(if axis == 0 { [at, line] } else { [line, at] })
                        .position
                };
                ends.windows(2).all(|ends| {
                    let chord = 0.5 * (point(ends[0]) + point(ends[1]));
                    point(0.5 * (ends[0] + ends[1])).distance(chord) <= depth
                })
            });
            if is_flat {
                break;
            }
            strips *= 2;
        }
        strips
    }

    fn at(&self, parameters: [f64; 2]) -> Sample {
        let blends = [0, 1].map(|axis| self.across[axis].knots.blend(parameters[axis]));
        self.blended([&blends[0], &blends[1]])
    }

    /// The rational surface and its derivatives. Points are not multiplied by their weights in USD.
    fn blended(&self, [u, v]: [&Blend; 2]) -> Sample {
        let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
        let mut slopes = [(DVec3::ZERO, 0.0); 2];
        for (row, &(of_v, slope_v)) in v.weights.iter().enumerate() {
            for (column, &(of_u, slope_u)) in u.weights.iter().enumerate() {
                let index = (v.first + row) * self.across[0].count + u.first + column;
                let own = self
                    .weights
                    .get(index)
                    .map_or(1.0, |&weight| f64::from(weight));
                let point = (self.points[index].as_dvec3() - self.center) * own;
                sum += point * (of_u * of_v);
                weight += own * of_u * of_v;
                for ((slope, scale), of) in slopes.iter_mut().zip([slope_u * of_v, of_u * slope_v])
                {
                    *slope += point * of;
                    *scale += own * of;
                }
            }
        }
        let position = sum / weight;
        Sample {
            position,
            along: slopes.map(|(slope, scale)| (slope - position * scale) / weight),
        }
    }

    fn laid_out(
        &self,
        primvar: &AuthoredPrimvar,
        blends: &[Vec<Blend>; 2],
        grid: &Grid,
    ) -> Primvar {
        match primvar.layout {
            Layout::Vertex => {
                let lines = blends[1]
                    .iter()
                    .flat_map(|v| blends[0].iter().map(move |u| (u, v)));
                let values = lines.map(|(u, v)| self.value(primvar, [u, v])).collect();
                primvar.finish(Interpolation::Corner(grid.corners.clone()), values)
            }
            _ => primvar.finish(Interpolation::Constant, primvar.expanded()),
        }
    }

    fn value(&self, primvar: &AuthoredPrimvar, [u, v]: [&Blend; 2]) -> Vec4 {
        let (mut sum, mut weight) = (glam::DVec4::ZERO, 0.0);
        for (row, &(of_v, _)) in v.weights.iter().enumerate() {
            for (column, &(of_u, _)) in u.weights.iter().enumerate() {
                let index = (v.first + row) * self.across[0].count + u.first + column;
                let own = self
                    .weights
                    .get(index)
                    .map_or(1.0, |&weight| f64::from(weight));
                let value = primvar.value_of(index).as_dvec4();
                sum += value * (own * of_u * of_v);
                weight += own * of_u * of_v;
            }
        }
        (sum / weight).as_vec4()
    }
}

/// `breaks` with every interval cut into `strips`.
fn divided(breaks: &[f64], strips: usize) -> Vec<f64> {
    let inner = breaks.windows(2).flat_map(|ends| {
        (0..strips).map(move |strip| {
            #[expect(clippy::cast_precision_loss, reason = "at most 64")]
            let share = strip as f64 / strips as f64;
            ends[0] + (ends[1] - ends[0]) * share
        })
    });
    inner.chain(breaks.last().copied()).collect()
}

/// The tessellated surface. Normals and primvars count over the grid's crossings, positions over distinct points.
struct Grid {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    /// The same over the crossings.
    corners: Vec<[u32; 3]>,
    is_closed: bool,
}

impl Grid {
    fn of(patch: &Patch, [u, v]: &[Vec<Blend>; 2]) -> Self {
        let (columns, rows) = (u.len(), v.len());
        let crossings = v.iter().flat_map(|v| u.iter().map(move |u| [u, v]));
        let samples: Vec<Sample> = crossings.map(|at| patch.blended(at)).collect();
        let welded = Welded::of(&samples, (columns, rows), SAME_POINT * patch.size);
        let mut normals = normals(&samples);
        fill_poles(&mut normals, (columns, rows));
        let side = if patch.left_handed { -1.0 } else { 1.0 };
        let mut grid = Self {
            positions: welded.positions(&samples),
            normals: normals
                .iter()
                .map(|normal| (*normal * side).as_vec3())
                .collect(),
            triangles: Vec::new(),
            corners: Vec::new(),
            is_closed: welded.is_closed,
        };
        for row in 0..rows - 1 {
            for column in 0..columns - 1 {
                let at = |column: usize, row: usize| index(row * columns + column);
                let [a, b] = [at(column, row), at(column + 1, row)];
                let [c, d] = [at(column + 1, row + 1), at(column, row + 1)];
                for mut corners in [[a, b, c], [a, c, d]] {
                    if patch.left_handed {
                        corners.swap(1, 2);
                    }
                    grid.add(corners, &welded.vertices);
                }
            }
        }
        grid
    }

    /// A triangle between crossings, unless two of its corners are one point.
    fn add(&mut self, corners: [u32; 3], vertices: &[u32]) {
        let [a, b, c] = corners.map(|crossing| vertices[crossing as usize]);
        if a != b && b != c && c != a {
            self.triangles.push([a, b, c]);
            self.corners.push(corners);
        }
    }
}

/// Which crossings are one point.
struct Welded {
    /// Vertex of each crossing.
    vertices: Vec<u32>,
    /// Crossing that each vertex is made from.
    origins: Vec<usize>,
    is_closed: bool,
}

impl Welded {
    fn of(samples: &[Sample], (columns, rows): (usize, usize), tolerance: f64) -> Self {
        let point = |column: usize, row: usize| samples[row * columns + column].position;
        let same = |a: DVec3, b: DVec3| a.distance(b) <= tolerance;
        let wraps_u = (0..rows).all(|row| same(point(0, row), point(columns - 1, row)));
        let wraps_v = (0..columns).all(|column| same(point(column, 0), point(column, rows - 1)));
        let is_pole =
            |row: usize| (0..columns).all(|column| same(point(0, row), point(column, row)));
        let is_pole_u =
            |column: usize| (0..rows).all(|row| same(point(column, 0), point(column, row)));
        let poles = [is_pole(0), is_pole(rows - 1)];
        let poles_u = [is_pole_u(0), is_pole_u(columns - 1)];
        let (mut vertices, mut origins) = (Vec::with_capacity(samples.len()), Vec::new());
        for row in 0..rows {
            for column in 0..columns {
                let mut from = (column, row);
                if wraps_u && column == columns - 1 {
                    from.0 = 0;
                }
                if wraps_v && row == rows - 1 {
                    from.1 = 0;
                }
                if (row == 0 && poles[0]) || (row == rows - 1 && poles[1]) {
                    from.0 = 0;
                }
                if (column == 0 && poles_u[0]) || (column == columns - 1 && poles_u[1]) {
                    from.1 = 0;
                }
                let own = row * columns + column;
                let from = from.1 * columns + from.0;
                if from == own {
                    vertices.push(index(origins.len()));
                    origins.push(own);
                } else {
                    vertices.push(vertices[from]);
                }
            }
        }
        let is_closed =
            (wraps_u && (wraps_v || poles == [true; 2])) || (wraps_v && poles_u == [true; 2]);
        Self {
            vertices,
            origins,
            is_closed,
        }
    }

    fn positions(&self, samples: &[Sample]) -> Vec<Vec3> {
        let origins = self.origins.iter();
        origins
            .map(|&crossing| samples[crossing].position.as_vec3())
            .collect()
    }
}

/// Unit normals of the crossings; zero where a derivative vanishes (but for rounding).
fn normals(samples: &[Sample]) -> Vec<DVec3> {
    let crosses = samples
        .iter()
        .map(|sample| sample.along[0].cross(sample.along[1]));
    let crosses: Vec<DVec3> = crosses.collect();
    let longest = crosses
        .iter()
        .map(|cross| cross.length())
        .fold(0.0, f64::max);
    let is_sound = |cross: DVec3| cross.length() > VANISHING * longest;
    let units = crosses.into_iter().map(|cross| match is_sound(cross) {
        true => cross.normalize_or_zero(),
        false => DVec3::ZERO,
    });
    units.collect()
}

/// Where a derivative vanishes the normal is that of the next crossing that has one, inwards.
fn fill_poles(normals: &mut [DVec3], (columns, rows): (usize, usize)) {
    for row in 0..rows {
        for column in 0..columns {
            let own = row * columns + column;
            if normals[own] != DVec3::ZERO {
                continue;
            }
            let inward = |at: usize, count: usize| {
                if 2 * at < count {
                    at + 1
                } else {
                    at.max(1) - 1
                }
            };
            let beside = [
                inward(row, rows) * columns + column,
                row * columns + inward(column, columns),
                inward(row, rows) * columns + inward(column, columns),
            ];
            let found = beside
                .into_iter()
                .map(|at| normals[at])
                .find(|n| *n != DVec3::ZERO);
            normals[own] = found.unwrap_or(DVec3::ZERO);
        }
    }
}

fn checked(prim: &RawPrim, points: &[Vec3], weights: &[f32]) -> Result<[Direction; 2], String> {
    let across = [direction(prim, "u")?, direction(prim, "v")?];
    let count = across[0].count * across[1].count;
    if points.len() != count {
        return Err(format!(
            "it has {} points, its vertex counts need {count}",
            points.len()
        ));
    }
    if !weights.is_empty() && weights.len() != count {
        return Err(format!(
            "it has {} pointWeights, {count} are needed",
            weights.len()
        ));
    }
    if let Some(weight) = weights
        .iter()
        .find(|weight| !(weight.is_finite() && **weight > 0.0))
    {
        return Err(format!("a pointWeight is {weight}, not above 0"));
    }
    match points.iter().find(|point| !point.is_finite()) {
        Some(point) => Err(format!("a point is {point}, not finite")),
        None => Ok(across),
    }
}

fn direction(prim: &RawPrim, name: &str) -> Result<Direction, String> {
    let attribute = |what: &str| {
        prim.attributes
            .get(&format!("{name}{what}"))
            .and_then(|a| a.value.as_ref())
    };
    let size = |what: &str| match attribute(what) {
        Some(Value::Int(size)) => usize::try_from(*size).unwrap_or(0),
        _ => 0,
    };
    let (count, order) = (size("VertexCount"), size("Order"));
    let knots = Knots::new(floats(prim, &format!("{name}Knots")), order, count);
    let knots = knots.map_err(|flaw| format!("in {name} it has {flaw}"))?;
    let domain = knots.domain();
    let range = match attribute("Range") {
        Some(Value::Vec2(range)) => (range.x.max(domain.0), range.y.min(domain.1)),
        _ => domain,
    };
    if range.0 >= range.1 || range.0.is_nan() || range.1.is_nan() {
        return Err(format!(
            "{name}Range is outside its knots {} to {}",
            domain.0, domain.1
        ));
    }
    Ok(Direction {
        knots,
        count,
        range,
    })
}

fn read_primvars(
    prim: &RawPrim,
    inherited: &[(String, &RawPrim)],
    names: &[String],
    (point_count, diagnostics): (usize, &Diagnostics),
) -> Vec<AuthoredPrimvar> {
    let topology = Topology {
        point_count,
        counts: vec![1].into(),
        indices: Vec::new().into(),
        offsets: Vec::new(),
        is_drawn: Vec::new(),
    };
    let read =
        |owner: &RawPrim, name: &String| AuthoredPrimvar::read(owner, name, &topology, diagnostics);
    let found = names.iter().filter_map(|name| {
        let own = read(prim, name).or_else(|| {
            let (_, owner) = inherited.iter().find(|(inherited, _)| inherited == name)?;
            read(owner, name)
        })?;
        let is_kept = !matches!(own.layout, Layout::Varying | Layout::FaceVarying);
        if !is_kept {
            let message = format!(
                "primvars:{name} is ignored: {:?} interpolation on patches is not read",
                own.layout
            );
            diagnostics.warn("bad-primvar", prim.path.clone(), message);
        }
        is_kept.then_some(own)
    });
    found.collect()
}

fn warn_of_trim_curves(prim: &RawPrim, diagnostics: &Diagnostics) {
    if ints(prim, "trimCurve:counts")
        .iter()
        .any(|&count| count > 0)
    {
        diagnostics.warn(
            "trim-curves",
            prim.path.clone(),
            "trim curves are not applied: the patch is drawn whole, its holes are closed",
        );
    }
}

fn index(at: usize) -> u32 {
    u32::try_from(at).expect("the vertex budget keeps indices below 2^32")
}

#[cfg(test)]
mod tests;
